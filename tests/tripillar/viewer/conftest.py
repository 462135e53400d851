"""A page's array of two units without a command around it."""

import pytest

from fem.array.solving import ResponseSettings, solve_response
from fem.fields.array_field import solve_array_field
from geometry.design import Array, SensorDesign
from tripillar.viewer.page.page import Subject
from tripillar.viewer.page.scene import Superposition
from tripillar.viewer.page.sensing import SensorModel

DESIGN = SensorDesign(array=Array(rows=1, cols=2))


@pytest.fixture(scope="session")
def subject():
    """An array of two units; no decoupler: the forces are the resistances."""
    response = solve_response(DESIGN, ResponseSettings(method="layer"))  # a closed form: any response will do
    sensor = SensorModel(response, lambda resistance_ohm: resistance_ohm)
    return Subject(loads=Superposition(solve_array_field(DESIGN)), sensor=sensor, decoupler="nothing")
