"""The cost of noise, converters, dead pillars, and of sensors that are not the simulator, with what pairs buy back.

Open `study.py` first for nets on ever worse sensors, `identified.py` for sensors identified from measured pairs;
`python -m studies.robustness` prints their tables and writes JSON and pictures.
"""
