"""Design sweeps: which array should I build?

In: a sweep file (a base design, the keys to vary, how to sample them). Out: a row of figures a design, from its
finite-element response alone, as Parquet and NetCDF, with pictures. Open `merits.py` first for what the figures mean,
`sweep_file.py` for the file, `run.py` for the work; `optimize.py` searches for the best design instead.
"""
