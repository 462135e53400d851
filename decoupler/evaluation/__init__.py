"""Errors of a model, and what they are held against.

`plausibility` looks at the samples, `metrics` holds the errors, `assessment` puts limits and baselines beside them, and
`crossval` trains and tests on parts of the samples. `faults` names broken pillars and wires in windows of scans.
"""
