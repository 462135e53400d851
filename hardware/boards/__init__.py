"""Boards that are not there: frames from Python, and the firmware on a simulated chip."""
