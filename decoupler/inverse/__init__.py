"""The array's response, forwards and backwards.

`sensor_model` gives resistances for forces and, by its inverse, forces for resistances; `strain_maps` are what finite
strain adds, and `posterior` turns them around; `limits` has the least error that noise leaves.
"""
