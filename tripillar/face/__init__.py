"""The functions that `import tripillar` gives: each job of the command line, with plain arguments and good defaults.

`bodies.py` solves and shows, `learning.py` makes samples and networks, `boards.py` reads sensors, `files.py` writes.
Responses come from the cache that the commands use, too. Every function loads its stage when it is called.
"""
