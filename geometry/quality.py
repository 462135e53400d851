"""How well-shaped a mesh is, by VTK's quality measures."""

from dataclasses import dataclass

from geometry.mesh import TetMesh


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Shape of a mesh's tetrahedra."""

    cells: int
    worst_scaled_jacobian: float  #: 1 is a corner of a cube or better, 0 is flat
    mean_scaled_jacobian: float
    smallest_dihedral_deg: float  #: 70.5 in a regular tetrahedron


def quality(mesh: TetMesh) -> Quality:
    """Worst and mean scaled Jacobian and the smallest dihedral angle of a mesh."""
    import pyvista as pv

    grid = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.cells}, mesh.points_mm)
    measured = grid.cell_quality(["scaled_jacobian", "min_angle"])
    return Quality(
        cells=len(mesh.cells),
        worst_scaled_jacobian=float(measured["scaled_jacobian"].min()),
        mean_scaled_jacobian=float(measured["scaled_jacobian"].mean()),
        smallest_dihedral_deg=float(measured["min_angle"].min()),
    )
