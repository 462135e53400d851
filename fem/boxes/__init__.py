"""Boxes: functions along a line (`lagrange.py`), graded lines (`lines.py`), elements of any order (`boxes.py`), and how
they are split where fine ones meet coarse ones (`splitting.py`).
"""
