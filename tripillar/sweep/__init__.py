"""Design sweeps: many arrays compared by error, range, crosstalk and cost.

In: a sweep file (a base design, the keys to vary, how to sample them). Out: a row of metrics a design, from its
finite-element response alone, as Parquet and NetCDF, with pictures. `sweep_file.py` reads what is varied
(`variables.py`), `sampling.py` makes designs of it, `run.py` gives them to `workers.py`, which judge them (`judge.py`);
`rows.py` keeps the rows, and `trade_offs.py` shows the best. `optimize.py` searches for the best design instead.
"""
