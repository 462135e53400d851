"""Bodies of tetrahedra: `mesh.py` (meshes of scenes, their refinement), `taylor_hood.py` (elements filled with rubber),
`indicator.py` (where an answer errs), `solving.py` and `finite.py` (scenes, at small and at finite strain).
"""
