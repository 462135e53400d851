"""A layout of four pillars, for tests that nothing but the layout knows how many a unit has."""

from geometry.layout import Electrode, Layout, Pillar

#: two uprights, two oblique pillars and three upper electrodes, in a chain from U1 to U3; y shares both its electrodes
FOUR = Layout(
    upper=(Electrode("U1", (-1.0, -1.0)), Electrode("U2", (-1.0, 1.0)), Electrode("U3", (1.0, 1.0))),
    lower=(Electrode("L1", (-1.0, -1.0)), Electrode("L2", (-1.0, 1.0))),
    pillars=(Pillar("z", "L1", "U1"), Pillar("y", "L1", "U2"), Pillar("w", "L2", "U2"), Pillar("x", "L2", "U3")),
)
