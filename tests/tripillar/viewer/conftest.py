"""A page's array of two units without a command around it, and a browser."""

import os

import pytest

from fem.array.solving import ResponseSettings, solve_response
from fem.pictures.arrays import solve_array_field
from geometry.design import Array, SensorDesign
from tripillar.viewer.page.page import Subject
from tripillar.viewer.page.scene import Superposition
from tripillar.viewer.page.sensing import SensorModel

DESIGN = SensorDesign(array=Array(rows=1, cols=2))
CHROMIUM = "/usr/bin/chromium"


@pytest.fixture(scope="module")
def browser():
    """Chromium; evil.test is this machine to it. While it is there nothing else in this process may run asyncio."""
    api = pytest.importorskip("playwright.sync_api")
    if not os.path.exists(CHROMIUM):
        pytest.skip(f"no {CHROMIUM}: install Debian's chromium")
    flags = ["--no-sandbox", "--enable-unsafe-swiftshader", "--host-resolver-rules=MAP evil.test 127.0.0.1"]
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def subject():
    """An array of two units; no decoupler: the forces are the resistances."""
    response = solve_response(DESIGN, ResponseSettings(method="layer"))  # a closed form: any response will do
    sensor = SensorModel(response, lambda resistance_ohm: resistance_ohm)
    return Subject(loads=Superposition(solve_array_field(DESIGN)), sensor=sensor, decoupler="nothing")
