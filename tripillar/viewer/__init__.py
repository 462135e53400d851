"""Pictures of loaded sensors and scenes for `tripillar view`.

In: a design with pressures, or a scene. `panels.py` has the panels of a picture solved, `saving.py` writes pictures,
pages, films and files for other viewers; `page/` serves an array to browsers. `face/viewing.py` puts them together.
"""
