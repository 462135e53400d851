"""Meshes of scikit-fem: hexahedra between graded lines (`lines.py`, `grid.py`) or split one by one between lines that
lean with what lies in a body (`boxes.py`, `leaning.py`), and tetrahedra (`tetrahedra.py`)."""
