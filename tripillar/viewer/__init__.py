"""Pictures of loaded sensors and scenes for `tripillar view`.

In: a design with pressures, or a scene. `sights.py` solves for the panels, `saving.py` writes them as a picture, a
page, a film or a file for other viewers; `page/` serves an array live to browsers.
"""
