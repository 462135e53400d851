"""Nearly incompressible rubber on scikit-fem's meshes, elements and bases, whatever is asked of it.

In the order of the data: `elements.py` (hexahedra of any order, pressures that jump), `reference.py` (their tables),
`law.py` (materials), `rubber.py` (elements filled with it), `mirrors.py`, `loads.py` and `top.py` (loads on rectangles
of the top, and integrals over these), `system.py` (the equations: one map x = T y from unknowns to nodes), `factor.py`
(factorisations and checked solves), `newton.py` (equilibrium), `field.py` (displacement and stress anywhere).
"""
