"""Meshes of tetrahedra: `scene_mesh.py` (a scene's mesh and its refinement), `indicator.py` (where an answer errs),
`patch.py` (integrals over rectangles of the top), `plate.py` (rigid plates on it), `elements.py` (points in elements).
"""
