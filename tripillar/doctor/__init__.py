"""``tripillar doctor``: whether this machine has what TriPillar needs, and whether known answers come out.

Out: a list of `Check`. Open `surroundings.py` for what is looked at, `known_answers.py` for what is computed.
"""
