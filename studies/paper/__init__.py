"""The paper's figures 6 to 11, tables 1 and 2 and its claim on spacing from our own data, beside its numbers.

In: an array's response. Out: one page with all of it, the same as Markdown, pictures, and every number as JSON. Open
`report.py` first, for what the report holds; `experiments.py` for the trainings, `spacing.py` and `deformation.py` for
the mechanics, `printed.py` for what the paper prints, `sections/` for what is said of both, `figures/` for pictures;
`document.py` and `page.py` turn sections into Markdown and HTML.
"""
