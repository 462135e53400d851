"""A scene as numbers, its file, and its answer."""
