"""A model of known forces, for tests of what comes before and after it."""


class PillarModel:
    """Takes resistances (n, rows, cols, 3) to forces by a function; knows no design and no uncertainty."""

    design_hash = None
    is_identified = knows_uncertainty = False
    reading_noise, load_test = 0.0, None

    def __init__(self, forces, rows=6, cols=6, rest_ohm=None):
        self.forces, self.rows, self.cols, self.rest_ohm = forces, rows, cols, rest_ohm

    def rest_resistances(self):
        return self.rest_ohm
