"""The page of `tripillar view --serve`: the array in a browser, deforming as its pads are loaded.

In: a design, perhaps a model and a sensor. Out: a page on a port of this machine. Open `page.py` first: what controls
and sensor say (`loads.py`, `feed.py`) goes through `sensing.py` to the numbers (`numbers.py`) and through
`superposition.py` to the scene (`scene.py`, `cell_points.py`), of which `pictures.py` sends pictures. `layout.py` and
`page.css` say where all that stands, `serving.py` listens, `options.py` and `opening.py` are what the command knows.
"""
