"""Displacement and stress anywhere in a loaded body, for pictures.

In the order of the data: `pad_loads.py` (loads to show), `cell_field.py` (the inside of a cell), `array_field.py` (of
an array, by superposition), `stress.py` (stress of finite elements), `deformed.py` (a loaded sensor in parts to
draw), `scene_parts.py` (a loaded scene likewise).
"""
