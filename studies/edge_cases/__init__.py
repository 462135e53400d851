"""Trials at the edge of what can be solved and trained: each is right, refused with a reason, or WRONG.

Open `trials.py` first; `scenes.py` holds the finite-element trials, `training.py` those of the networks.
"""
