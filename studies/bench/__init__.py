"""Run time against error of the default path, its contrasts and its peers on the same scenes and trainings, in one run.

Open `harness.py` first: it runs contenders and shows what they took. `solving.py` holds the contenders on scenes,
`scenes.py` the scenes, `references.json` their converged answers (made by `reference.py`), `peers/` the other programs;
`training/` races trainers, `arrays.py` measures array responses, `inference.py` trained nets, `hardware.py` a board.
"""
