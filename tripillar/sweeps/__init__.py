"""Design sweeps: many arrays compared by error, range, crosstalk and cost.

In: a sweep file (a base design, the keys to vary, how to sample them). Out: a row of metrics a design, from its
finite-element response alone, as Parquet, with pictures. `sweep_file.py` reads what is varied (`variables.py`),
`sampling.py` makes designs of it, `run.py` has a pool judge them (`judge.py`) and keeps the `rows.py`, and
`trade_offs.py` shows the best. `optimize.py` searches for the best design instead.
"""
