"""The commands of a connected sensor, or of one that is simulated."""
