"""The page's numbers: as text, colours and rows beside the picture, and as files that other programs take."""

import io
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from fem.pictures.scenery import Bar
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml
from geometry.layout import AXES, PILLARS, FloatArray, unit_centres
from tripillar.viewer.page.controls import MAX_PRESSURE_MPA
from tripillar.viewer.page.sensing import Reading
from tripillar.viewer.sights import LINEAR_UP_TO

CAP = 0.3  #: largest pillar strain of the datasets and of the paper
FULL_AT = {"resistance": 2.0, "force": 10.0}  #: smallest % and N that a map's strongest colour stands for
UP, DOWN = (214, 69, 65), (47, 110, 186)  #: red above, blue below 0
ARROWS = "→↗↑↖←↙↓↘"  #: of shear, by eighths of a turn from +x
MIN_SHOWN_MPA = 0.02  #: of a pad's pressure or shear; less is not shown
CSV_COLUMNS = (
    *("row", "col", "x_mm", "y_mm"),
    *(f"traction_{axis}_mpa" for axis in AXES),
    *(f"resistance_{pillar}_ohm" for pillar in PILLARS),
    *(f"applied_f{axis}_n" for axis in AXES),
    *(f"decoupled_f{axis}_n" for axis in AXES),
)
SCENE_HEADING = """# The array as the page showed it, for `tripillar view` and `tripillar solve`
[body]
kind = "array"

[design]
"""


def beside_picture(tab: str, unit: int, reading: Reading) -> dict[str, Any]:
    """The numbers beside the picture: those of the chosen tab, of the chosen unit, and of the whole array."""
    change, ohm, applied_n, force_n = reading.change, reading.resistance_ohm, reading.applied_n, reading.force_n
    strain, cols = reading.strain, reading.strain.shape[1]
    row, col = divmod(unit, cols)
    if tab == "table":
        of_tab: dict[str, Any] = {"rows": table_rows(ohm, applied_n, force_n)}
    elif tab == "time":
        of_tab = {"sample": sample(change, force_n)}
    else:
        of_tab = {
            "resistance_maps": [
                as_map(f"{name} pillar", "%", 100.0 * change[..., k], FULL_AT["resistance"])
                for k, name in enumerate(PILLARS)
            ],
            "force_maps": [
                as_map(f"F{name}", "N", force_n[..., k], FULL_AT["force"], digits=0) for k, name in enumerate(AXES)
            ],
        }
    error_n = force_n - applied_n
    known = error_n[np.isfinite(error_n)]
    at_row, at_col, pillar = np.unravel_index(int(strain.argmax()), strain.shape)
    worst = float(strain.max())
    beyond = f"; linear, true to {100 * LINEAR_UP_TO:.0f} %" if reading.is_linear and worst > LINEAR_UP_TO else ""
    of_pillars = np.stack([1e-3 * ohm, 100 * change, 100 * strain], axis=-1)[row, col]
    of_forces = np.stack([applied_n, force_n, error_n], axis=-1)[row, col]
    return of_tab | {
        "unit_pillars": [[name, *texts(line, (3, 2, 1))] for name, line in zip(PILLARS, of_pillars, strict=True)],
        "unit_forces": [[f"F{name}", *texts(line, (1, 1, 2))] for name, line in zip(AXES, of_forces, strict=True)],
        "pads": pad_cells(reading.traction_mpa, cols, MAX_PRESSURE_MPA),
        "unit_name": f"row {row}, col {col}",
        "strain": text(100.0 * worst, 1),
        "strain_share": min(worst / CAP, 1.0) * 100.0,
        "strain_over": worst > CAP,
        "strain_at": f"{PILLARS[pillar]} pillar of row {at_row}, col {at_col}{beyond}",
        "rms": text(float(np.sqrt(np.mean(known**2))), 2) if known.size else "",
    }


def as_map(title: str, unit: str, values: FloatArray, full_at: float, digits: int = 1) -> dict[str, Any]:
    """A map of values (rows, cols): cells from the upper left as the array lies before you, y up.

    The strongest colour stands for the largest value, but at least for `full_at`, so that noise at rest stays pale.
    """
    most = max(float(np.abs(values[np.isfinite(values)]).max(initial=0.0)), full_at)
    cells = [
        {"unit": number, "text": text(value, digits), "colour": colour(value / most)}
        for number, value in _as_it_lies(values.ravel(), values.shape[1])
    ]
    return {"title": title, "unit": unit, "most": text(most, digits), "cells": cells}


def pad_cells(traction_mpa: FloatArray, cols: int, most_mpa: float) -> list[dict[str, Any]]:
    """The pads' pressures (n_units, 3) [MPa] as cells of a map, with an arrow where there is shear."""
    cells = []
    for unit, (tx, ty, tz) in _as_it_lies(traction_mpa, cols):
        eighth = round(math.atan2(ty, tx) / (math.pi / 4)) % 8
        arrow = ARROWS[eighth] if math.hypot(tx, ty) > MIN_SHOWN_MPA else ""
        pressed = text(-tz, int(abs(tz) < 10)) if abs(tz) > MIN_SHOWN_MPA else ""
        cells.append({"unit": unit, "text": pressed, "arrow": arrow, "colour": colour(-tz / most_mpa)})
    return cells


