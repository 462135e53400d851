"""Boards that are not there: virtual, and the firmware on a simulated chip."""
