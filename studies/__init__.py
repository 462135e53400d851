"""The laboratory: the paper's report, benchmarks, edge cases, robustness, and the pictures of the documentation.

It is not installed, and no product file imports it. Each room runs as `python -m studies.ROOM`; see the Makefile.
"""
