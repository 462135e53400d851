"""Loads from whatever presses on an array: on bare rubber by a library of presses, on plates by six loads of each.

`decoder.py` is what both decoders share, and what they find in users' words: open this file first. `sensing.py` leads
from displaced electrodes to readings. On rubber, in the order of the data: `presses.py` (presses as fields of
traction), `library.py` (their contacts solved, and put wherever they may be), `regression.py` (the fast answer, from
the nearest of them), `morph.py` (presses moved, stretched, turned and dragged until they explain a scan), `bare.py`.
On plates: `plates.py`. Then `assessment.py`, and `limits.py`: the least errors, for a designer.
"""
