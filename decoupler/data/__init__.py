"""Columns of resistances and forces (`columns`), and samples that repeat one another (`repeats`)."""
