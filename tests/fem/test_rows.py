"""Rows of boxes on nodal values: exact for polynomials of the boxes' order, wherever points and rectangles lie."""

from dataclasses import replace

import numpy as np
import pytest

from fem.boxes.boxes import Boxes
from fem.mirrors import Mirror
from fem.rubber.body import RubberBody
from fem.scene.loads import DeadLoad, StiffLoad
from fem.scene.scene import Probe
from fem.system import System
from geometry.design import Material

LINES = np.array([0.0, 1.0, 2.0, 3.5]), np.array([0.0, 0.7, 2.0]), np.array([0.0, 0.4, 1.0])


def field(points: np.ndarray) -> np.ndarray:
    """x² y + z² of points (n, 3), of degree 2 along each axis."""
    x, y, z = points.T
    return x**2 * y + z**2


@pytest.fixture(params=[(2, (0.0, 0.0)), (4, (0.3, -0.2))], ids=["order 2", "order 4, leaning"])
def boxes(request) -> Boxes:
    return Boxes.between(LINES, *request.param)


def test_values_and_slopes_at_points_are_exact(boxes):
    rng = np.random.default_rng(0)
    at = rng.random((30, 3)) * [3.5, 2.0, 1.0]
    at[0], at[1] = (0.0, 0.0, 0.0), (1.0, 0.7, 0.4)  # a corner, and where eight boxes meet
    at = at @ boxes.shear.T
    nodal = field(boxes.points_mm)
    assert np.allclose(boxes.at(at) @ nodal, field(at), atol=1e-12)
    slopes = (boxes.slopes(at) @ nodal).reshape(3, -1)
    step = 1e-6 * np.eye(3)
    expected = [(field(at + d) - field(at - d)) / 2e-6 for d in step]
    assert np.allclose(slopes, expected, atol=1e-8)  # of the difference quotient


def test_integrals_over_rectangles_are_exact_wherever_their_edges_lie(boxes):
    shift = np.array(boxes.lean) * boxes.height_mm
    x0, y0, x1, y1 = rectangle = np.array([0.5, 0.1, 2.7, 1.9]) + np.tile(shift, 2)
    whole = np.array([0.0, 0.0, 3.5, 2.0]) + np.tile(shift, 2)
    rows = boxes.integrals(np.array([rectangle, whole, whole + 100.0]))
    assert np.allclose(np.asarray(rows.sum(axis=1)).ravel(), [2.2 * 1.8, 7.0, 0.0])
    exact = (x1**3 - x0**3) / 3 * (y1**2 - y0**2) / 2 + (x1 - x0) * (y1 - y0)
    assert np.isclose((rows @ field(boxes.points_mm))[0], exact, rtol=1e-12)


@pytest.mark.parametrize(("parities", "order"), [((1, -1), 4), ((-1, 1), 2)])
def test_a_quarter_with_its_parity_is_the_whole(parities, order):
    """Loads of a parity, one on a plate across both planes, around an inclusion: seen beyond the planes, and energy."""
    line, z = np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]), np.array([0.0, 1.0, 2.0])
    along_x, along_y = parities
    loads = [
        DeadLoad(center_mm=(x, y), size_mm=(1.0, 0.8), traction_mpa=(-sx * sy * 0.2 * x, 0.0, sx * sy))
        for x in (-2.3, 2.3)
        for y in (-2.4, 2.4)
        for sx, sy in [(along_x if x < 0 else 1, along_y if y < 0 else 1)]
    ]
    force = (float(parities == (-1, 1)), float(parities == (1, -1)), float(parities == (1, 1)))
    turn = (float(parities == (1, -1)), float(parities == (-1, 1)), float(parities == (-1, -1)))
    loads.append(StiffLoad(center_mm=(0.0, 0.0), size_mm=(2.0, 4.0), force_n=force, moment_nmm=turn))
    probes = (
        Probe(name="mean", kind="mean", center_mm=(-1.9, 0.2), size_mm=(1.0, 3.0)),
        Probe(name="point", kind="point", position_mm=(-1.2, 2.4, 1.3)),
    )
    mirrors = tuple(Mirror(axis=axis, position_mm=0.0, parities=(1, -1)) for axis in (0, 1))
    answers = []
    for lines, planes in (((line, line, z), ()), ((line[3:], line[3:], z), mirrors)):
        boxes = Boxes.between(lines, order)
        stiff = (np.abs((boxes.low + boxes.high) / 2)[:, :2] < 1.0).all(axis=1)
        body = RubberBody.of(replace(boxes, region=stiff.astype(int)), [Material(), Material(young_mpa=61.0)])
        system = System(body, loads, planes, parities if planes else None)
        factor, forces = system.new_factor(), system.loads_on(system.rest()).reshape(-1, 1)
        factor.factor(system.matrix(system.rest_tangent()))
        y = factor.solve(forces)
        u = system.displaced(y)[0]
        energy = system.copies * float((forces * y).sum())
        answers.append([*(system.seen(probe, u) for probe in probes), np.full(3, energy)])
    assert np.allclose(*answers, rtol=1e-9, atol=1e-12)
