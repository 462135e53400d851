"""The cost of noise, converters, spread pillars and dead ones to the joint three-axis nets.

Open `study.py` first; `python -m studies.robustness` prints its table and writes JSON and pictures.
"""
