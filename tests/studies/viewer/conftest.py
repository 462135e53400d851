"""What a page without a command around it shows."""

import pytest

from fem.array_field import array_field
from fem.array_response import array_response
from geometry.design import Array, SensorDesign
from studies.viewer.page.page import Subject
from studies.viewer.page.sensing import SensorModel
from studies.viewer.page.superposition import Superposition

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
