"""The response of a sensor array: one condensed unit cell, copied and coupled.

In the order of the data: `solving.py` (the entry, by method), `substructured.py` (refines a cell to a tolerance),
`cell.py` (condenses a cell onto the `port_modes.py` of its side faces), `cell_file.py` (its file), `coupled_cells.py`
(couples its copies), `response.py` (the influence matrix and its file). `layer.py` and `halfspace.py` are closed
forms; `unit_check.py` compares the response with other tools.
"""
