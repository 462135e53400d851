"""Meshes of scikit-fem: hexahedra between graded lines (`lines.py`, `grid.py`), tetrahedra (`tetrahedra.py`)."""
