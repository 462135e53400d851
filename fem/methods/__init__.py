"""Methods that solve a scene.

In the order of the data: `solving.py` (the entry), `plan.py` (chooses the method), then one of
`box_refinement.py` (boxes split where the probes need it), `adaptive.py` (the loop that
refines, and bisected tetrahedra, finite strain too) and `cell_scene.py` (arrays, by copies of one cell).
"""
