"""Scans as other programs understand them: Foxglove, Rerun, ROS 2.

In: the scans of a `LiveSensor` or of a recording. Out: a description of the sensor, once, and a `TactileFrame` a scan.
Open `tactile_frame.py` first; `foxglove_stream.py`, `rerun_stream.py` and `ros2_file.py` are one adapter each, and load
their packages only when used.
"""
