"""Stiff pads: rigid plates bonded to the rubber, in condensed cells and responses of arrays."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.solving import ResponseSettings, solve_response
from fem.kernel.loads import StiffLoad
from fem.methods.plan import make_plan
from fem.methods.solving import follow
from fem.scene.scene import Scene, Sensor
from geometry.design import Array, Pad, SensorDesign
from geometry.layout import electrode_squares
from tests.fem.scenes import mean

ALONE = SensorDesign(array=Array(rows=1, cols=1), pad=Pad(kind="stiff"))


@pytest.mark.parametrize("force_n", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_boxes_bond_plates_as_cells_do(force_n):
    """A quarter of a unit by its parity, the whole of it and its cell: one answer to the sum of the estimates."""
    squares = electrode_squares(ALONE)
    probes = [mean(str(k), ((a + c) / 2, (b + d) / 2), (c - a, d - b)) for k, (a, b, c, d) in enumerate(squares)]
    load = StiffLoad(center_mm=(0.0, 0.0), size_mm=(12.0, 12.0), force_n=force_n)
    scene = Scene(
        body=Sensor(design=ALONE), material=ALONE.matrix_material, loads=(load,), probes=probes, tolerance=2e-2
    )
    plan = make_plan(scene, field=True)  # boxes, as no cell knows the displacement of the whole body
    assert plan.method == "boxes"
    assert [len(mirror.parities) for mirror in plan.mirrors] == [1, 1]
    quarter, whole = follow(plan, scene), follow(replace(plan, mirrors=()), replace(scene, tolerance=6e-2))
    cell = solve_response(ALONE, ResponseSettings(tolerance=1e-2))
    found = np.array(list(quarter.probes.values()))
    for other, estimate in (
        (np.array(list(whole.probes.values())), whole.error_estimate),
        (cell.influence_mm_per_n[0, 0, :, :, 0, 0, :] @ force_n, cell.error_estimate),
    ):
        off = np.linalg.norm(found - other, axis=1).max() / np.linalg.norm(other, axis=1).min()
        assert off < quarter.error_estimate + estimate


def test_forces_and_moments_are_spread_over_the_plate():
    """Couples on its halves: their sum and their moment about the middle are those stated."""
    load = StiffLoad(center_mm=(3.0, 1.0), size_mm=(4.0, 2.0), force_n=(1.0, -2.0, 3.0), moment_nmm=(5.0, 7.0, -4.0))
    forces = np.array([np.prod(one.size_mm) * np.array(one.traction_mpa) for one in load.spread])
    arms = np.array([(*one.center_mm, 0.0) for one in load.spread]) - (3.0, 1.0, 0.0)
    assert np.allclose(forces.sum(axis=0), load.force_n)
    assert np.allclose(np.cross(arms, forces).sum(axis=0), load.moment_nmm)
