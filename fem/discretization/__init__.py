"""Meshes, elements and their matrices."""
