"""The whole array as one mesh: reciprocity, energy, symmetry, far pads."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.whole_array import elastic_body, whole_response
from fem.discretization.patch import patch_means
from fem.linear.linear_solver import checked_solve, factorized
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.layout import pad_squares
from geometry.mesh import TetMesh
from tests.fem.boxes import box_mesh

DESIGN = SensorDesign(array=Array(rows=2, cols=2))


def structured(design: SensorDesign, cells: tuple[int, int, int]) -> TetMesh:
    """The slab in a regular mesh: the same at every run, and symmetric enough for closed statements."""
    x, y, h = design.slab_mm
    box = box_mesh(cells, (x, y, h))
    points = box.p.T - np.array([x / 2, y / 2, 0.0])
    return TetMesh(points, box.t.T.astype(np.int64), np.zeros(box.nelements, dtype=np.int64))


@pytest.fixture(scope="module")
def response():
    return whole_response(DESIGN, structured(DESIGN, (10, 10, 4)))


def test_response_has_the_contract_s_shape_and_a_small_residual(response):
    assert response.influence_mm_per_n.shape == (2, 2, 2, 3, 2, 2, 3)
    assert response.residual < 1e-12
    assert np.isfinite(response.influence_mm_per_n).all()


def test_pads_obey_reciprocity_and_energy_is_positive():
    """Betti: the mean displacement of pad a under a unit force on b equals that of b under one on a, to rounding.

    So the pad-to-pad matrix is symmetric; the work ½ fᵀ(Cf) it does is the strain energy, positive for any force.
    """
    body = elastic_body(DESIGN, structured(DESIGN, (8, 8, 3)))
    pads = patch_means(body.basis, pad_squares(DESIGN))
    x, _ = checked_solve(body.matrix, factorized(body.matrix), body.loads(pads.T.toarray()))
    u = body.displacements(x)
    compliance = pads @ u
    assert np.abs(compliance - compliance.T).max() < 1e-12 * np.abs(compliance).max()
    assert np.linalg.eigvalsh(compliance).min() > 0
    # the body stores ½ ∫ 2μ ε:ε + p²/λ, in the blocks A and −C of the mixed matrix
    force = np.array([1.0, -2.0, 3.0, 0.5, 0.0, -1.0, 2.0, 1.0, -3.0, 0.0, 0.0, 1.0])
    n = len(body.free)
    moved, pressure = (x @ force)[:n], (x @ force)[n:]
    stored = (moved @ (body.matrix[:n, :n] @ moved) - pressure @ (body.matrix[n:, n:] @ pressure)) / 2
    assert np.isclose(stored, force @ compliance @ force / 2, rtol=1e-11)


def test_a_pad_pushed_down_sinks_and_a_pulled_one_follows(response):
    own = response.influence_mm_per_n[0, 0, :, :, 0, 0, :]  # (electrode, axis, load axis)
    assert (np.einsum("eaa->ea", own) > 0).all()


def test_units_far_away_feel_less():
    design = SensorDesign(array=Array(rows=1, cols=4))
    response = whole_response(design, structured(design, (20, 5, 4)))
    on_first = np.linalg.norm(response.influence_mm_per_n[0, :, :, :, 0, 0, :].reshape(4, -1), axis=1)
    assert (np.diff(on_first) < 0).all()
    assert on_first[3] < 0.02 * on_first[0]


def test_a_uniform_load_is_the_sum_of_its_pads(response):
    """Touching pads that tile the slab load it like one large one: the whole face's closed form for a thin sheet.

    With ν = 0 a slab under uniform pressure p is uniaxially compressed, u_z = −p h / E everywhere.
    """
    design = SensorDesign(
        array=Array(rows=2, cols=2), pad=Pad(size_mm=15.0), matrix_material=Material(poisson=0.0),
        pillar_material=Material(poisson=0.0),
    )  # fmt: skip
    tiled = whole_response(design, structured(design, (7, 7, 3)))
    under_1_mpa = tiled.influence_mm_per_n[..., 2].sum(axis=(4, 5)) * -(15.0**2)
    assert np.allclose(under_1_mpa[..., 2], -10.0 / 6.1, rtol=1e-5)  # ν is held at 1e-6 in the mixed form
    assert np.abs(under_1_mpa[..., :2]).max() < 1e-5


def test_the_modulus_scales_the_response(response):
    soft = replace(DESIGN, pillar_material=Material(young_mpa=3.05), matrix_material=Material(young_mpa=3.05))
    doubled = whole_response(soft, structured(DESIGN, (10, 10, 4)))
    assert np.allclose(doubled.influence_mm_per_n, 2 * response.influence_mm_per_n, rtol=1e-9, atol=1e-14)
