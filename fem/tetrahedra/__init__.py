"""Bodies of tetrahedra: elements filled with rubber of any law (`mixed.py`)."""
