"""A unit by scikit-fem's forms: closed forms, a second assembly, and how far the response's cell is from it."""

from dataclasses import replace

import numpy as np
from skfem import MeshTet

from fem.array.unit_check import check_unit, meshed_response
from fem.factor import Factor, checked_solve
from fem.tetrahedra.mixed import taylor_hood
from fem.tetrahedra.patch import patch_means
from fem.tetrahedra.system import TetrahedralSystem
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
    system = TetrahedralSystem(body, [])
    x, _ = checked_solve(Factor(body.upper, upper=True), system.rest_loads(pads.toarray().reshape(6, -1, 3)))
    expected = (electrodes @ system.displaced(x).reshape(6, -1).T).reshape(response.influence_mm_per_n.shape)
    assert response.unknowns == system.n_unknowns
    assert response.residual < 1e-12
    assert np.abs(response.influence_mm_per_n - expected).max() < 1e-11 * np.abs(expected).max()
    own = response.influence_mm_per_n[0, 0, :, :, 0, 0, :]  # (electrode, axis, load axis)
    assert (np.einsum("eaa->ea", own) > 0).all()  # a pad pushed down sinks, a pulled one follows


def test_the_cell_of_a_response_is_close_to_a_unit_solved_by_other_tools(shared_cache, monkeypatch):
    """The mesh's own error at its usual edges is 0.4 % with stiffer pillars. Found again at once."""
    monkeypatch.setattr("fem.array.unit_check.usual_tolerance", lambda design: 0.1)
    design = replace(PAIR, pad=Pad(size_mm=11.0), matrix_material=Material(young_mpa=1.0))  # no other test's
    unit = check_unit(design)
    assert 1e-4 < unit.difference < 0.05
    assert not unit.reused
    assert len(unit.files) == 2
    assert check_unit(design) == replace(unit, reused=True)
