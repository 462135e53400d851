"""Shapes pressed on 2 × 2 rigid plates, held to NGSolve's answers, which `plates.json` keeps.

NGSolve took the slab in tetrahedra that conform to its plates and are hp-refined toward their edges, a quarter of it in
four parities: no condensed cell, no ports, no tiles, no kernel and no grid in common. Contact was found by an active
set of springs on a raster of the plates' faces and of small squares of the rubber between them; conduction in the
pillars of the unit that is pressed most, on another mesh. `own_error` is the larger distance of an order less and of a
coarser run. The file names the commit whose code made it.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dataset.indentation import contact_lengths
from dataset.resistance import exact_resistances, pillar_lengths, rest_resistances
from fem.contact import Convex, Flat, Shape, Sphere, SurfaceCompliance, press, surface_compliance
from fem.contact.driver import CELLS
from geometry.design import Array, Electrics, Pad, Plate, SensorDesign
from geometry.layout import FloatArray, pad_squares, unit_centres
from studies.tables import Row

DESIGN = SensorDesign(array=Array(rows=2, cols=2), pad=Pad(kind="stiff", plate=Plate(thickness_mm=0.4)))
BOX = Convex.hull(np.array([(x, y, z) for x in (-9.0, 9.0) for y in (-6.0, 6.0) for z in (0.0, 10.0)]))
TILTED = replace(BOX, turn=Rotation.from_euler("xyz", [4.0, 6.0, 20.0], degrees=True).as_matrix())
Answer = dict[str, FloatArray]  #: what `answer_of` gives


@dataclass(frozen=True)
class Press:
    """One press: how deep, where, and dragged how far, so far that all of it slips."""

    shape: Shape
    depth_mm: float
    at_mm: tuple[float, float]
    slide_mm: tuple[float, float] = (0.0, 0.0)
    friction: float = 0.0


CASES = {
    "ball over a crossing": Press(Sphere(6.0), 1.5, (0.5, 1.0)),
    "tilted box": Press(TILTED, 1.2, (1.0, 2.0)),
    "flat punch over four plates": Press(Flat((20.0, 16.0)), 1.0, (1.0, 1.5)),
    "ball dragged along the diagonal, friction 0.5": Press(Sphere(10.0), 0.5, (5.5, 5.5), (1.5, 1.5), 0.5),
}


def by_ngsolve(name: str) -> Answer:
    """NGSolve's answer to a press of `CASES`: as of `answer_of`, and its `own_error` (3,), as of `off`."""
    stored = json.loads(Path(__file__).with_name("plates.json").read_text(encoding="utf-8"))
    return {key: np.array(value) for key, value in stored["presses"][name].items()}


def answer_of(surface: SurfaceCompliance, pressing: Press, cells: int = CELLS) -> Answer:
    """A press by `fem.contact`.

    `net_n` (3,) [N] along x and y and down; `wrench` (plates, 3) of force down [N], ∫ x p and ∫ y p about each plate's
    middle [N mm]; `electrode_mm` (rows, cols, n_upper, 3); `resistance` (pillars,) of the unit that is pressed most,
    over that at rest, by the design's own equation.
    """
    contact = press(surface, **vars(pressing), cells=cells)
    patch, down = contact.patch, contact.cell_force_n[2]
    x, y = np.broadcast_arrays(patch.x_mm, patch.y_mm[:, None])
    wrench = np.zeros((DESIGN.n_units, 3))
    for k, (plate, (cx, cy)) in enumerate(zip(pad_squares(DESIGN), unit_centres(DESIGN), strict=True)):
        own = down * ((x > plate[0]) & (x < plate[2]) & (y > plate[1]) & (y < plate[3]))
        wrench[k] = own.sum(), (own * (x - cx)).sum(), (own * (y - cy)).sum()
    of_conduction = contact_lengths([contact])
    lengths = pillar_lengths(contact.electrode_mm, DESIGN.unit)[None] if of_conduction is None else of_conduction
    resistance = exact_resistances(lengths, contact.design).reshape(DESIGN.n_units, -1)[wrench[:, 0].argmax()]
    moved = {"net_n": contact.net_force_n, "wrench": wrench, "electrode_mm": contact.electrode_mm}
    return moved | {"resistance": resistance / rest_resistances(contact.design)}


def off(ours: Answer, theirs: Answer) -> FloatArray:
    """Relative differences of the net force, wrenches (moments over half a plate) and electrodes, (3,).

    Each over the norm of all of them.
    """
    arms = np.array([1.0, *[2 / DESIGN.pad.size_mm] * 2])
    scaled = {"net_n": np.ones(1), "wrench": arms, "electrode_mm": np.ones(1)}
    return np.array(
        [np.linalg.norm((ours[k] - theirs[k]) * s) / np.linalg.norm(theirs[k] * s) for k, s in scaled.items()]
    )


def rows(cells: tuple[int, ...] = (48, 96)) -> Iterator[Row]:
    """A row for each press: how far ours is from NGSolve's on so many cells along a contact, and resistances [%]."""
    surfaces = {
        model: surface_compliance(replace(DESIGN, electrics=Electrics(model=model)))[0]
        for model in ("conduction", "eq1")
    }
    for name, pressing in CASES.items():
        theirs = by_ngsolve(name)
        row: dict[str, Any] = {"press": name, "NGSolve: force down [N]": float(theirs["net_n"][2])}
        row["its own error: net / wrenches / electrodes [%]"] = (100 * theirs["own_error"]).tolist()
        for count in cells:
            ours = {model: answer_of(surface, pressing, count) for model, surface in surfaces.items()}
            row[f"ours off, {count} cells [%]"] = (100 * off(ours["eq1"], theirs)).tolist()
        row["NGSolve: R over rest − 1 [%]"] = (100 * (theirs["resistance"] - 1)).tolist()
        for model, found in ours.items():
            row[f"R by {model} off [% of rest]"] = (100 * (found["resistance"] - theirs["resistance"])).tolist()
        yield row
