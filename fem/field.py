"""The displacement of the whole body under given loads: for pictures; no dataset needs it."""

from fem.linear_solver import checked_solve, factorized
from fem.patch import patch_means
from fem.whole_array import elastic_body
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pad_squares
from geometry.mesh import TetMesh


def displacement_field(design: SensorDesign, mesh: TetMesh, traction_mpa: FloatArray) -> FloatArray:
    """Displacement of every mesh point.

    Parameters
    ----------
    design : SensorDesign
    mesh : TetMesh
        Of that design.
    traction_mpa : array, shape (n_units, 3)
        Traction on each pad along x, y, z; z negative pushes down [MPa].

    Returns
    -------
    array, shape (n_points, 3)
        In the order of the mesh's points [mm].
    """
    body = elastic_body(design, mesh)
    newtons = traction_mpa.ravel() * design.pad.size_mm**2
    loads = patch_means(body.basis, pad_squares(design)).T @ newtons
    solution, _ = checked_solve(body.matrix, factorized(body.matrix), body.loads(loads[:, None]))
    nodes = body.displacements(solution).reshape(-1, 3)
    return nodes[body.basis.nodal_dofs[0]]
