"""Results printed by Song, Wang and Zhang, Micromachines 2018, 9(5), 236. Relative errors in %."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Rubber:
    """The conductive rubber, table 1."""

    young_mpa: float
    poisson: float
    bulk_mpa: float
    shear_mpa: float


TABLE_1 = Rubber(young_mpa=6.1, poisson=0.49, bulk_mpa=101.67, shear_mpa=2.05)
PRESSURES_MPA = (1.0, 3.0, 5.0)  #: of figure 7
LARGEST_FORCE_N = 10.0  #: on a unit, section 3.1
SPACING_MM = (10.0, 20.0)  #: distance of units "around 1–2 cm", section 3.1

#: mean over the widths 10 to 19 by largest strain and component, section 3.2
MEAN_OVER_WIDTHS = {
    0.3: {"fz": 1.98, "fx": 3.02},
    0.2: {"fz": 2.30, "fx": 4.21},
}

#: table 2 by number of samples and component: the ten folds in order
TABLE_2 = {
    2000: {
        "fz": (1.80, 1.69, 1.56, 1.59, 1.55, 1.63, 1.88, 1.60, 1.68, 1.89),
        "fx": (2.94, 3.12, 2.57, 2.71, 2.69, 2.82, 2.39, 2.31, 2.23, 2.34),
    },
    200: {
        "fz": (1.90, 1.85, 1.83, 1.77, 1.75, 2.10, 1.91, 1.77, 1.84, 1.93),
        "fx": (3.15, 3.23, 2.75, 2.64, 2.83, 2.95, 2.53, 2.46, 2.37, 2.59),
    },
}

#: the last row of table 2; the small set's Fz is 1.865 before rounding
TABLE_2_AVERAGE = {2000: {"fz": 1.69, "fx": 2.61}, 200: {"fz": 1.86, "fx": 2.75}}

#: nodes with the least error in figure 9, section 3.2
BEST_WIDTH = {"fz": 17, "fx": 16}
