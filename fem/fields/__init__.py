"""Displacement and stress anywhere in a loaded body, for pictures.

In the order of the data: `stress.py` (stress of finite elements), `array_field.py` (inside of a cell and of an array,
and loads to show), `deformed.py` (a loaded sensor or scene in parts to draw).
"""
