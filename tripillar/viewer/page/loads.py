"""What acts on the array of the page: a load on one pad, or a round indenter over the array."""

import math
from dataclasses import dataclass

import numpy as np

from dataset.protocols import FRICTION, NORMAL_MPA, TANGENTIAL_MPA
from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.layout import FloatArray, unit_centres

MAX_PRESSURE_MPA = NORMAL_MPA[1]  #: of a pad, as in the datasets
MAX_SHEAR_MPA = TANGENTIAL_MPA[1]


@dataclass(frozen=True, kw_only=True)
class PadLoad:
    """Pressure and shear on one pad."""

    pressure_mpa: float = 0.0
    shear_mpa: float = 0.0  #: size of the tangential traction
    angle_deg: float = 0.0  #: its direction from +x towards +y

    def __post_init__(self) -> None:
        if not 0 <= self.pressure_mpa <= MAX_PRESSURE_MPA:
            raise DesignError(f"pressure_mpa={self.pressure_mpa:g} must be from 0 to {MAX_PRESSURE_MPA:g}.")
        if not 0 <= self.shear_mpa <= MAX_SHEAR_MPA:
            raise DesignError(f"shear_mpa={self.shear_mpa:g} must be from 0 to {MAX_SHEAR_MPA:g}.")

    def within_cone(self, friction: float = FRICTION) -> "PadLoad":
        """The same with no more shear than `friction` times the pressure."""
        shear_mpa = min(self.shear_mpa, friction * self.pressure_mpa)
        return PadLoad(pressure_mpa=self.pressure_mpa, shear_mpa=shear_mpa, angle_deg=self.angle_deg)

    @property
    def traction_mpa(self) -> FloatArray:
        """Along x, y, z, shape (3,) [MPa]; z negative pushing down."""
        angle = math.radians(self.angle_deg)
        return np.array([self.shear_mpa * math.cos(angle), self.shear_mpa * math.sin(angle), -self.pressure_mpa])

    @classmethod
    def of(cls, traction_mpa: FloatArray) -> "PadLoad":
        """The load that a traction (3,) [MPa] is, cut to what the page's sliders can show."""
        tx, ty, tz = traction_mpa.tolist()
        return cls(
            pressure_mpa=min(max(-tz, 0.0), MAX_PRESSURE_MPA),
            shear_mpa=min(math.hypot(tx, ty), MAX_SHEAR_MPA),
            angle_deg=math.degrees(math.atan2(ty, tx)) % 360.0,
        )


@dataclass(frozen=True, kw_only=True)
class Indenter:
    """A round indenter that presses by a bell of pressure, p exp(−r²/2w²), and may drag, as the datasets' do."""

    load: PadLoad  #: under its middle
    x_mm: float = 0.0
    y_mm: float = 0.0
    width_mm: float = 15.0  #: w, standard deviation of the bell

    def __post_init__(self) -> None:
        if not self.width_mm > 0:
            raise DesignError(f"width_mm={self.width_mm:g} must be above 0.")

    def tractions(self, design: SensorDesign) -> FloatArray:
        """On every pad, shape (n_units, 3) [MPa]."""
        squared = ((unit_centres(design) - (self.x_mm, self.y_mm)) ** 2).sum(axis=1)
        return np.exp(-squared / (2.0 * self.width_mm**2))[:, None] * self.load.traction_mpa
