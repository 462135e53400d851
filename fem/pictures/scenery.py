"""Colours of pictures and what stands beside a body: colour bars, scale bar, axes and legend.

The scale bar and the axes stand beside a body as meshes in its coordinates, so they are right in perspective, in a film
and turned in a browser, too. Colour bars and notes are flat, in a strip of their own.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyvista as pv
from matplotlib import colormaps, get_data_path
from matplotlib.colors import LinearSegmentedColormap
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkCoordinate, vtkPolyDataMapper2D

from fem.kernel.field import pressure, von_mises
from fem.pictures.parts import Part, Parts
from geometry.layout import FloatArray

Colour = Literal["displacement", "vertical", "mises", "pressure"]
Camera = Literal["iso", "top", "front", "side"]

SHOWN_SHARE = 0.998  #: of the volume, whose stress ends the colours: at edges it has no bound
ROOM = 0.15  #: of a scale, that a label takes
SHADES = 255  #: colours of a scale; odd, so that the middle one of a scale of both signs is white
SIGNED = ("#053061", "#3f8ec0", "#ffffff", "#d6604d", "#67001f")  #: from below 0 to above
LOADED = ("#fcbba1", "#de2d26", "#67000d")  #: outlines of pads, from hardly loaded to the most
#: titles of the bar of pads' outlines, by the part that is outlined: uniform traction, or what a plate passes on
PAD_TITLES = {"pads": "traction on a pad [MPa]", "plates": "mean traction under a plate [MPa]"}
COLOURED_NOT = ("matrix", "electrodes", *PAD_TITLES)  #: parts whose colour says nothing of a field


@dataclass(frozen=True)
class Quantity:
    """A quantity that colour can show."""

    title: str
    of: Callable[[Part], FloatArray]  #: a part to values (n,) at its points
    colours: str | tuple[str, ...] = SIGNED  #: as of `shades`
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
    return Bar(title=PAD_TITLES[name], low=0.0, high=most[name], colours=shades(LOADED)) if most[name] else None


def shades(colours: str | tuple[str, ...], low: float = 0.0, high: float = 1.0) -> list[str]:
    """Colours #rrggbb from one end of a scale to the other: of matplotlib's map of that name, or between some.

    `SIGNED` are white at 0, low being at most 0 and high at least 0, and as strong for −1 as for 1.

    >>> shades(SIGNED, -2.0, 2.0)[127]
    '#ffffff'
    """
    share = np.linspace(0.0, 1.0, SHADES)
    if colours == SIGNED:
        share = 0.5 + (low + share * (high - low)) / max(-low, high) / 2
    if isinstance(colours, str):
        table = colormaps[colours]
    else:
        table = LinearSegmentedColormap.from_list("", colours, N=4 * SHADES + 1)
    return ["#" + rgb.tobytes().hex() for rgb in np.asarray(table(share, bytes=True))[:, :3]]


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


INK = (0.13, 0.16, 0.19)
#: VTK's own font has no ≥, and brackets like parentheses
FONT = str(Path(get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"))
LETTER_PX = 19  #: pixels, of numbers and titles
LEFT, GAP = 0.04, 0.05  #: of the strip's width


def draw_legend(plotter: pv.Plotter, bars: Sequence[Bar], notes: Sequence[str], wide: int, high: int) -> None:
    """Draw bars side by side, the first one the widest, and notes at the right, one line each.

    In the renderer that is chosen, a strip of so many pixels.
    """
    note = (12 * max(map(len, notes)) + 40) / wide  # letters are about 0.55 of their height wide
    room = 1.0 - 2 * LEFT - note - GAP * (len(bars) - 1)
    shares = np.array([1.6] + [1.0] * (len(bars) - 1))
    left = LEFT
    for bar, share in zip(bars, shares / shares.sum() * room, strict=True):
        _draw_bar(plotter, bar, left, share, high)
        left += share + GAP
    for number, words in enumerate(notes):
        words_at(plotter, words, 1.0 - LEFT, 0.72 - number * 28 / high, "right")


def _draw_bar(plotter: pv.Plotter, bar: Bar, left: float, width: float, high: int) -> None:
    """A bar with its title above and its labels below; places are shares of the strip."""
    bottom, thick = 0.44, 16 / high
    n = len(bar.colours)
    x = left + width * np.linspace(0.0, 1.0, n + 1)
    points = np.array([[at, y, 0.0] for at in x for y in (bottom, bottom + thick)])
    first = 2 * np.arange(n)
    quads = np.column_stack([np.full(n, 4), first, first + 2, first + 3, first + 1])
    mesh = pv.PolyData(points, faces=quads.ravel())
    mesh.cell_data["colour"] = np.array([pv.Color(colour).int_rgb for colour in bar.colours], dtype=np.uint8)
    mapper = vtkPolyDataMapper2D()
    mapper.SetInputData(mesh)
    mapper.SetScalarModeToUseCellData()
    coordinate = vtkCoordinate()
    coordinate.SetCoordinateSystemToNormalizedViewport()
    mapper.SetTransformCoordinate(coordinate)
    actor = vtkActor2D()
    actor.SetMapper(mapper)
    plotter.renderer.AddViewProp(actor)
    words_at(plotter, bar.title, left, bottom + thick + 16 / high, "left")
    for value, words in bar.labels.items():
        at = left + width * (value - bar.low) / (bar.high - bar.low)
        words_at(plotter, words, at, bottom - 16 / high, "center")


def words_at(plotter: pv.Plotter, words: str, x: float, y: float, side: str, size: int = LETTER_PX) -> pv.Text:
    """Write at a place of the chosen renderer, its corners being (0, 0) and (1, 1); upright about y."""
    text = pv.Text(words)
    text.prop = pv.TextProperty(
        color=INK, font_size=size, font_file=FONT, justification_horizontal=side, justification_vertical="center"
    )
    text.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    text.position = x, y
    plotter.renderer.AddViewProp(text)
    return text


LETTER = 0.024  #: height of letters, of the body's larger side
AXES = 0.08  #: length of the axes' arrows, of the same


def draw_scenery(points_mm: FloatArray, camera: Camera) -> pv.PolyData:
    """A scale bar with its length and named arrows along the axes, before and left of the body as a camera sees it.

    The body fills points (n, 3), at rest and loaded.
    """
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    right, up = directions(camera)
    if camera in ("front", "side"):  # in the middle of the depth, or the nearest plane that is drawn would cut it off
        low = np.where(right + up > 0, low, (low + high) / 2)
    size = float((high - low).max())
    letter, width = LETTER * size, float((high - low) @ right)
    length = round_step(width)  # about a quarter of it
    # a line between two ticks, its length below it
    start = low + (width - length) * right - 1.8 * letter * up
    corners, thick = [start, start + length * right], 0.07 * letter
    meshes = [_strip(at - 0.3 * letter * up, at + 0.3 * letter * up, thick * right) for at in corners]
    meshes.append(_strip(corners[0], corners[1], thick * up))
    meshes.append(_word(f"{length:g} mm", start + length / 2 * right - 1.3 * letter * up, letter, right, up))
    corner, shaft = low - (AXES * size + 2.2 * letter) * right, AXES * size
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        if camera == "iso" or abs(np.cross(right, up) @ axis) < 0.5:  # not at the onlooker
            meshes.append(pv.Arrow(
                start=corner, direction=axis, scale=shaft, tip_length=0.3, tip_radius=0.1, shaft_radius=0.03,
                tip_resolution=16, shaft_resolution=10,
            ))  # fmt: skip
            middle, upward = corner + (shaft + 0.9 * letter) * axis, axis if name == "z" else up
            meshes.append(_word(name, middle, letter, right, upward))
    return pv.merge(meshes)


def directions(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Axes along which letters run and stand for a camera: on the ground, or on the side that it looks at."""
    right, up = np.eye(3)[1 if camera == "side" else 0], np.eye(3)[1 if camera in ("iso", "top") else 2]
    return right, up


