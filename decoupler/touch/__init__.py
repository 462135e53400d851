"""Forces from whatever presses on bare rubber: a library of presses, and how one of them is fitted to a scan.

In the order of the data: `presses.py` (presses as fields of traction), `library.py` (their contacts solved, and put
wherever they may be), `regression.py` (the fast answer, from the nearest of them), `morph.py` (presses moved,
stretched, turned and dragged until they explain a scan), `decoder.py` (both as one decoder, and what it finds in
users' words: open this file first), `touch_file.py`, `assessment.py`.
"""
