"""Columns of resistances and forces: which, scaled how, and which samples."""
