"""Samples as columns of resistances and forces (`columns`), a draw of too many (`enough`), pairs, loads to be expected."""
