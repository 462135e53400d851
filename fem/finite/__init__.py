"""Rubber at finite strain under dead, following and stiff loads.

In: a scene, or a design and the forces on its pads. Out: displacements with an estimate of their error (`solving.py`:
open it first), or those of thousands of samples (`samples.py`). In the order of the data: `newton.py` (the
equilibrium of boxes or tetrahedra), `series.py` (the response as a power series in the load), `preloads.py`
(many samples of an array by one tangent).
"""
