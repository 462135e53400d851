"""A unit by scikit-fem's forms: closed forms, a second assembly, and how far the response's cell is from it."""

from dataclasses import replace

import numpy as np
import pytest
from skfem import MeshTet

from fem.array.unit_check import check_unit, meshed_response
from fem.factor import Factor, checked_solve
from fem.tetrahedra.mixed import taylor_hood
from fem.tetrahedra.patch import patch_means
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.layout import electrode_squares, pad_squares
from geometry.mesh import TetMesh
from tests.fem.scenes import box_mesh

PAIR = SensorDesign(array=Array(rows=1, cols=2))


def structured(design: SensorDesign, cells: tuple[int, int, int]) -> TetMesh:
    """The slab in a regular mesh: the same at every run, and symmetric enough for closed statements."""
    x, y, h = design.slab_mm
    box = box_mesh(cells, (x, y, h))
    points = box.p.T - np.array([x / 2, y / 2, 0.0])
    return TetMesh(points, box.t.T.astype(np.int64), np.zeros(box.nelements, dtype=np.int64))


def of_rubbers(design, mesh):
    tets = MeshTet(mesh.points_mm.T.copy(), mesh.cells.T.copy())
    return taylor_hood(tets, [design.matrix_material, design.pillar_material], mesh.region)


def test_two_assemblies_are_one_system():
    """Forms of scikit-fem against the assembly of products, two rubbers side by side: equal to rounding."""
    design = replace(PAIR, pillar_material=Material(young_mpa=20.0, poisson=0.3))
    mesh = structured(design, (6, 4, 3))
    mesh = replace(mesh, region=(mesh.points_mm[mesh.cells].mean(axis=1)[:, 0] > 0).astype(np.int64))
    response = meshed_response(design, mesh)
    body = of_rubbers(design, mesh)
    pads, electrodes = (patch_means(body.basis, squares(design)) for squares in (pad_squares, electrode_squares))
    x, _ = checked_solve(Factor(body.matrix), body.loads(pads.T.toarray()))
    expected = (electrodes @ body.displacements(x)).reshape(response.influence_mm_per_n.shape)
    assert response.unknowns == body.matrix.shape[0]
    assert response.residual < 1e-12
    assert np.abs(response.influence_mm_per_n - expected).max() < 1e-11 * np.abs(expected).max()
    own = response.influence_mm_per_n[0, 0, :, :, 0, 0, :]  # (electrode, axis, load axis)
    assert (np.einsum("eaa->ea", own) > 0).all()  # a pad pushed down sinks, a pulled one follows


def test_pads_obey_reciprocity_and_energy_is_positive():
    """Betti: the mean displacement of pad a under a unit force on b equals that of b under one on a, to rounding.

    So the pad-to-pad matrix is symmetric; the work ½ fᵀ(Cf) it does is the strain energy, positive for any force.
    """
    body = of_rubbers(PAIR, structured(PAIR, (8, 4, 3)))
    pads = patch_means(body.basis, pad_squares(PAIR))
    x, _ = checked_solve(Factor(body.matrix), body.loads(pads.T.toarray()))
    compliance = pads @ body.displacements(x)
    assert np.abs(compliance - compliance.T).max() < 1e-12 * np.abs(compliance).max()
    assert np.linalg.eigvalsh(compliance).min() > 0
    # the body stores ½ ∫ 2μ ε:ε + p²/λ, in the blocks A and −C of the mixed matrix
    force = np.array([1.0, -2.0, 3.0, 0.5, 0.0, -1.0])
    n = len(body.free)
    moved, pressure = (x @ force)[:n], (x @ force)[n:]
    stored = (moved @ (body.matrix[:n, :n] @ moved) - pressure @ (body.matrix[n:, n:] @ pressure)) / 2
    assert np.isclose(stored, force @ compliance @ force / 2, rtol=1e-11)


def test_a_uniform_load_is_the_sum_of_its_pads():
    """Touching pads that tile the slab load it like one large one: with ν = 0 it is compressed by u_z = −p h / E."""
    rubber = Material(poisson=1e-6)
    design = replace(PAIR, pad=Pad(size_mm=15.0), pillar_material=rubber, matrix_material=rubber)
    tiled = meshed_response(design, structured(design, (6, 3, 2)))
    under_1_mpa = tiled.influence_mm_per_n[..., 2].sum(axis=(4, 5)) * -(15.0**2)
    assert np.allclose(under_1_mpa[..., 2], -10.0 / rubber.young_mpa, rtol=1e-5)
    assert np.abs(under_1_mpa[..., :2]).max() < 1e-5


@pytest.mark.parametrize("matrix_mpa", [6.1, 1.0])
def test_the_cell_of_a_response_is_close_to_a_unit_solved_by_other_tools(shared_cache, monkeypatch, matrix_mpa):
    """The mesh's own error at its usual edges: 1.1 % of one rubber, 0.4 % with stiffer pillars. Found again at once."""
    monkeypatch.setattr("fem.array.unit_check.usual_tolerance", lambda design: 2e-2 if matrix_mpa == 6.1 else 0.1)
    design = replace(PAIR, pad=Pad(size_mm=11.0), matrix_material=Material(young_mpa=matrix_mpa))  # no other test's
    unit = check_unit(design)
    assert 1e-4 < unit.difference < (0.02 if matrix_mpa == 6.1 else 0.05)
    assert not unit.reused
    assert len(unit.files) == 2
    assert check_unit(design) == replace(unit, reused=True)
