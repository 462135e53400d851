"""Other programs on the same scenes, each used as its experts would.

All solve the whole body on two threads. Open `scikit_fem.py`, `ngsolve_peer.py` or `calculix.py`; they share the grids
of `grids.py`.
"""
