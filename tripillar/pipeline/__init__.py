"""The whole way of `tripillar run`, from a design to a table of decoupling errors.

`run.py` holds the stages from top to bottom, `stage.py` those that other commands run alone, too. `comparison.py` makes
the table, with the sensor of `manufactured.py`.
"""
