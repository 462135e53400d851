"""What a page without a command around it shows."""

import pytest

from fem.array.solving import array_response
from fem.fields.array_field import array_field
from geometry.design import Array, SensorDesign
from tripillar.viewer.page.page import Subject
from tripillar.viewer.page.sensing import SensorModel
from tripillar.viewer.page.superposition import Superposition

DESIGN = SensorDesign(array=Array(rows=1, cols=2))


class Echo:
    """No decoupler: the forces are the resistances."""

    name = "nothing"

    def forces(self, resistance_ohm):
        return resistance_ohm


@pytest.fixture(scope="session")
def subject():
    """An array of two units, as a browser's page takes it."""
    response, _, _ = array_response(DESIGN)
    return Subject(loads=Superposition(array_field(DESIGN)), sensor=SensorModel(response), source=Echo())
