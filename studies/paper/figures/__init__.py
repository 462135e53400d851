"""The report's pictures, a file for each of its parts; each function writes one PNG."""
