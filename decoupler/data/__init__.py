"""Samples as columns of resistances and forces, a draw of too many of them, measured pairs, and loads to be expected."""
