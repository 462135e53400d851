"""Figures 6, 7 and 8: the grid of electrodes at rest and loaded, and the array under three pressures.

`fem.pictures.deformation` is imported where it is needed: it loads pyvista, which takes a second.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from studies.paper.deformation import Sample, one_pad
from tripillar.pipeline.printed import PRESSURES_MPA


def draw_figure_6(response: ArrayResponse, path: Path) -> None:
    """Write a PNG: the electrodes "2" at rest."""
    from fem.pictures.deformation import draw_electrode_grid

    draw_electrode_grid(response, None, path)


def draw_figure_7(design: SensorDesign, path: Path) -> None:
    """Write a PNG: three by three of a design's units under 1, 3 and 5 MPa on the middle pad, true scale.

    They stand below each other: side by side they would be too small on a page.
    """
    from fem.fields.array_field import array_field
    from fem.pictures.deformation import draw_deformed

    nine = replace(design, array=replace(design.array, rows=3, cols=3))
    loads = {f"{pressure:g} MPa": one_pad(nine, pressure) for pressure in PRESSURES_MPA}
    draw_deformed(array_field(nine), loads, path, columns=1)


def draw_figure_8(response: ArrayResponse, sample: Sample, path: Path) -> None:
    """Write a PNG: the same electrodes under a sample of our data."""
    from fem.pictures.deformation import draw_electrode_grid

    draw_electrode_grid(response, np.array(sample.traction_mpa), path)
