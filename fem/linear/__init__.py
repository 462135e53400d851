"""Sparse linear systems: `linear_solver.py` factors and checks, by the libraries of `factors.py`."""
