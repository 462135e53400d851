"""The page's numbers: as text, colours and rows beside the picture, and as files that other programs take."""

import csv
import io
import math
from typing import Any

import numpy as np

from fem.pictures.colours import Bar
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml
from geometry.layout import AXES, PILLARS, FloatArray, unit_centres
from tripillar.viewer.page.controls import MAX_PRESSURE_MPA
from tripillar.viewer.page.sensing import Reading

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


def beside_picture(
    tab: str, unit: int, traction_mpa: FloatArray, applied_n: FloatArray, reading: Reading, change: FloatArray
) -> dict[str, Any]:
    """The numbers beside the picture: those of the chosen tab, of the chosen unit, and of the whole array.

    Parameters
    ----------
    tab, unit : str, int
        The chosen ones.
    traction_mpa : array, shape (n_units, 3)
    applied_n, change : arrays, shape (rows, cols, 3)
        Forces, NaN where unknown; relative change of the resistances from rest.
    reading : Reading
    """
    _, cols, _ = change.shape
    row, col = divmod(unit, cols)
    if tab == "table":
        of_tab: dict[str, Any] = {"rows": table_rows(reading.resistance_ohm, applied_n, reading.force_n, cols)}
    elif tab == "time":
        of_tab = {"sample": sample(change, reading.force_n)}
    else:
        of_tab = {
            "resistance_maps": [
                as_map(f"{name} pillar", "%", 100.0 * change[..., k], FULL_AT["resistance"])
                for k, name in enumerate(PILLARS)
            ],
            "force_maps": [
                as_map(f"F{name}", "N", reading.force_n[..., k], FULL_AT["force"], digits=0)
                for k, name in enumerate(AXES)
            ],
        }
    shown = (reading.resistance_ohm, change, reading.strain, applied_n, reading.force_n)
    worst = np.unravel_index(int(reading.strain.argmax()), reading.strain.shape)
    strain = float(reading.strain[worst])
    missed = reading.force_n - applied_n
    known = missed[np.isfinite(missed)]
    return of_tab | unit_rows(*(values[row, col] for values in shown)) | {
        "pads": pad_cells(traction_mpa, cols, MAX_PRESSURE_MPA),
        "unit_name": f"row {row}, col {col}",
        "strain": text(100.0 * strain, 1),
        "strain_share": min(strain / CAP, 1.0) * 100.0,
        "strain_over": strain > CAP,
        "strain_at": f"{PILLARS[worst[2]]} pillar of row {worst[0]}, col {worst[1]}",
        "rms": text(float(np.sqrt(np.mean(known**2))), 2) if known.size else "",
    }  # fmt: skip


def as_map(title: str, unit: str, values: FloatArray, full_at: float, digits: int = 1) -> dict[str, Any]:
    """A map of values (rows, cols): cells from the upper left as the array lies before you, y up.

    The strongest colour stands for the largest value, but at least for `full_at`, so that noise at rest stays pale.
    """
    finite = np.abs(values[np.isfinite(values)])
    most = max(float(finite.max(initial=0.0)), full_at)
    rows, cols = values.shape
    cells = [
        {"unit": i * cols + j, "text": text(values[i, j], digits), "colour": colour(values[i, j] / most)}
        for i in range(rows - 1, -1, -1)
        for j in range(cols)
    ]
    return {"title": title, "unit": unit, "most": text(most, digits), "cells": cells}


