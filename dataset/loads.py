"""How hard pads are loaded: within the paper's ranges where a design bears them, else within its own.

The one place that says so; protocols, pictures, pages and simulated boards take their ranges from here.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from dataset.resistance import largest_factors, largest_strains
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

Range = tuple[float, float]
NORMAL_MPA = (1.0, 5.0)  #: the paper's range of a pad's pressure, and of an indenter's peak
TANGENTIAL_MPA = (0.2, 1.0)  #: the same for shear
FRICTION = TANGENTIAL_MPA[1] / NORMAL_MPA[1]  #: largest ratio of shear to pressure where both act on a pad
PRELOAD = 0.1  #: of the largest load: on pads that no indenter touches
LOWEST = NORMAL_MPA[0] / NORMAL_MPA[1]  #: least load of a design's own range, over its largest
N_TRIED, LEAST_BORNE = 500, 0.05  #: draws of the paper's loads, and the share of them that a design bears at least
CAP = 0.3  #: largest strain |l − l₀|/l₀ of a pillar unless another is asked for: the paper's wider one


@dataclass(frozen=True)
class Loads:
    """Ranges of the loads on a pad; by default the paper's."""

    normal_mpa: Range = NORMAL_MPA  #: of pressure
    tangential_mpa: Range = TANGENTIAL_MPA  #: of shear

    @classmethod
    def of(cls, pressure_mpa: Range | None, shear_mpa: Range | None = None) -> Self:
        """The ranges that are given; shear alone missing is as much of the pressure as the paper's."""
        if pressure_mpa is None:
            return cls(tangential_mpa=shear_mpa or TANGENTIAL_MPA)
        low, high = pressure_mpa
        return cls((low, high), shear_mpa or (low * FRICTION, high * FRICTION))

    @classmethod
    def stated(cls, attributes: Mapping[str, Any]) -> Self:
        """Those that a data set's attributes state; the paper's in place of what makes no sense."""
        found: list[Range | None] = []
        for name in ("pressure_mpa", "shear_mpa"):
            given = np.ravel(attributes.get(name, ()))
            is_range = given.dtype.kind in "fi" and len(given) == 2
            is_sound = is_range and 0 <= given[0] <= given[1] < np.inf and given[1] > 0
            found.append((float(given[0]), float(given[1])) if is_sound else None)
        return cls.of(*found)

    @property
    def friction(self) -> float:
        """Largest ratio of shear to pressure where both act on a pad."""
        return self.tangential_mpa[1] / self.normal_mpa[1]

    @property
    def middle_mpa(self) -> float:
        """Pressure in the middle of the range, 3 MPa of the paper's."""
        return sum(self.normal_mpa) / 2.0

    def said(self, design: SensorDesign, axes: tuple[str, ...] = AXES) -> str:
        """The ranges along these axes in words, in MPa and newtons a pad."""
        found, area_mm2 = [], design.pad.size_mm**2
        for axis, kind, (low, high) in (("z", "pressure", self.normal_mpa), ("x", "shear", self.tangential_mpa)):
            if axis in axes:
                low = 0.0 if axis == "x" and "z" in axes else low  # within a friction cone
                newtons = f"{low * area_mm2:.3g} to {high * area_mm2:.3g} N a pad"
                found.append(f"{kind} of {low:.3g} to {high:.3g} MPa ({newtons})")
        return " and ".join(found)


PAPERS = Loads()


def preload_of(range_mpa: Range) -> float:
    """Light load on pads that no indenter touches [MPa]: a tenth of the largest, and no more than the least."""
    return min(PRELOAD * range_mpa[1], range_mpa[0])


def loads_of(response: "ArrayResponse", cap: float = CAP) -> Loads:
    """The paper's loads where a design bears them, else its own: from its largest pressure down to a fifth of it.

    A design bears the paper's loads if their middle, on the weakest pad alone and on all pads at once, strains no
    pillar beyond `CAP`, and `LEAST_BORNE` of draws of a pressure on every pad do not: a smaller cap draws more of them
    again, as the paper's does. Its own largest pressure is `bearable_mpa`, rounded down to two digits.
    """
    is_middle_borne = min(largest_pressures(response, max(cap, CAP))) >= PAPERS.middle_mpa
    drawn_mpa = np.random.default_rng(0).uniform(*NORMAL_MPA, (N_TRIED, response.design.n_units))
    moved_mm = np.tensordot(drawn_mpa, _pressed_mm(response)[:-1], axes=1)
    is_borne = largest_strains(moved_mm, response.design.unit) <= max(cap, CAP)
    if is_middle_borne and is_borne.mean() >= LEAST_BORNE:
        return PAPERS
    most_mpa = bearable_mpa(response, cap)
    step = 10.0 ** (math.floor(math.log10(most_mpa)) - 1)
    high = float(f"{math.floor(most_mpa / step) * step:.2g}")
    return Loads.of((float(f"{LOWEST * high:.3g}"), high))


def bearable_mpa(response: "ArrayResponse", cap: float) -> float:
    """Largest pressure [MPa] that the weakest pad alone, and all pads at once, bear.

    The smaller of `largest_pressures` at the cap, and no more than what sinks an electrode by the cap times the height,
    as stiff pillars lean over in soft rubber before they are strained.
    """
    sinks_mm = np.abs(_pressed_mm(response)[..., AXES.index("z")]).max()
    return min(*largest_pressures(response, cap), cap * response.design.unit.height_mm / float(sinks_mm))


def largest_pressures(response: "ArrayResponse", cap: float) -> tuple[float, float]:
    """Largest pressure [MPa] on one pad alone, the weakest, and on all pads at once, with strains below the cap."""
    factors = largest_factors(_pressed_mm(response), response.design.unit, cap)
    return float(factors[:-1].min()), float(factors[-1])


def _pressed_mm(response: "ArrayResponse") -> FloatArray:
    """Displacements (n_units + 1, n_units, n_upper, 3) [mm] by 1 MPa on each pad alone, then on all at once."""
    n_units = response.design.n_units
    traction = np.zeros((n_units + 1, n_units, 3))
    traction[..., AXES.index("z")] = -np.array([*np.eye(n_units), np.ones(n_units)])
    return displacements(response, traction, ("z",))


def displacements(response: "ArrayResponse", traction_mpa: FloatArray, axes: tuple[str, ...] = AXES) -> FloatArray:
    """Displacement of the upper electrodes (n, n_units, n_upper, 3) [mm] under tractions (n, n_units, 3) [MPa].

    Tractions along other axes than `axes` are known to be 0 and are skipped.
    """
    n, n_units, _ = traction_mpa.shape
    loaded = [AXES.index(axis) for axis in axes]
    influence = response.influence_mm_per_n.reshape(-1, n_units, 3)[:, :, loaded]
    newtons = traction_mpa[:, :, loaded].reshape(n, -1) * response.design.pad.size_mm**2
    return (newtons @ influence.reshape(len(influence), -1).T).reshape(n, n_units, -1, 3)
