"""The page of `tripillar view --serve`: the array in a browser, deforming as its pads are loaded.

In: a design, perhaps a model and a sensor. Out: a page on a port of this machine. Open `page.py` first: what a
browser's controls (`controls.py`) and the sensor say (`loads.py`, `feed.py`) goes through `sensing.py` to the numbers
(`numbers.py`) and through `superposition.py` to the scene (`scene.py`, `cell_points.py`, `camera.py`), of which
`pictures.py` makes pictures. Each browser has a page of its own (`session.py`); `serving.py` listens, `guard.py` says
who is let in. What runs in the browser is `page.html`, `page.css`, `page.js` and `picture.js`; `options.py` and
`opening.py` are what the command knows.
"""
