"""The page of `tripillar view --serve`: the array in a browser, deforming as its pads are loaded.

In: a design, perhaps a model and a sensor. Out: a page on a port of this machine. `server.py` listens, lets browsers in
and gives each a page (`page.py`), which checks its messages. They set its controls (`controls.py`). It loads the array,
moves the scene (`scene.py`), has it drawn (`pictures.py`), and sends resistances and forces (`sensing.py`).
`page.html`, `page.css` and the `.js` files run in the browser.
"""
