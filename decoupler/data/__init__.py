"""Columns of resistances and forces (`columns`), samples that repeat one another (`repeats`), loads to be expected."""
