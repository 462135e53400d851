"""Other programs on the same scenes, each as one who knows it well would use it.

All solve the whole body on two threads. Open `scikit_fem.py`, `ngsolve_peer.py` or `calculix.py`; they share the grids
of `grids.py`.
"""
