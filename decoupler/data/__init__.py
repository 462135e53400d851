"""Samples as columns of resistances and forces, a draw of too many, measured pairs, and loads to be expected.

Open `columns.py` first.
"""
