"""The whole way of `tripillar run`, from a design to a table of decoupling errors.

`run.py` holds the stages from top to bottom. `comparison.py` makes the table, with the sensor of `manufactured.py`
and the paper's results of `printed.py`. `learning.py` trains, tests and tunes on any samples for commands and for
Python, after the checks of `data_checks.py`.
"""
