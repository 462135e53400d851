"""The scenes that benchmark and references share, by name, and the form of an answer to one."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fem.kernel.loads import DeadLoad
from fem.scene.scene import Block, Inclusion, Pair, Pillar, Probe, Scene, Sensor, Triple
from geometry.design import Material, SensorDesign
from geometry.layout import AXES, FloatArray, electrode_squares, pad_squares

TRACTIONS: dict[str, Triple] = {"normal": (0.0, 0.0, -1.0), "tangential": (0.2, 0.0, 0.0)}  #: [MPa]
RUBBER = Material(young_mpa=6.1, poisson=0.49)
FINITE = "rubber-block"  #: the scene at finite strain
#: its reference, by NGSolve on half of the block with Taylor-Hood hexahedra of third order; the code that made it, and
#: that raced NGSolve and CalculiX at finite strain, is in the history of the repository
FINITE_REFERENCE: dict[str, Any] = json.loads(
    Path(__file__).with_name("finite_references.json").read_text(encoding="utf-8")
)


@dataclass(frozen=True)
class Solved:
    """A scene's probes, and what they took."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    unknowns: int
    seconds: dict[str, float]  #: by step, without imports; their sum is the run time


def is_linear(scene: Scene) -> bool:
    """True at small strain."""
    return scene.material.model == "linear"


def is_homogeneous_block(scene: Scene) -> bool:
    """True for an upright box of one linear material."""
    return is_linear(scene) and not isinstance(scene.body, Sensor) and not scene.inclusions and scene.outline.is_upright


def loaded(
    body: Block | Pillar, material: Material, center_mm: Pair, size_mm: Pair, traction_mpa: Triple, *regions: Inclusion,
    probes: Mapping[str, tuple[Pair, Pair]] | None = None, probe: str = "patch",
) -> Scene:  # fmt: skip
    """A body under one patch; without other probes (centre and size by name) the patch itself is probed."""
    probed = probes or {probe: (center_mm, size_mm)}
    return Scene(
        body=body,
        material=material,
        inclusions=regions,
        loads=(DeadLoad(center_mm=center_mm, size_mm=size_mm, traction_mpa=traction_mpa),),
        probes=tuple(Probe(name=name, kind="mean", center_mm=at, size_mm=size) for name, (at, size) in probed.items()),
    )


def patch_scenes() -> dict[str, Scene]:
    """A 10 mm patch in the middle of a 30 × 30 × 10 mm block, for three Poisson's ratios."""
    return {
        f"block-{name}-{poisson:g}": loaded(
            Block(size_mm=(30.0, 30.0, 10.0)), replace(RUBBER, poisson=poisson), (15.0, 15.0), (10.0, 10.0), push
        )
        for poisson in (0.3, 0.49, 0.4999)
        for name, push in TRACTIONS.items()
    }  # fmt: skip


def pillar_scenes() -> dict[str, Scene]:
    """An upright and an oblique free pillar, loaded all over the top."""
    bodies = {
        "upright": Pillar(section_mm=(2.0, 2.0), base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, 10.0)),
        "oblique": Pillar(section_mm=(2.0 * math.sqrt(2.0), 2.0), base_mm=(10.0, 0.0, 0.0), top_mm=(0.0, 0.0, 10.0)),
    }
    return {
        f"pillar-{kind}-{name}": loaded(body, RUBBER, (0.0, 0.0), body.section_mm, push, probe="top")
        for kind, body in bodies.items()
        for name, push in TRACTIONS.items()
    }


def slab_scenes() -> dict[str, Scene]:
    """One loaded patch of a 90 × 90 × 10 mm slab, probed there and where its neighbours would be."""
    centres = {"self": (52.5, 52.5), "first": (37.5, 52.5), "diagonal": (37.5, 37.5), "second": (22.5, 52.5)}
    centres["edge"] = (82.5, 52.5)
    return {
        f"slab-{size:g}-{name}": loaded(
            Block(size_mm=(90.0, 90.0, 10.0)), RUBBER, centres["self"], (size, size), push,
            probes={place: (centre, (size, size)) for place, centre in centres.items()},
        )
        for size in (12.0, 4.0)
        for name, push in TRACTIONS.items()
    }  # fmt: skip