def unit_names(rows: int, cols: int, pitch_mm: float) -> pv.PolyData:
    """Names of an array's rows and columns as numbered in files, on the ground right of it and before it."""
    letter = LETTER * pitch_mm * max(rows, cols)
    x, y = (pitch_mm * (np.arange(n) - (n - 1) / 2) for n in (cols, rows))
    right, up = directions("iso")
    edge, front = pitch_mm * cols / 2, -pitch_mm * rows / 2
    places = [(f"col {j}" if j == 0 else f"{j}", (at, front - 1.2 * letter)) for j, at in enumerate(x)]
    places += [(f"row {i}" if i == 0 else f"{i}", (edge + 1.6 * letter, at)) for i, at in enumerate(y)]
    return pv.merge([_word(text, np.array([*place, 0.0]), letter, right, up) for text, place in places])


def _strip(start: FloatArray, end: FloatArray, half: FloatArray) -> pv.PolyData:
    """A flat line, twice as wide as `half` is long."""
    return pv.PolyData(np.array([start - half, end - half, end + half, start + half]), faces=[4, 0, 1, 2, 3])


def _word(text: str, centre: FloatArray, height: float, right: FloatArray, up: FloatArray) -> pv.PolyData:
    """Flat letters about a point, along two directions; x heights vary, so lines of figures set their size."""
    flat = pv.Text3D(text, depth=0.0)
    points = np.asarray(flat.points, dtype=float)
    reference = float(np.ptp(np.asarray(pv.Text3D("0", depth=0.0).points)[:, 1]))
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    place = (points - middle) * (height / reference)
    moved = centre + place[:, :1] * right + place[:, 1:2] * up
    return pv.PolyData(moved, faces=flat.faces)
