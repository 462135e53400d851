"""Sparse direct factorisations and checked solves."""
