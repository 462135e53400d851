"""Boxes: graded lines (`lines.py`), elements of any order on Lagrange functions (`boxes.py`), and how they are split
where fine ones meet coarse ones (`splitting.py`).
"""
