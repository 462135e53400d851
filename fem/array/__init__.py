"""The response of a sensor array: one condensed unit cell, copied and coupled.

In the order of the data: `solving.py` (the entry, by method), `substructured.py` (refines a cell to a tolerance and
keeps it), `meshed.py` (a cell's grid or tetrahedra), `cell.py` (condenses it onto the port modes of its side faces),
`coupled_cells.py` (couples its copies), `response.py` (the influence matrix and its file). `closed_forms.py` are the
layer and the half-space; `unit_check.py` compares the response's cell with the unit of CAD solids.
"""
