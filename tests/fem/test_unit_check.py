"""A unit meshed whole: its assembly against scikit-fem's forms, and how far the response's cell is from it."""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, ElementVector, MeshTet
from skfem.helpers import ddot, div, sym_grad

from fem.array.unit_check import check_unit, meshed_response
from fem.factor import Factor, checked_solve
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


# scikit-fem hands fields and parameters to these as types of its own
shear = BilinearForm(lambda u, v, w: 2 * w.mu * ddot(sym_grad(u), sym_grad(v)))
dilation = BilinearForm(lambda u, q, w: div(u) * q)
compression = BilinearForm(lambda p, q, w: p * q / w.lame)


def test_the_assembly_is_that_of_scikit_fem_s_forms():
    """Two rubbers side by side, the pressure free to jump between them: one matrix, one answer, to rounding."""
    design = replace(PAIR, pillar_material=Material(young_mpa=20.0, poisson=0.3))
    mesh = structured(design, (6, 4, 3))
    mesh = replace(mesh, region=(mesh.points_mm[mesh.cells].mean(axis=1)[:, 0] > 0).astype(np.int64))
    tets, A, B, C = MeshTet(mesh.points_mm.T.copy(), mesh.cells.T.copy()), [], [], []
    for region, rubber in enumerate((design.matrix_material, design.pillar_material)):
        own = np.flatnonzero(mesh.region == region)
        moved = Basis(tets, ElementVector(ElementTetP2()), elements=own, intorder=2)
        pressure = Basis(tets, ElementTetP1(), elements=own, intorder=2)
        nodes, (lame, mu) = np.unique(pressure.element_dofs), rubber.lame_mpa
        A.append(shear.assemble(moved, mu=mu))
        B.append(dilation.assemble(moved, pressure)[nodes])
        C.append(compression.assemble(pressure, lame=lame)[nodes][:, nodes])
    free = np.flatnonzero(moved.doflocs[2] > 0)  # the base is clamped
    div_u = sp.vstack(B)[:, free]
    K = sp.bmat([[sum(A)[free][:, free], div_u.T], [div_u, -sp.block_diag(C)]], format="csr")
    component = Basis(tets, ElementTetP2(), intorder=2)
    pads, electrodes = (patch_means(component, squares(design)) for squares in (pad_squares, electrode_squares))
    x, _ = checked_solve(Factor(K), np.vstack([pads.T.toarray()[free], np.zeros((div_u.shape[0], pads.shape[0]))]))
    response = meshed_response(design, mesh)
    expected = (electrodes[:, free] @ x[: len(free)]).reshape(response.influence_mm_per_n.shape)
    assert response.unknowns == K.shape[0]
    assert response.residual < 1e-12
    assert np.abs(response.influence_mm_per_n - expected).max() < 1e-11 * np.abs(expected).max()
    own = response.influence_mm_per_n[0, 0, :, :, 0, 0, :]  # (electrode, axis, load axis)
    assert (np.einsum("eaa->ea", own) > 0).all()  # a pad pushed down sinks, a pulled one follows


def test_the_cell_of_a_response_is_close_to_a_unit_solved_by_other_tools(shared_cache, monkeypatch):
    """The mesh's own error at its usual edges is 1 %. Found again at once."""
    monkeypatch.setattr("fem.array.unit_check.usual_tolerance", lambda design: 0.1)
    design = replace(PAIR, pad=Pad(size_mm=11.0))  # no other test's
    unit = check_unit(design)
    assert 1e-4 < unit.difference < 0.05
    assert not unit.reused
    assert len(unit.files) == 2
    assert check_unit(design) == replace(unit, reused=True)
