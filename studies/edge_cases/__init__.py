"""What is at the edge of what can be solved and trained: every trial right, refused with a reason, or WRONG.

Open `trials.py` first; `scenes.py` holds the finite-element trials, `training.py` those of the networks.
"""
