"""Samples as columns of resistances and forces, a draw of too many samples, measured pairs, and loads to be expected."""