def upright(x: float, y: float, z: Pair, section_mm: Pair, young_mpa: float, poisson: float) -> Inclusion:
    """An upright prism of another rubber between two heights."""
    material = Material(young_mpa=young_mpa, poisson=poisson)
    return Inclusion(base_mm=(x, y, z[0]), top_mm=(x, y, z[1]), section_mm=section_mm, material=material)


def hard_scenes() -> dict[str, Scene]:
    """Rubbers 20 to 1000 times apart, a thin plate that keeps its volume, pillars that lean."""
    soft, dense = Material(young_mpa=1.0, poisson=0.495), Material(young_mpa=6.1, poisson=0.4999)
    sheared = Pillar(section_mm=(3.0, 2.0), base_mm=(0.0, 0.0, 0.0), top_mm=(6.0, 4.0, 8.0))
    leaning = Pillar(section_mm=(3.0, 2.0), base_mm=(1.0, 2.0, 0.0), top_mm=(10.0, 2.0, 6.0))
    low, half = (0.02, 0.01, -0.1), (0.1, 0.05, -0.5)
    return {
        "two-inclusions": loaded(
            Block(size_mm=(20.0, 18.0, 8.0)), soft, (10.0, 9.0), (7.0, 6.0), low,
            upright(7.0, 8.0, (0.0, 8.0), (3.0, 3.0), 30.0, 0.495),
            upright(13.5, 10.0, (0.0, 8.0), (2.5, 3.5), 0.05, 0.495),
        ),
        "void": loaded(
            Block(size_mm=(15.0, 15.0, 10.0)), RUBBER, (7.0, 8.0), (8.0, 7.0), half,
            upright(6.0, 7.0, (2.0, 7.0), (4.0, 3.0), 0.0061, 0.3),
        ),
        "plate": loaded(Block(size_mm=(20.0, 20.0, 1.0)), dense, (9.0, 11.0), (6.0, 5.0), (0.3, 0.1, -1.0)),
        "sheared-pillar": loaded(sheared, dense, (6.0, 4.0), (3.0, 2.0), low),
        "side-inclusion": loaded(
            Block(size_mm=(16.0, 14.0, 8.0)), RUBBER, (9.0, 7.0), (7.0, 6.0), half,
            upright(2.0, 7.0, (0.0, 8.0), (4.0, 5.0), 300.0, 0.45),
        ),
        "leaning-56": loaded(leaning, RUBBER, (10.0, 2.0), (3.0, 2.0), (0.02, 0.0, -0.1)),
    }  # fmt: skip


def response_scenes(design: SensorDesign | None = None) -> dict[str, Scene]:
    """Columns of an array's response: 1 N along each axis on an inner, an edge and a corner pad.

    The probes are all electrodes, named by unit and electrode: their displacement [mm] is the influence [mm/N].
    """
    design = design or SensorDesign()
    cols, squares = design.array.cols, pad_squares(design)
    units = {"inner": design.array.rows // 2 * cols + cols // 2, "edge": cols // 2, "corner": 0}
    electrodes = tuple(
        Probe(
            name=f"{number // 2}-U{number % 2 + 1}", kind="mean", center_mm=((x0 + x1) / 2, (y0 + y1) / 2),
            size_mm=(x1 - x0, y1 - y0),
        )
        for number, (x0, y0, x1, y1) in enumerate(electrode_squares(design).tolist())
    )  # fmt: skip
    found = {}
    for place, unit in units.items():
        (x, y), side = ((squares[unit, :2] + squares[unit, 2:]) / 2).tolist(), design.pad.size_mm
        for axis, traction in zip(AXES, (np.eye(3) / side**2).tolist(), strict=True):
            load = DeadLoad(center_mm=(x, y), size_mm=(side, side), traction_mpa=tuple(traction))
            found[f"response-{place}-{axis}"] = Scene(
                body=Sensor(design=design), material=design.matrix_material, loads=(load,), probes=electrodes
            )
    return found


def finite_scene() -> Scene:
    """A dead traction on the middle of a block of neo-Hookean rubber."""
    body, rubber = Block(size_mm=(15.0, 15.0, 10.0)), Material(model="neo-hookean")
    return loaded(body, rubber, (7.5, 7.5), (6.0, 6.0), (0.2, 0.0, -1.0))


def all_scenes() -> dict[str, Scene]:
    """Every linear scene, each of which is given a reference."""
    return patch_scenes() | pillar_scenes() | slab_scenes() | response_scenes() | hard_scenes()
