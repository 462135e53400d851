"""Rubber at finite strain: boxes of neo-Hookean rubber under dead, following and stiff loads.

In: a scene's body and loads of a kind each (`loads.py`). Out: displacements with an estimate of their error
(`solving.py`, open it first). In the order of the data: `rubber_body.py` (elements, stresses and tangents), `loads.py`,
`plates.py` (rigid plates), `system.py` (body, loads and plates as one system of equations), `newton.py` (its solution,
step by step), `solving.py` (grids, probes and estimates), `series.py` and `samples.py` (thousands of loads on one
body).
"""
