"""Displacement and stress anywhere in a loaded body, for pictures."""
