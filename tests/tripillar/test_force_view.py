"""Forces in the terminal: units as they lie, shear as arrows, colours by force; or a line for a pipe each."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from dataset.measurement import ReadingError
from decoupler.data.columns import COMPONENTS
from geometry.layout import AXES
from hardware.link.frames import Frame, Info
from hardware.link.reception import LinkStatistics, Scan
from hardware.readout.calibration import SensorCalibration
from hardware.readout.forces import LiveSensor
from hardware.readout.wrench import net_wrench, wrench_weights
from tests.hardware.models import Unknown
from tripillar.terminal import force_view
from tripillar.terminal.force_view import force_table, live_view

PLACES = np.array([[[5.0, 3.0, 0.0], [15.0, 3.0, 0.0]]])  #: of two pads [mm]
RATE_HZ = 150


def drawn(renderable):
    console = Console(width=120, color_system=None, record=True)
    with console.capture() as capture:
        console.print(renderable)
    return capture.get()


def test_units_are_drawn_as_they_lie_with_arrows_along_the_shear_and_what_is_wrong_is_said():
    """Row 0 has the least y: it is drawn last. Of a model of shear alone the number is its size."""
    lines = drawn(force_table(np.arange(6.0).reshape(2, 3, 1), ("z",), 10.0)).splitlines()
    assert [line.split() for line in lines] == [["3.0", "4.0", "5.0"], ["0.0", "1.0", "2.0"]]
    arrows = {(1, 0): "→", (0, 1): "↑", (-1, 0): "←", (0, -1): "↓", (1, 1): "↗", (-1, -1): "↙", (0.1, 0.0): " "}
    for (fx, fy), arrow in arrows.items():
        assert f"5.0 {arrow}" in drawn(force_table(np.array([[[fx, fy, 5.0]]]), AXES, 10.0))
    assert "3.0 ←" in drawn(force_table(np.array([[[-3.0]]]), ("x",), 10.0))
    force_n = np.ones((1, 2, 3))
    wrench = net_wrench(force_n, wrench_weights(PLACES, AXES))
    memory = {"memory_rise": np.array([0.03, -0.05]), "memory_deviation": np.array([0.02, 0.02]), "memory_tested": True}
    scan = SimpleNamespace(force_n=force_n, deviation_n=force_n, wrench=wrench, contacts=None, **memory)
    text = drawn(live_view(scan, AXES, 10.0, 150.0, LinkStatistics(ok=7, lost=2), ["no frames for 2 s"]))
    pressed = "centre of pressure x 10.0, y 3.0 mm"
    assert max(len(line.rstrip()) for line in text.splitlines()) <= 80
    for said in (
        "150.0 frames/s",
        "7 ok",
        "2 lost",
        "no frames for 2 s",
        "ΣFz      2.0 N",
        "± 1.0 N",
        pressed,
        "memory: 4.1 %",
    ):
        assert said in text


class Model(Unknown):
    """Tells Fz of scan k as k + 1/3 [N]; counts how often deviations, a hundredth of it, are calculated."""

    rows, cols, component, dead, fault_test = 1, 2, COMPONENTS["fz"], None, None
    calculated, fz_n = 0, -2 / 3

    def rest_resistances(self):
        return None

    def forces(self, resistance_ohm):
        self.fz_n += 1
        return np.full((1, 1, 2, 1), self.fz_n)

    def consistency(self, resistance_ohm, force_n=None):
        return np.full(len(resistance_ohm), 1.23456), np.full(len(resistance_ohm), 2.0)

    def deviations(self, resistance_ohm, weights):
        self.calculated += 1
        return np.full((1, 1, 2, 1), self.fz_n / 100), np.ones((1, 6, 6))


def scan(k, us=0, run=0):
    frame = Frame(sequence=k, device_us=us, bits=10, counts=np.ones(6, int))
    stamp_ns = k * 10**9 // RATE_HZ
    return Scan(frame=frame, received_s=100 + k / RATE_HZ, stamp_ns=stamp_ns, restarts=0, run=run)


def test_every_scan_is_a_line_and_deviations_are_a_tenth_of_a_second_old_at_most(monkeypatch, capsys):
    monkeypatch.setattr(force_view, "scans_within", lambda scanner, seconds, **_: map(scan, range(RATE_HZ)))
    scanner, model = SimpleNamespace(info=Info(rows=1, cols=2), trouble=None, stats=LinkStatistics(dropped=3)), Model()
    object.__setattr__(model, "errors", ReadingError(noise=0.01))
    sensor = LiveSensor(scanner, model, SensorCalibration.as_designed(1, 2))
    sensor._reader.fault_test, sensor._faults = None, {"row wire 3 stuck": 1}
    sensor._reader._weights = wrench_weights(PLACES, ("z",))
    force_view.print_lines(sensor, 1.0)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["sequence"] for line in lines] == list(range(RATE_HZ))
    times = [line["time_s"] for line in lines]
    assert (times, len(set(times))) == (sorted(times), RATE_HZ)
    for k, line in enumerate(lines):
        assert line["force_n"] == [[[round(k + 1 / 3, 4)]] * 2]
        told = (line["dropped"], line["chi2"], line["explained"], *line["faults"], *line["net_force_n"][:2])
        assert told == (3, 1.235, True, "row wire 3 stuck", None, None)  # the model knows Fz alone
        assert line["net_force_n"][2] == pytest.approx(2 * k + 2 / 3, rel=1e-5)
        assert line["centre_of_pressure_mm"] == ([10.0, 3.0] if k > 4 else line["centre_of_pressure_mm"])
    assert lines[0]["centre_of_pressure_mm"] == []  # 0.67 N are no touch
    assert lines[0]["net_force_deviation_n"]
    assert model.calculated <= 11
    ages = [k + 1 / 3 - 100 * line["deviation_n"][0][0][0] for k, line in enumerate(lines)]
    assert max(ages) / RATE_HZ < 0.1 + 0.01
    force_view.show_forces(sensor, 1.0)
    assert capsys.readouterr().out.endswith("stuck\n")  # in a file, too, the last line has an end


def test_forces_of_a_sensor_that_is_silent_are_grey_and_it_is_said_since_when(monkeypatch, capsys):
    scanner = SimpleNamespace(
        info=Info(rows=1, cols=2), trouble="disconnected: plug the board in again", stats=LinkStatistics(), ended=False
    )
    sensor = LiveSensor(scanner, Model(), SensorCalibration.as_designed(1, 2))
    monkeypatch.setattr(force_view, "scans_within", lambda *_, **__: iter([scan(0), None]))
    times_s = iter([0.0, 10.0, 10.0, 10.0, 17.0, 17.0])
    monkeypatch.setattr(force_view.time, "monotonic", lambda: next(times_s))
    force_view.show_forces(sensor, 1.0)
    assert "no scan for 7 s\ndisconnected: plug the board in again\n" in capsys.readouterr().out
    grey, coloured = (force_view.force_table(np.full((1, 1, 1), 5.0), ("z",), 9.0, stale) for stale in (True, False))
    assert ([cell.style for cell in grey.columns[0].cells] == ["dim"]) > ("dim" in str(coloured.columns[0].cells))


def test_the_rate_is_the_boards_while_a_backlog_is_caught_up_with():
    """150 Hz on the board's clock, which turns over meanwhile; all received at once, some of a run before."""
    scans = [scan(0, us=5), *(scan(0, (2**32 - 20_000 + k * 10**6 // RATE_HZ) % 2**32, run=1) for k in range(64))]
    assert force_view.pace(scans) == pytest.approx(RATE_HZ, rel=1e-4)
    assert force_view.pace(scans[:1]) == force_view.pace([]) == 0.0


def test_a_line_on_trouble_says_when_and_a_clock_that_is_wrong_is_said(monkeypatch, capsys):
    troubles = iter(["the port is gone: plug it in again.", None])
    scanner = SimpleNamespace(info=Info(rows=1, cols=2), stats=LinkStatistics())

    def silence(scanner, seconds, **_):
        for scanner.trouble in troubles:
            yield None

    monkeypatch.setattr(force_view, "scans_within", silence)
    monkeypatch.setattr(force_view.time, "time", lambda: 1.8e9)
    force_view.print_lines(LiveSensor(scanner, Model(), SensorCalibration.as_designed(1, 2)), 1.0)
    first, last = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert first == {"time_s": 1.8e9, "trouble": "the port is gone: plug it in again."}
    assert last == {"time_s": 1.8e9, "trouble": None}
    assert [LinkStatistics(clock_pace=pace).clock_said for pace in (1.0, 1.01, 0.95)] == ["", "", ""]
    assert LinkStatistics(clock_pace=10.0).clock_said == "the board's clock runs 10 times as fast as this computer's"
