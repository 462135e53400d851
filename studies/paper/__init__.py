"""The paper's figures 6 to 11, tables 1 and 2 and its claim on spacing from our own data, beside its numbers.

In: an array's response. Out: one page with all of it, the same as Markdown, pictures, and every number as JSON. Open
`report.md` first, the report as it is written by hand; `report.py` fills in its numbers. `experiments.py` trains the
networks, `spacing.py` and `deformation.py` do the mechanics, `pictures.py` draws.
"""
