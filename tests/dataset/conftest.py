"""A response that no finite elements made: known in closed form, symmetric, and shaped like an array's."""

import numpy as np
import pytest

from fem.array.response import ArrayResponse
from geometry import Array, SensorDesign
from geometry.design import Unit
from geometry.layout import LAYOUTS, unit_centres, upper_electrodes

#: mm per N that an electrode under the load gives along x, y, z; and by how much a shear tilts it
COMPLIANCE = (0.005, 0.005, 0.0017)
TILT = 0.0006


@pytest.fixture(scope="session")
def response() -> ArrayResponse:
    """2 × 3 units; electrodes follow a load the less the further off it is, exp(−r/6 mm).

    Pressure strains pillars by 5 to 29 %: a cap of 0.3 takes all samples, one of 0.2 redraws about half.
    """
    return made_up_response(SensorDesign(array=Array(rows=2, cols=3)))


@pytest.fixture(scope="session", params=LAYOUTS)
def any_response(request) -> ArrayResponse:
    """The same of each layout."""
    return made_up_response(SensorDesign(unit=Unit(layout=LAYOUTS[request.param]), array=Array(rows=2, cols=3)))


def made_up_response(design: SensorDesign) -> ArrayResponse:
    rows, cols = design.array.rows, design.array.cols
    centres = unit_centres(design)
    electrodes = (centres[:, None] + upper_electrodes(design.unit)[:, :2]).reshape(-1, 2)
    distance = np.linalg.norm(electrodes[:, None] - centres, axis=2)
    nearby = np.exp(-distance / 6.0) / np.exp(-np.hypot(5.0, 5.0) / 6.0)
    axes = np.diag(COMPLIANCE)
    axes[2, 0], axes[0, 2] = TILT, TILT / 2  # along x, drag lifts and pressure pushes aside
    axes[2, 1], axes[1, 2] = -TILT, TILT / 2
    influence = np.einsum("ek,ab->eakb", nearby, axes)
    return ArrayResponse(
        design=design,
        influence_mm_per_n=influence.reshape(rows, cols, -1, 3, rows, cols, 3),
        residual=1.25e-14,
        unknowns=1234,
        mesh_hash="00112233445566ff",
        seconds={},
    )
