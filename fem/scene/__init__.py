"""A scene as numbers, and its solution.

In the order of the data: `scene_file.py` (reads TOML), `scene.py` (body, loads, probes, checked), `solution.py` (the
probes' displacements with their error, as JSON and VTU).
"""
