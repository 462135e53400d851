"""A sensor on the table, or a simulated one: what the command line does with a board.

`commands.py` has the commands. `session.py` joins port, calibration and model; `follow.py` and `view.py` show forces;
`calibrating.py` fits gains and offsets; `motion.py` and `simulated.py` make a board that is not there; `link.py`
measures the link.
"""
