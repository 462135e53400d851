"""Samples as columns of resistances and forces, measured pairs, and loads to be expected.

Open `columns.py` first.
"""
