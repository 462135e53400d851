"""Pictures of loaded sensors and scenes for `tripillar view`.

In: a design with pressures, or a scene. `showing.py` has the panels solved (`sights.py`) and opens a window or writes a
picture, a page, a film or a file for other viewers (`saving.py`); `page/` serves an array live to browsers.
"""
