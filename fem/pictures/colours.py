"""Colours of pictures: what they show, where their scale ends, and how a bar is labelled."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from matplotlib import colormaps

from fem.fields.deformed import Part, Parts
from fem.fields.stress import pressure, von_mises
from geometry.layout import FloatArray

Colour = Literal["displacement", "vertical", "mises", "pressure"]

SHOWN_SHARE = 0.998  #: of the volume, whose stress ends the colours: at edges it has no bound
ROOM = 0.15  #: of a scale, that a label takes
SHADES = 255  #: colours of a scale; odd, so that the middle one of a scale of both signs is white
BELOW = ("#053061", "#3f8ec0", "#ffffff")  #: from the least value to 0
ABOVE = ("#ffffff", "#d6604d", "#67001f")  #: from 0 to the largest
LOADED = ("#fcbba1", "#de2d26", "#67000d")  #: outlines of pads, from hardly loaded to the most
#: titles of the bar of pads' outlines, by the part that is outlined: uniform traction, or what a plate passes on
PAD_TITLES = {"pads": "traction on a pad [MPa]", "plates": "mean traction under a plate [MPa]"}
COLOURED_NOT = ("matrix", "electrodes", *PAD_TITLES)  #: parts whose colour says nothing of a field


@dataclass(frozen=True)
class Quantity:
    """A quantity that colour can show."""

    title: str
    of: Callable[[Part], FloatArray]  #: a part to values (n,) at its points
    colours: str | None = None  #: a map of matplotlib; None: of both signs, white at 0
    of_stress: bool = False  #: it has no bound at edges, then: the largest value means nothing


QUANTITIES: dict[Colour, Quantity] = {
    "displacement": Quantity("displacement [mm]", lambda p: np.linalg.norm(p.displacement_mm, axis=1), "viridis"),
    "vertical": Quantity("vertical displacement [mm]", lambda p: p.displacement_mm[:, 2]),
    "mises": Quantity("von Mises stress [MPa]", lambda p: von_mises(p.stress), "plasma", of_stress=True),
    "pressure": Quantity("pressure [MPa]", lambda p: pressure(p.stress), of_stress=True),
}


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A colour bar: its title, the values at its ends, and its colours from one to the other as #rrggbb."""

    title: str
    low: float
    high: float
    colours: list[str]
    is_cut: bool = False  #: values beyond its ends are drawn in the colours of the ends

    @property
    def labels(self) -> dict[float, str]:
        """Labels by value: round numbers, and both ends as they are."""
        words = {tick: _number(tick) for tick in colour_ticks(self.low, self.high).tolist()}
        if self.is_cut:
            words[self.high] = f"≥ {words[self.high]}"
            words[self.low] = f"≤ {words[self.low]}" if self.low < 0 else words[self.low]
        return words


def bar_of(quantity: Quantity, panels: Iterable[Parts]) -> Bar:
    """One colour bar for several pictures: it ends at the least and the largest value, 0 among its values.

    Of stress, which has no bound at edges, it ends where 99.8 % of the volume (of surfaces: of the area) has less, and
    says so. A share of the points instead would depend on how many of them a mesh has at the edges.
    """
    solid = [(name, part) for parts in panels for name, part in parts.items() if name not in COLOURED_NOT]
    values = np.concatenate([quantity.of(part) for _, part in solid])
    whose = "" if solid[0][0] == "body" else f" of the {solid[0][0]}"
    low, high = values.min(), values.max()
    if quantity.of_stress:
        sizes, shares = np.concatenate([part.sizes for _, part in solid]), [1 - SHOWN_SHARE, SHOWN_SHARE]
        low, high = np.quantile(values, shares, weights=sizes, method="inverted_cdf")
    low, high = min(float(low), 0.0), max(float(high), 0.0)
    if low == high:
        high = 1.0
    return Bar(
        title=quantity.title.replace(" [", f"{whose} ["),
        low=low,
        high=high,
        colours=shades(quantity.colours, low, high),
        is_cut=quantity.of_stress,
    )


def pads_bar(panels: Iterable[Parts]) -> Bar | None:
    """The bar of the outlines of pads or plates, from no traction to the largest; None where none is loaded."""
    most = {name: 0.0 for name in PAD_TITLES}
    for parts in panels:
        for name in parts.keys() & PAD_TITLES.keys():
            most[name] = max(most[name], float(parts[name].strength_mpa.max()))
    name = max(most, key=most.__getitem__)
    return Bar(title=PAD_TITLES[name], low=0.0, high=most[name], colours=mixed(LOADED, SHADES)) if most[name] else None


def shades(name: str | None, low: float, high: float) -> list[str]:
    """Colours from one end of a scale to the other.

    Parameters
    ----------
    name : str, optional
        Of matplotlib's map; None: blue below 0, white at 0, red above, as strong for −1 as for 1.
    low, high : float
        Ends of the scale; low at most 0 and high at least 0 where the map has both signs.

    Examples
    --------
    >>> shades(None, -2.0, 2.0)[127]
    '#ffffff'
    """
    share = np.linspace(0.0, 1.0, SHADES)
    if name is not None:
        return [*_sequential(name)]
    most = max(-low, high)
    whole = np.array([_rgb(c) for c in mixed(BELOW, SHADES) + mixed(ABOVE, SHADES)[1:]])
    at = np.linspace(-1.0, 1.0, len(whole))
    values = (low + share * (high - low)) / most
    return [_hex(rgb) for rgb in np.column_stack([np.interp(values, at, channel) for channel in whole.T]).tolist()]


@cache
def _sequential(name: str) -> tuple[str, ...]:
    """Colours of a map of matplotlib from its first to its last."""
    return tuple(_hex(rgb) for rgb in colormaps[name](np.linspace(0.0, 1.0, SHADES))[:, :3].tolist())


def mixed(colours: tuple[str, ...], n: int) -> list[str]:
    """n colours from the first of some, #rrggbb, to the last."""
    ends = np.array([_rgb(colour) for colour in colours])
    at = np.linspace(0.0, len(ends) - 1.0, n)
    return [_hex([np.interp(x, range(len(ends)), ends[:, k]) for k in range(3)]) for x in at]


def _rgb(colour: str) -> list[float]:
    return [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]


def _hex(rgb: Iterable[float]) -> str:
    return "#" + bytes(round(255 * part) for part in rgb).hex()


def colour_ticks(low: float, high: float) -> FloatArray:
    """Both ends of a colour scale, and a few round values between them whose labels have room.

    >>> colour_ticks(0.0, 3.89)
    array([0.  , 1.  , 2.  , 3.  , 3.89])
    """
    span = high - low
    step = round_step(1.6 * span)
    inside = step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    inside = inside[(inside > low + ROOM * span) & (inside < high - ROOM * span)]
    return np.array([low, *inside, high])


def round_step(most: float) -> float:
    """The step of 1, 2, 2.5 or 5 times a power of ten of which four or a few more reach up to a value.

    >>> round_step(2.66), round_step(0.41)
    (0.5, 0.1)
    """
    if not most > 0:
        return 1.0
    tens = 10.0 ** np.floor(np.log10(most / 4))
    return float(max(step * tens for step in (1, 2, 2.5, 5) if step * tens <= most / 4))


def _number(value: float) -> str:
    return f"{value:.3g}".replace("-", "−")
