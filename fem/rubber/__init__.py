"""Rubber: `law.py` (stress and tangent of a material), `body.py` (elements filled with it)."""
