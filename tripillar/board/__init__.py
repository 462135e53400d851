"""A sensor on the table, or a simulated one: what the command line does with a board.

`commands/` has the commands. `session.py` joins port, calibration and model; `follow.py` and `view.py` show forces,
`keep.py` records, `calibrating.py` fits gains and offsets, `link.py` measures the link; `motion.py` and `simulated.py`
make a board that is not there, `paper_sensor.py` the sensor and the net that benches and pictures show.
"""
