"""Answers of one day, frozen, and held against those of another: no change of the code may move them unseen.

Open `__main__.py` first; `parts.py` says what is answered, `scenes.py` holds scenes that are found nowhere else, with
the truth about them, `rows.py` finds one answer in a process of its own and compares two.
"""
