"""Trials at the edge of what can be solved: each is right, refused with a reason, or WRONG.

Open `trials.py` first; `scenes.py` and `finite.py` hold the trials. Trainings at their edge are tests.
"""
