"""The laboratory: the paper's report, benchmarks, edge cases, robustness, and the pictures of the documentation.

It is not installed, and no product file imports it. `python -m studies NAME` runs one; `__main__.py` has them all.
"""
