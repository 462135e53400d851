"""What the page hands over as files: its numbers as CSV, its loads as a scene that other commands take."""

import csv
import io

import numpy as np

from geometry.design import SensorDesign
from geometry.design_file import design_to_toml
from geometry.layout import AXES, PILLARS, FloatArray, unit_centres

HEAD = (
    *("row", "col", "x_mm", "y_mm"),
    *(f"traction_{axis}_mpa" for axis in AXES),
    *(f"resistance_{pillar}_ohm" for pillar in PILLARS),
    *(f"applied_f{axis}_n" for axis in AXES),
    *(f"decoupled_f{axis}_n" for axis in AXES),
)
HEADING = """# The array as the page showed it, for `tripillar view` and `tripillar solve`
[body]
kind = "array"

[design]
"""


def csv_of(
    design: SensorDesign,
    traction_mpa: FloatArray,
    resistance_ohm: FloatArray,
    applied_n: FloatArray,
    force_n: FloatArray,
) -> str:
    """A line a unit: its place, and what loads it, what it reads and what that is decoupled to.

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
    lines.writerow(HEAD)
    by_unit = [part.reshape(-1, 3) for part in (resistance_ohm, applied_n, force_n)]
    values = np.concatenate([unit_centres(design), traction_mpa, *by_unit], axis=1)
    for unit, numbers in enumerate(values.tolist()):
        place = divmod(unit, design.array.cols)
        lines.writerow([*place, *("" if np.isnan(number) else f"{number:.7g}" for number in numbers)])
    return written.getvalue()


def scene_of(design: SensorDesign, traction_mpa: FloatArray, chosen: int) -> str:
    """TOML of a scene of the same array under the same loads, for `tripillar solve` and `view`.

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
    tables.append(f'[[probe]]\nname = "pad of row {row}, col {col}"\nkind = "mean"\n')
    tables[-1] += f"center_mm = {centres[chosen].tolist()}\n{square}\n"
    return HEADING + nested + "\n\n" + "\n".join(tables)
