"""Data sets made by a pool of workers, part by part: a run that was stopped or killed is taken up again.

`leaves.py` makes zarr directories of any size, `finite_samples.py` samples at finite strain, both by `parts.py`.
"""
