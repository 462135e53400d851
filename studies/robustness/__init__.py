"""The cost of noise, converters, dead pillars, and of sensors that are not the simulator, with what pairs buy back.

Open `nets.py` first for nets on ever worse sensors, `truths.py` for sensors identified from measured pairs.
"""
