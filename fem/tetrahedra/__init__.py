"""Tetrahedra, where rubbers meet on leaning faces: `scene_mesh.py` (a scene's mesh, its refinement), `mixed.py`
(elements, points in them, rubber of any law that fills them), `patch.py` (integrals over rectangles of the top),
`system.py` (their equations under loads), `adapted.py` (solves on meshes that are refined where the answer errs).
"""
