"""Rubber at finite strain under dead, following and stiff loads.

In: a scene, or a design and the forces on its pads. Out: displacements with an estimate of their error (`solving.py`:
open it first), or those of thousands of samples of an array by one tangent (`samples.py`). The equilibrium is that of
`fem.kernel.newton`.
"""
