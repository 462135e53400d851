"""Flat parts of a picture in a strip of its own: colour bars with their ends, and what else is to be known."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyvista as pv
from matplotlib import get_data_path
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkCoordinate, vtkPolyDataMapper2D, vtkTextActor

from fem.pictures.colours import Bar

INK = (0.13, 0.16, 0.19)
VTK_FONT_FILE = 4  #: VTK's number of fonts that come from a file
#: VTK's own font has no ≥, and brackets like parentheses
FONT = str(Path(get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"))
LETTER = 19  #: pixels, of numbers and titles
LEFT, GAP = 0.04, 0.05  #: of the strip's width


def draw_legend(plotter: pv.Plotter, bars: Sequence[Bar], notes: Sequence[str], wide: int, high: int) -> None:
    """Draw bars side by side and notes at the right, in the renderer that is chosen.

    Parameters
    ----------
    plotter : pyvista.Plotter
    bars : sequence of Bar
        The first is the widest.
    notes : sequence of str
        One line each.
    wide, high : int
        Size of the strip [px].
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
        words_at(plotter, words, left + width * (value - bar.low) / (bar.high - bar.low), bottom - 16 / high, "centre")


def words_at(plotter: pv.Plotter, words: str, x: float, y: float, side: str, size: int = LETTER) -> vtkTextActor:
    """Write at a place of the chosen renderer, its corners being (0, 0) and (1, 1); upright about y."""
    actor = vtkTextActor()
    actor.SetInput(words)
    style = actor.GetTextProperty()
    style.SetFontSize(size)
    style.SetColor(*INK)
    style.SetFontFamily(VTK_FONT_FILE)
    style.SetFontFile(FONT)
    style.SetVerticalJustificationToCentered()
    {
        "left": style.SetJustificationToLeft,
        "centre": style.SetJustificationToCentered,
        "right": style.SetJustificationToRight,
    }[side]()
    actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.SetPosition(x, y)
    plotter.renderer.AddViewProp(actor)
    return actor
