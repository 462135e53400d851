"""From an open port to whole frames."""
