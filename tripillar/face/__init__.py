"""The functions that `import tripillar` gives: each job of the command line, with plain arguments and good defaults.

`bodies.py` solves and shows, `learning.py` makes samples and networks after the checks of `checks.py`, `boards.py`
reads sensors, `files.py` writes. The commands of learning call `learning.py`, too. Responses come from the cache that
the commands use. Every function loads its stage when it is called.
"""
