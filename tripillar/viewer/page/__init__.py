"""The page of `tripillar view --serve`: the array in a browser, deforming as its pads are loaded.

In: a design, perhaps a model and a sensor. Out: a page on a port of this machine. `opening.py` takes the options of the
command; `server.py` listens, lets browsers in and gives each a session (`session.py`), which checks its messages. They
set the controls (`controls.py`) of the browser's page (`page.py`). That loads the array, moves the scene (`scene.py`),
has it drawn (`pictures.py`), and shows resistances and forces (`sensing.py`) as numbers (`numbers.py`).
`page.html`, `page.css`, `page.js`, `picture.js`, `plot.js` and `files.js` run in the browser.
"""
