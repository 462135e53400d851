"""Stiff pads: rigid plates bonded to the rubber, in condensed cells and responses of arrays."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.solving import ResponseSettings, solve_response
from fem.methods.plan import make_plan
from fem.methods.solving import follow
from fem.scene.loads import StiffLoad
from fem.scene.scene import Probe, Scene, Sensor
from geometry.design import Array, Pad, SensorDesign
from geometry.layout import electrode_squares, unit_centres

STIFF = replace(SensorDesign(), array=Array(rows=2, cols=3), pad=Pad(kind="stiff"))


@pytest.fixture(scope="module")
def response():
    return solve_response(STIFF, ResponseSettings(tolerance=0.1))


def test_electrodes_turn_with_their_plate(response):
    """u = d + θ × r: U1 and U2, apart by r along y, neither part nor close, but plates do turn."""
    u = response.influence_mm_per_n
    apart = u[:, :, 1] - u[:, :, 0]
    assert np.abs(apart).max() > 1e-4
    assert np.abs(apart[:, :, 1]).max() < 1e-12


def test_pads_move_each_other_alike(response):
    """Betti: a force along x moves another plate's middle along x as one there moves this; U1 and U2 tell u_x there."""
    x = response.influence_mm_per_n[:, :, :, 0, :, :, 0].mean(axis=2).reshape(6, 6)
    assert np.abs(x - x.T).max() < 1e-10 * np.abs(x).max()


def on_electrodes(design, forces_n, tolerance):
    """A scene with a plate on every unit under forces (n_units, 3), its probes all electrodes."""
    loads = [
        StiffLoad(center_mm=tuple(centre), size_mm=(12.0, 12.0), force_n=tuple(force))
        for centre, force in zip(unit_centres(design), forces_n, strict=True)
    ]
    probes = [
        Probe(name=str(number), kind="mean", center_mm=((x0 + x1) / 2, (y0 + y1) / 2), size_mm=(x1 - x0, y1 - y0))
        for number, (x0, y0, x1, y1) in enumerate(electrode_squares(design))
    ]
    body = Sensor(design=design)
    return Scene(body=body, material=design.matrix_material, loads=loads, probes=probes, tolerance=tolerance)


def moved(solution):
    return np.array(list(solution.probes.values()))


def off(one, other):
    return np.linalg.norm(one - other, axis=1).max() / np.linalg.norm(other, axis=1).min()


@pytest.mark.parametrize("force", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_boxes_bond_plates_as_cells_do(force):
    """A quarter of a unit by its parity, the whole of it and its cell: one answer to the sum of the estimates."""
    alone = replace(STIFF, array=Array(rows=1, cols=1))
    scene = on_electrodes(alone, [force], 2e-2)
    plan = make_plan(scene, field=True)  # boxes, as no cell knows the displacement of the whole body
    quarter = follow(plan, scene)
    whole = follow(replace(plan, mirrors=()), replace(scene, tolerance=6e-2))
    assert plan.method == "boxes"
    assert [len(mirror.parities) for mirror in plan.mirrors] == [1, 1]
    cell = solve_response(alone, ResponseSettings(tolerance=1e-2))
    expected = cell.influence_mm_per_n[0, 0, :, :, 0, 0, :] @ np.array(force)
    assert off(moved(quarter), moved(whole)) < quarter.error_estimate + whole.error_estimate
    assert off(moved(quarter), expected) < quarter.error_estimate + cell.error_estimate


def test_forces_and_moments_are_spread_over_the_plate():
    """Couples on its halves: their sum and their moment about the middle are those stated."""
    load = StiffLoad(center_mm=(3.0, 1.0), size_mm=(4.0, 2.0), force_n=(1.0, -2.0, 3.0), moment_nmm=(5.0, 7.0, -4.0))
    forces = np.array([np.prod(one.size_mm) * np.array(one.traction_mpa) for one in load.spread])
    arms = np.array([(*one.center_mm, 0.0) for one in load.spread]) - (3.0, 1.0, 0.0)
    assert np.allclose(forces.sum(axis=0), load.force_n)
    assert np.allclose(np.cross(arms, forces).sum(axis=0), load.moment_nmm)
