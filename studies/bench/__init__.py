"""Run time against error, of the product beside NGSolve and CalculiX and of each stage of it.

Open `gate.py` first: it races programs to true errors. `scenes.py` holds scenes, `references.json` their converged
answers (made by `reference.py`), `peers/` the other programs.
"""
