"""The response of a sensor array: one condensed unit cell, copied and coupled.

In the order of the data: `solving.py` (the entry, by method), `design_cell.py` (a cell's grid or tetrahedra, refined to
a tolerance and kept), `cell.py` (condenses it onto the port modes of its side faces), `coupled_cells.py` (couples its
copies), `response.py` (the influence matrix and its file), `conducted.py` (pillars' resistances by conduction).
`closed_forms.py` are the layer and the half-space; `sensitivities.py` the derivatives by the design's parameters.
"""
