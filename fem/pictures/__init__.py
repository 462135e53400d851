"""Pictures of deformed bodies."""
