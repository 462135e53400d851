"""``python -m studies linear-cost DOCS``: what linear elasticity costs, the table and the pictures of docs/physics.md.

Finite and linear answers are of one grid, so that their difference is strain's alone; forces come from the linear map's
own inverse, which reads the lengths of the pillars exactly as the linear model gives them.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from scipy.optimize import least_squares

from common.storage.files import write_text
from dataset.protocols import PROTOCOLS
from dataset.resistance import pillar_lengths, pillar_strains
from fem.finite.samples import SampleSolver
from fem.pictures.arrays import pressed_sensor
from fem.pictures.parts import scene_field
from geometry.design import Array, Pad, SensorDesign, with_model
from geometry.layout import FloatArray
from studies.charts import BLUE, ORANGE, finish, new_figure
from studies.pages import markdown

PROTOCOL = "three-axis"
PEAKS_MPA = (0.3, 1.0, 3.0, 5.0)  #: to which the greatest pressure of every sample is scaled
SEED = 7
SMALL = 1e-4  #: of a load, at which rubber is linear
CAP = 0.3  #: largest strain of a pillar, as of datasets
NEAR = 1e-3  #: of the loads' root mean square: how little a force must miss before the inverse has settled
DESIGN = SensorDesign(array=Array(rows=3, cols=3), pad=Pad(kind="stiff"))
TABLE = re.compile("(?<=<!-- table -->\n).*?(?=<!-- end -->)", re.DOTALL)
PRESSURES_MPA = (1.0, 2.0, 3.0, 4.0, 5.0)  #: of the picture; the last is shown in section


def costs(samples: int) -> Iterator[list[str]]:
    """Rows of docs/physics.md: errors by the greatest pressure, on a 3 × 3 array with stiff pads."""
    solver = SampleSolver(DESIGN, unwanted=lambda u: strains(u) > CAP)
    n, small_n = 3 * DESIGN.n_units, SMALL * DESIGN.pad.size_mm**2
    ones = small_n * np.eye(n).reshape(n, -1, 3)
    compliance = solver.displacements(ones).displacement_mm / small_n  # (n, n_units, 2, 3) per newton
    tractions = PROTOCOLS[PROTOCOL].draw(np.random.default_rng(SEED), samples, DESIGN)
    pressed = -tractions[..., 2].min(axis=1)
    for peak in PEAKS_MPA:
        force_n = tractions * (peak / pressed)[:, None, None] * DESIGN.pad.size_mm**2
        if found := cost_of(force_n, solver, compliance):
            yield [f"{peak:g}", *found]


def cost_of(force_n: FloatArray, solver: SampleSolver, compliance: FloatArray) -> list[str]:
    """Errors of linear elasticity on those samples of forces that settle and strain no pillar by more than `CAP`.

    Root mean squares: of displacements over theirs, and of Fx, Fy, Fz beside theirs [N]. Forces are (m, n_units, 3).
    """
    found = solver.displacements(force_n)
    kept = found.settled & (strains(found.displacement_mm) <= CAP)
    if not kept.any():
        return []
    finite, force_n = found.displacement_mm[kept], force_n[kept]
    linear = np.tensordot(force_n.reshape(len(force_n), len(compliance)), compliance, 1)
    read = np.array([inverse(pillar_lengths(u, DESIGN.unit), compliance) for u in finite]).reshape(force_n.shape)
    errors, sizes = (np.sqrt((each**2).mean(axis=(0, 1))) for each in (read - force_n, force_n))
    displacement = np.sqrt(((linear - finite) ** 2).mean() / (finite**2).mean())
    forces = [f"{e:.1f} of {s:.1f}" if s > 0 else f"{e:.1f} of 0" for e, s in zip(errors, sizes, strict=True)]
    return [f"{100 * displacement:.1f} %", *forces]


def strains(displacement_mm: FloatArray) -> FloatArray:
    """Largest strain of a pillar in each of samples (m, n_units, 2, 3), shape (m,)."""
    lengths = pillar_lengths(displacement_mm, DESIGN.unit)
    return pillar_strains(displacement_mm, lengths, DESIGN.unit).max(axis=(1, 2))


def inverse(length_mm: FloatArray, compliance: FloatArray) -> FloatArray:
    """Forces (n,) [N] at which the linear model has the lengths (n_units, 3)."""
    size = 100.0

    def missed(share: FloatArray) -> FloatArray:
        return (pillar_lengths(np.tensordot(size * share, compliance, 1), DESIGN.unit) - length_mm).ravel()

    return size * least_squares(missed, np.zeros(len(compliance)), xtol=NEAR * 1e-3).x


def draw(folder: Path) -> None:
    """One pad of a row, by linear elasticity and at finite strain: the top under it, and how far it sinks."""
    row = replace(DESIGN, array=Array(rows=1, cols=3))
    own, (wide, _, high) = row.matrix_material.model, row.slab_mm
    models = {"linear": "linear", "finite strain": "neo-hookean" if own == "linear" else own}  # as `SampleSolver`
    along = np.linspace(-wide / 2, wide / 2, 501)
    top = np.column_stack([along, 0.0 * along, np.full_like(along, high)])
    figure = new_figure(12, 4.2, dpi=100)
    section, sinking = figure.subplots(1, 2, width_ratios=(1.8, 1.0))
    for (name, model), colour in zip(models.items(), (ORANGE, BLUE), strict=True):
        sunk_mm = [0.0]
        for mpa in PRESSURES_MPA:
            every = pressed_sensor(with_model(row, model), "uniform", mpa)
            one = tuple(load if load.center_mm == (0.0, 0.0) else load.times(0.0) for load in every.loads)
            moved = scene_field(replace(every, loads=one)).displacement_at(top)
            sunk_mm.append(-float(moved[len(top) // 2, 2]))
        section.plot(*(top + moved)[:, [0, 2]].T, color=colour, label=name)
        sinking.plot((0.0, *PRESSURES_MPA), sunk_mm, "o-", color=colour, label=name)
    section.axhline(high, color="0.6", linewidth=0.8, label="at rest")
    section.set(
        xlabel="x [mm]", ylabel="z [mm]", title=f"top of the slab at y = 0: three plates, {mpa:g} MPa on the middle one"
    )
    sinking.set(xlabel="mean pressure under the plate [MPa]", ylabel=f"the plate sinks, of {high:g} mm, by [mm]")
    for axes in (section, sinking):
        axes.legend(frameon=False)
    finish(figure, folder / "linear-and-finite.png")


def linear_cost(docs: Path, samples: Annotated[int, Parameter(help="Samples of each peak.")] = 3) -> None:
    """Write the table into physics.md in the folder of the docs, and its picture beside it."""
    headers = ("peak [MPa]", "displacement", *(f"F{axis} [N] of rms" for axis in "xyz"))
    table = markdown(headers, costs(samples), 0) + "\n"
    page = docs / "physics.md"
    write_text(TABLE.sub(lambda _: table, page.read_text(encoding="utf-8")), page)
    draw(docs)
