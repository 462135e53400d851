"""Boxes: `lagrange.py` (functions along a line), `lines.py` (graded lines), `boxes.py` (elements of any order), `splitting.py`."""
