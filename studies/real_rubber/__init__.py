"""The law of rubber, and training without a design, judged on what others measured, and on a simulated array.

In: clones of three repositories. Open `published.py` first; `readers.py` reads, `others.py` has methods beside ours.
"""
