"""Meshes, elements and their matrices.

Shared: `mirrors.py` (symmetry and parity), `richardson.py` (error estimates), `assembly.py` (sparse matrices),
`patch.py` (integrals over rectangles of the top). Boxes: `grid.py` (lines), `lagrange.py` (functions and stiffness),
`kronecker.py` and `graded_box.py` (Qp), `box_mesh.py` and `box_system.py` (Q4), `hexahedra.py` (Q2). Tetrahedra:
`scene_mesh.py`, `bisection.py`, `elasticity.py` (Taylor-Hood), `indicator.py` (where an answer errs), `elements.py`
(points in elements of either kind).
"""
