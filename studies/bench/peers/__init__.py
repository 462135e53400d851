"""Other programs on the same scenes, each used as its experts would: NGSolve and CalculiX.

`ngsolve_by_hand.py` and `calculix.py` race in `gate.py`; `table.py` holds contact and conduction to NGSolve.
"""
