"""The response of a sensor array: one condensed unit cell, copied and coupled."""
