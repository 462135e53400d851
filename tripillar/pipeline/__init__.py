"""The whole way of `tripillar run`, from a design to a table of decoupling errors.

`run.py` holds the stages from top to bottom. `comparison.py` makes the table, with the sensor of `manufactured.py`.
"""
