"""Forces as other programs understand them: Foxglove, Rerun, ROS 2, and files.

In: the forces of a `LiveSensor`'s scans, or those that `replay` made of a recording, each with the description of the
sensor. Open `stream.py` for what a stream is; `foxglove_stream.py`, `rerun_stream.py` and `ros2_file.py` are one
adapter each, and load their packages only when used.
"""
