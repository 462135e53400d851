"""A page's array of two units without a command around it, served in this process, and a browser."""

import asyncio
import os
from contextlib import contextmanager
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest

from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, SensorDesign
from hardware.streams.stream import listening_on
from tripillar.viewer import panels as shown
from tripillar.viewer.page.page import Subject
from tripillar.viewer.page.sensing import PressedSensor, inverse_forces
from tripillar.viewer.page.server import Server

DESIGN = SensorDesign(array=Array(rows=1, cols=2))
CHROMIUM = "/usr/bin/chromium"


@pytest.fixture(scope="module")
def browser():
    """Chromium. While it is there nothing else in this thread may run asyncio."""
    api = pytest.importorskip("playwright.sync_api")
    if not os.path.exists(CHROMIUM):
        pytest.skip(f"no {CHROMIUM}: install Debian's chromium")
    flags = ["--no-sandbox", "--enable-unsafe-swiftshader"]
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def subject(pair_field):
    """An array of two units with the response's own inverse."""
    response = solve_response(DESIGN, ResponseSettings(method="layer"))  # a closed form: any response will do
    sensor = PressedSensor(response, inverse_forces(response))
    return Subject(field=pair_field.prepared(), sensor=sensor, decoupler="the response's inverse")


@pytest.fixture(scope="session")
def panels(subject):
    """Parts of its array under 1 and 3 MPa on every pad."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shown, "solve_array_field", lambda *_: subject.field)
        return shown.panels_of(DESIGN, (1.0, 3.0), "uniform", stress=True)


def a_feed(**said):
    """A recording that is over."""
    silent = {"port": "/dev/ttyACM0", "scan": None, "trouble": "", "link": "", "ended": True, "play_again": None}
    silent |= {"is_stale": False}
    return SimpleNamespace(**silent | {"faults": [], "contacts": [], "listeners": set()} | said)


def a_scan(**said):
    """A scan of a sensor of two units at rest, by a model that knows nothing more."""
    silent = {"deviation_n": None, "moment_nmm": None, "moment_deviation_nmm": None}
    return SimpleNamespace(
        **{"force_n": np.zeros((1, 2, 3)), "resistance_ohm": np.full((1, 2, 3), 1e4)} | silent | said
    )


@contextmanager
def serving(subject):
    """The address of a page that a thread serves, its sensor not looked at."""
    loop = asyncio.new_event_loop()
    thread, server = Thread(target=loop.run_forever), Server(subject, "127.0.0.1")
    thread.start()
    try:
        starting = server.start(listening_on("127.0.0.1", 0))
        yield asyncio.run_coroutine_threadsafe(starting, loop).result()
        asyncio.run_coroutine_threadsafe(server.stop(), loop).result()
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
