"""Columns of resistances and forces: `columns` takes them from samples, `scaling` prepares them for a network."""
