"""Run time against error: the default path, its contrasts and its peers on the same scenes, in one run.

In: the scenes of `scenes.py` and their converged answers, `references.json`. Out: a table, a JSON and a picture. Open
`work_precision.py` first, then `reference.py` (where the truth comes from) and `peers/` (who is compared).
"""