def _as_it_lies(values: FloatArray, cols: int) -> Iterator[tuple[int, Any]]:
    """Numbers of units with their values (n_units, ...), the last row first: the array as it lies before you."""
    numbers = np.arange(len(values)).reshape(-1, cols)[::-1].ravel()
    return zip(numbers.tolist(), values[numbers].tolist(), strict=True)


def table_rows(resistance_ohm: FloatArray, applied_n: FloatArray, force_n: FloatArray) -> list[list[str]]:
    """A row a unit: its place, three resistances [kΩ], and applied and decoupled force along each axis [N]."""
    pairs = np.stack([applied_n, force_n], axis=-1).reshape(*force_n.shape[:2], 6)
    lines = np.concatenate([1e-3 * resistance_ohm, pairs], axis=2)
    return [[f"{i}, {j}", *texts(lines[i, j], 3 * (3,) + 6 * (1,))] for i, j in np.ndindex(lines.shape[:2])]


def legend(bar: Bar) -> dict[str, Any]:
    """A colour bar: its title, colours from low to high, and labels with their places as fractions of it."""
    span = bar.high - bar.low
    labels = [[(value - bar.low) / span, words] for value, words in bar.labels.items()]
    return {"title": bar.title, "colours": [*bar.colours[::15], bar.colours[-1]], "labels": labels}


def sample(change: FloatArray, force_n: FloatArray) -> list[list[float | None]]:
    """For the plot over time: of each unit its forces x, y, z [N] and the changes of its pillars z, x, y [%]."""
    values = np.concatenate([force_n, 100.0 * change], axis=2).reshape(-1, 6)
    return [[None if math.isnan(number) else round(number, 3) for number in unit] for unit in values.tolist()]


def texts(values: FloatArray, digits: Sequence[int]) -> list[str]:
    """Numbers with so many decimals each."""
    return [text(*pair) for pair in zip(values.tolist(), digits, strict=True)]


def text(value: float, digits: int) -> str:
    """A number with so many decimals, a dash for NaN."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    rounded = f"{value:.{digits}f}"
    return rounded.removeprefix("-") if float(rounded) == 0 else rounded.replace("-", "−")


def colour(share: float) -> str:
    """Red for shares above 0, blue below, more opaque the larger, so that it suits a pale and a dark page."""
    if math.isnan(share):
        return "transparent"
    red, green, blue = UP if share > 0 else DOWN
    return f"rgba({red},{green},{blue},{min(abs(share), 1.0):.3f})"


def csv_of(design: SensorDesign, reading: Reading) -> str:
    """A CSV file with a line a unit: its place, its load, its resistances and the forces decoupled from them.

    An unknown value, NaN, is left empty.
    """
    by_unit = [part.reshape(-1, 3) for part in (reading.resistance_ohm, reading.applied_n, reading.force_n)]
    places = np.divmod(np.arange(design.n_units), design.array.cols)
    values = np.column_stack([*places, unit_centres(design), reading.traction_mpa, *by_unit])
    written, formats = io.StringIO(), ["%d", "%d", *["%.7g"] * (len(CSV_COLUMNS) - 2)]
    np.savetxt(written, values, formats, delimiter=",", header=",".join(CSV_COLUMNS), comments="")
    return written.getvalue().replace("nan", "")


def scene_of(design: SensorDesign, traction_mpa: FloatArray, chosen: int) -> str:
    """A scene file (TOML) of the same array under the same loads, for `tripillar solve` and `view`.

    Its probe is the pad of the chosen unit. Stiff pads hold the rubber where nothing loads them, too: each is there.
    """
    nested = "\n".join(
        f"[design.{line[1:]}" if line.startswith("[") else line for line in design_to_toml(design).splitlines()[1:]
    )
    centres = unit_centres(design) + np.array([design.pad.offset_x_mm, design.pad.offset_y_mm])
    square = f"size_mm = [{design.pad.size_mm!r}, {design.pad.size_mm!r}]"
    tables = []
    for centre, traction in zip(centres, traction_mpa, strict=True):
        place = f"[[load]]\ncenter_mm = {centre.tolist()}\n{square}\n"
        if design.pad.kind == "stiff":
            force_n = traction * design.pad.size_mm**2
            tables.append(f'{place}kind = "stiff"\nforce_n = {force_n.round(9).tolist()}\n')
        elif traction.any():
            tables.append(f"{place}traction_mpa = {traction.round(9).tolist()}\n")
    row, col = divmod(chosen, design.array.cols)
    probe = f'[[probe]]\nname = "pad of row {row}, col {col}"\nkind = "mean"\n'
    tables.append(f"{probe}center_mm = {centres[chosen].tolist()}\n{square}\n")
    return SCENE_HEADING + nested + "\n\n" + "\n".join(tables)
