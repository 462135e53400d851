"""Meshes, elements and their matrices.

Shared: `mirrors.py` (symmetry and parity), `richardson.py` (error estimates), `patch.py` (integrals over rectangles of
the top), `plate.py` (rigid plates on it), `elements.py` (points in elements of either kind). Boxes: `lagrange.py`
(functions and stiffness), `grid.py` (lines and Q2), `box_mesh.py` and `box_system.py` (split boxes).
Tetrahedra: `scene_mesh.py` (mesh and bisection), `elasticity.py` (Taylor-Hood), `indicator.py` (where an answer errs).
"""
