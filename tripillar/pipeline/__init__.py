"""The way from a design to a table of decoupling errors."""
