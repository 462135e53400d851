"""Files: written whole or not at all, read back with their hash checked."""
