"""What is said of each table and figure: every number comes from what was computed, or from `printed.py`.

A sentence that one outcome would make false is chosen by the numbers. `words.py` has the ways to say a number.
"""
