"""The array's response, forwards and backwards.

`forward_model` gives resistances for forces and, by its inverse, forces for resistances; `sample_checks` holds samples
against it; `limits` has the least error that noise leaves.
"""
