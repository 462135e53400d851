"""Boxes: functions along a line (`lagrange.py`), graded lines (`lines.py`), elements of any order (`boxes.py`)."""