def pad_cells(traction_mpa: FloatArray, cols: int, most_mpa: float) -> list[dict[str, Any]]:
    """The pads' pressures (n_units, 3) [MPa] as cells of a map, with an arrow where there is shear."""
    cells = []
    for i in range(len(traction_mpa) // cols - 1, -1, -1):
        for unit in range(i * cols, (i + 1) * cols):
            tx, ty, tz = traction_mpa[unit].tolist()
            eighth = round(math.atan2(ty, tx) / (math.pi / 4)) % 8
            arrow = ARROWS[eighth] if math.hypot(tx, ty) > MIN_SHOWN_MPA else ""
            pressed = text(-tz, 1) if abs(tz) > MIN_SHOWN_MPA else ""
            cells.append({"unit": unit, "text": pressed, "arrow": arrow, "colour": colour(-tz / most_mpa)})
    return cells


def table_rows(resistance_ohm: FloatArray, applied_n: FloatArray, force_n: FloatArray, cols: int) -> list[list[str]]:
    """A row a unit: its place, three resistances [kΩ], and applied and decoupled force along each axis [N]."""
    kilo_ohm, applied, found = (1e-3 * resistance_ohm).reshape(-1, 3), applied_n.reshape(-1, 3), force_n.reshape(-1, 3)
    pairs = np.stack([applied, found], axis=2).reshape(-1, 6)
    return [
        [f"{k // cols}, {k % cols}", *(text(v, 3) for v in kilo_ohm[k]), *(text(v, 1) for v in pairs[k])]
        for k in range(len(pairs))
    ]


def unit_rows(
    resistance_ohm: FloatArray, change: FloatArray, strain: FloatArray, applied_n: FloatArray, force_n: FloatArray
) -> dict[str, list[list[str]]]:
    """Tables of the pillars and the forces of one unit; all arrays have shape (3,)."""
    pillars = [
        [name, text(1e-3 * resistance_ohm[k], 3), text(100 * change[k], 2), text(100 * strain[k], 1)]
        for k, name in enumerate(PILLARS)
    ]
    forces = [
        [f"F{name}", text(applied_n[k], 1), text(force_n[k], 1), text(force_n[k] - applied_n[k], 2)]
        for k, name in enumerate(AXES)
    ]
    return {"unit_pillars": pillars, "unit_forces": forces}


def legend(bar: Bar) -> dict[str, Any]:
    """A colour bar: its title, colours from low to high, and labels with their places as fractions of it."""
    span = bar.high - bar.low
    labels = [[(value - bar.low) / span, words] for value, words in bar.labels.items()]
    return {"title": bar.title, "colours": [*bar.colours[::15], bar.colours[-1]], "labels": labels}


def sample(change: FloatArray, force_n: FloatArray) -> list[list[float | None]]:
    """For the plot over time: of each unit its forces x, y, z [N] and the changes of its pillars z, x, y [%]."""
    values = np.concatenate([force_n, 100.0 * change], axis=2).reshape(-1, 6)
    return [[None if math.isnan(number) else round(number, 3) for number in unit] for unit in values.tolist()]


def text(value: float, digits: int) -> str:
    """A number with so many decimals, a dash for NaN."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞"
    rounded = f"{value:.{digits}f}"
    return rounded.removeprefix("-") if float(rounded) == 0 else rounded.replace("-", "−")


def colour(share: float) -> str:
    """Red for shares above 0, blue below, more opaque the larger, so that it suits a pale and a dark page."""
    if math.isnan(share):
        return "transparent"
    red, green, blue = UP if share > 0 else DOWN
    return f"rgba({red},{green},{blue},{min(abs(share), 1.0):.3f})"


def csv_of(
    design: SensorDesign,
    traction_mpa: FloatArray,
    resistance_ohm: FloatArray,
    applied_n: FloatArray,
    force_n: FloatArray,
) -> str:
    """A CSV file with a line a unit: its place, its load, its resistances and the forces decoupled from them.

    Parameters
    ----------
    design : SensorDesign
    traction_mpa : array, shape (n_units, 3)
        z negative pushing down.
    resistance_ohm, applied_n, force_n : arrays, shape (rows, cols, 3)
        Of the pillars z, x, y; along x, y, z, Fz positive in compression. What is not known, NaN, is left empty.
    """
    written = io.StringIO()
    lines = csv.writer(written, lineterminator="\n")
    lines.writerow(CSV_COLUMNS)
    by_unit = [part.reshape(-1, 3) for part in (resistance_ohm, applied_n, force_n)]
    values = np.concatenate([unit_centres(design), traction_mpa, *by_unit], axis=1)
    for unit, numbers in enumerate(values.tolist()):
        place = divmod(unit, design.array.cols)
        lines.writerow([*place, *("" if np.isnan(number) else f"{number:.7g}" for number in numbers)])
    return written.getvalue()


def scene_of(design: SensorDesign, traction_mpa: FloatArray, chosen: int) -> str:
    """A scene file (TOML) of the same array under the same loads, for `tripillar solve` and `view`.

    Its probe is the pad of the chosen unit.
    """
    nested = "\n".join(
        f"[design.{line[1:]}" if line.startswith("[") else line for line in design_to_toml(design).splitlines()[1:]
    )
    centres = unit_centres(design) + np.array([design.pad.offset_x_mm, design.pad.offset_y_mm])
    square = f"size_mm = [{design.pad.size_mm!r}, {design.pad.size_mm!r}]"
    tables = [
        f"[[load]]\ncenter_mm = {centre.tolist()}\n{square}\ntraction_mpa = {traction.round(9).tolist()}\n"
        for centre, traction in zip(centres, traction_mpa, strict=True)
        if traction.any()
    ]
    row, col = divmod(chosen, design.array.cols)
    probe = f'[[probe]]\nname = "pad of row {row}, col {col}"\nkind = "mean"\n'
    tables.append(f"{probe}center_mm = {centres[chosen].tolist()}\n{square}\n")
    return SCENE_HEADING + nested + "\n\n" + "\n".join(tables)
