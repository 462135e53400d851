"""Scenes of arrays by copies of one cell: loads, probes and plates, each unit's part in the unit's own coordinates."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from common.errors import DesignError, SceneError
from fem.kernel.loads import Rectangle
from fem.scene.scene import Scene, Sensor
from fem.scene.solution import Solution, Stopwatch, largest_error
from geometry.design import Pad, SensorDesign
from geometry.layout import FloatArray, unit_centres

if TYPE_CHECKING:
    from fem.array.cell import CondensedCell

SAME = 1e-9  #: relative difference of sides by which a plate is still square
Share = tuple[int, int, float]  #: unit, the rectangle on its cell, and the share of the whole rectangle's area


def has_alike_plates(scene: Scene) -> bool:
    """True of an array or unit whose only loads are plates that `design_of_cells` takes."""
    try:
        return isinstance(scene.body, Sensor) and design_of_cells(scene, scene.body).pad.kind == "stiff"
    except (SceneError, DesignError):
        return False


def design_of_cells(scene: Scene, body: Sensor) -> SensorDesign:
    """The design of a scene's cells: its pads are the plates of the scene's stiff loads, and soft without these.

    `SceneError` if plates do not lie on all units alike, as squares, without moments and other loads; `DesignError` if
    they leave no gap.
    """
    design = body.design
    if not scene.stiff_loads:
        return replace(design, pad=replace(design.pad, kind="soft"))
    local: dict[Rectangle, int] = {}
    parts = [part for load in scene.stiff_loads for part in split_by_cells(load.rectangle, body, local)]
    x0, y0, x1, y1 = next(iter(local))
    if (
        sorted(unit for unit, _, _ in parts) != list(range(design.n_units))
        or len(local) > 1
        or abs((x1 - x0) - (y1 - y0)) > SAME * (x1 - x0)
        or any(any(load.moment_nmm) for load in scene.stiff_loads)
        or len(scene.loads) > len(scene.stiff_loads)
    ):
        raise SceneError(
            "copies of one cell have square plates at the same place of every unit, without moments and other loads: "
            "give each unit its plate, with force_n = [0, 0, 0] where nothing pushes."
        )
    pad = Pad(size_mm=x1 - x0, offset_x_mm=(x0 + x1) / 2, offset_y_mm=(y0 + y1) / 2, kind="stiff")
    return replace(design, pad=pad)


def forces_on_cells(scene: Scene, body: Sensor, local: dict[Rectangle, int]) -> FloatArray:
    """Forces of the loads on each cell, (n_units, k, 3) [N], at the k rectangles of cells that `local` then numbers."""
    loads = [(load.rectangle, np.zeros(3)) for load in scene.stiff_loads]  # their forces are among the dead loads
    loads += [(load.rectangle, np.prod(load.size_mm) * np.array(load.traction_mpa)) for load in scene.dead_loads]
    parts = [split_by_cells(rectangle, body, local) for rectangle, _ in loads]
    newtons = np.zeros((body.design.n_units, len(local), 3))
    for (_, whole), shares in zip(loads, parts, strict=True):
        for unit, rectangle, share in shares:
            newtons[unit, rectangle] += share * whole
    return newtons


def split_by_cells(rectangle: Rectangle, body: Sensor, local: dict[Rectangle, int]) -> list[Share]:
    """The parts of a rectangle on each cell, as rectangles in the cell's own coordinates, numbered in `local`."""
    half = body.design.array.pitch_mm / 2
    x0, y0, x1, y1 = rectangle
    shares = []
    for number, (x, y) in enumerate(unit_centres(body.design)):
        a0, a1 = max(x0 - x, -half), min(x1 - x, half)
        b0, b1 = max(y0 - y, -half), min(y1 - y, half)
        area = max(a1 - a0, 0.0) * max(b1 - b0, 0.0)
        if area > 1e-12 * (x1 - x0) * (y1 - y0):
            part = (round(a0, 9), round(b0, 9), round(a1, 9), round(b1, 9))
            shares.append((number, local.setdefault(part, len(local)), area / ((x1 - x0) * (y1 - y0))))
    return shares


def solve_by_cells(scene: Scene) -> Solution:
    """Solve a scene of an array with loads and mean probes anywhere on its top, by copies of one cell.

    Rectangles that lie on several cells are split among them. The error is estimated as of responses, see
    `DesignCell.at_stage`. `SolverError` if an answer cannot be trusted.
    """
    # loaded when it is needed: plans are made of all scenes
    from fem.array.coupled_cells import CoupledArray
    from fem.array.design_cell import DesignCell

    assert isinstance(scene.body, Sensor)  # the plan takes cells for arrays and mean probes only
    design = design_of_cells(scene, scene.body)
    local: dict[Rectangle, int] = {}
    probes = [split_by_cells(probe.rectangle, scene.body, local) for probe in scene.probes]
    forces = forces_on_cells(scene, scene.body, local).reshape(design.n_units, -1, 1)
    residuals: list[float] = []

    def answer(cell: "CondensedCell") -> FloatArray:
        """Means of the probes, and the energy in a row of its own, (n_probes + 1, 3)."""
        moved, residual = CoupledArray(cell, design.array.rows, design.array.cols).moved(forces)
        residuals.append(residual)
        energy = float((moved.ravel() * forces.ravel()).sum()) / 2
        moved = moved.reshape(design.n_units, -1, 3)
        means = [np.sum([share * moved[unit, part] for unit, part, share in shares], axis=0) for shares in probes]
        return np.array([*means, [energy, 0.0, 0.0]])

    def named(found: FloatArray) -> dict[str, FloatArray]:
        return {probe.name: mean for probe, mean in zip(scene.probes, found[:-1], strict=True)}

    refined, found = DesignCell(design, np.array(list(local))).refined(
        scene.tolerance, answer, lambda one, other: largest_error(named(one), named(other))
    )
    spent = dict(zip(("mesh", "condense", "solve"), refined.seconds.values(), strict=True))
    return Solution(
        probes=named(found),
        energy_mj=float(found[-1, 0]),
        residual=max(refined.residual, *residuals),
        unknowns=refined.finest.unknowns,
        error_estimate=refined.error_estimate,
        seconds=Stopwatch().seconds | spent,
        steps=refined.steps,
    )
