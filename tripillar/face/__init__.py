"""The jobs: each is one public function, in Python and, by its signature and docstring, on the command line.

Files are inputs as good as objects, and are checked before a job begins (`inputs.py`); notes, progress and answers go
to the caller (`caller.py`); a stage is loaded when a job first uses a name of it (`stages.py`). `bodies.py` designs,
draws and solves, `pressing.py` presses shapes, `samples.py` makes samples, `learning.py` trains and tests after the
checks of `checks.py`, `identifying.py` finds one sensor by `twins.py`, `boards.py` reads and zeroes sensors,
`simulating.py` is one, `viewing.py` shows, `studying.py` sweeps, `exporting.py` writes.
"""
