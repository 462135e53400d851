"""Rubber at finite strain: boxes of neo-Hookean rubber under dead, following and stiff loads.

In: a scene, or a design and the forces on its pads. Out: displacements with an estimate of their error (`solving.py`:
open it first), or those of thousands of samples (`samples.py`). In the order of the data: `rubber_body.py` (elements:
stresses, tangents), `loads.py` (loads on these), `plates.py` (rigid plates), `system.py` (body, loads and plates as one
system of equations), `newton.py` (its solution, step by step), `mirrored.py` (halves and quarters of scenes),
`series.py` (the response as a power series in the load), `relaxation.py` (many samples by one tangent), `preloads.py`
(both for an array on one grid).
"""
