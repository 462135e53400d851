"""Other programs on the same scenes, each used as its experts would: NGSolve.

Open `ngsolve_peer.py` first; `conduction.py` and `contact.py` hold two solvers of the product to NGSolve.
"""
