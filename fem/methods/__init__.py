"""Methods that solve a scene.

In the order of the data: `solving.py` (the entry), `plan.py` (chooses the method), `adaptive.py` (refines any mesh
until the probes are as accurate as asked), then `box_refinement.py` (boxes split where the probes need it) or
`cell_scene.py` (arrays, by copies of one cell).
"""
