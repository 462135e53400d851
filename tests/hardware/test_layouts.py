"""One contract for boards, recordings, calibrations and streams of all layouts."""

import json
from dataclasses import replace

import numpy as np
import pytest

from common.errors import FileFormatError
from common.storage.seal import opened_json
from geometry.design import Unit
from geometry.layout import AXES, LAYOUTS, SONG2018, rest_lengths
from geometry.layout_file import layout_text
from hardware.boards.python_board import PythonBoard
from hardware.boards.sensor_header import sensor_header
from hardware.boards.simavr_board import FIRMWARE
from hardware.link.frames import Info, ScanMode
from hardware.link.scanner import Scanner
from hardware.readout.calibration import Electronics, SensorCalibration
from hardware.readout.forces import replay
from hardware.recording import read_recording
from hardware.recording.recorded import Header, read_header
from hardware.session import record_scans
from hardware.streams.files import convert
from hardware.streams.ros2_file import shape_message
from tests.fem.scenes import BESIDE
from tests.hardware.boards import SHARED
from tests.hardware.models import Unknown

EACH = {**LAYOUTS, "shared wires": SHARED, "reference": BESIDE}


class Shortening(Unknown):
    """A model whose force along an axis is the mean share by which the pillars that sense it are off rest."""

    rows = cols = 2

    def __init__(self, layout):
        self.layout, self.rest_ohm = layout, 1e3 * rest_lengths(Unit(layout=layout))

    def rest_resistances(self):
        return np.tile(self.rest_ohm, (2, 2, 1))

    def forces(self, resistance_ohm):
        shares = resistance_ohm / self.rest_ohm - 1
        return np.stack([shares[..., self.layout.sensing(axis)].mean(axis=-1) for axis in AXES], axis=-1)


@pytest.mark.parametrize("layout", EACH.values(), ids=EACH)
def test_readings_go_over_a_terminal_into_a_file_and_come_back_as_forces(layout, tmp_path):
    """16 bits tell a resistance to 1e-4; all that is written names the layout and its pillars."""
    info = Info(rows=2, cols=2, bits=16, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=200, layout=layout)
    model, path, n = Shortening(layout), tmp_path / "press.frames", len(layout.pillars)
    ohms = model.rest_ohm * np.random.default_rng(0).uniform(0.7, 1.05, (4, 2, 2, n))
    counts = Electronics().crossbar(info).counts(ohms)
    with PythonBoard(counts, info) as board, Scanner(board.port) as scanner:
        assert scanner.info == info
        tared = SensorCalibration.as_designed(2, 2, layout=layout).tared(1.1 * model.rest_resistances())
        record_scans(scanner, path, 0.1, tared)
    recording = read_recording(path)
    assert recording.info == info
    found = replay(recording, model, SensorCalibration.as_designed(2, 2, layout=layout))
    sent = [int((row == counts).all(axis=1).argmax()) for row in recording.counts]  # which of the four
    assert found.resistance_ohm == pytest.approx(ohms[sent], rel=1e-4)
    assert found.force_n == pytest.approx(model.forces(ohms[sent]), abs=1e-4)
    by_own = replay(recording, model)  # its calibration takes 1.1 times the rest for the rest
    assert by_own.resistance_ohm == pytest.approx(ohms[sent] / 1.1, rel=1e-4)
    names = list(layout.pillar_names)
    assert found.to_xarray()["pillar"].values.tolist() == names
    assert json.loads(found.to_xarray().attrs["sensor"])["pillars"] == names
    assert shape_message(found.description, 0)["pillars"] == names
    convert(recording, tmp_path / "press.nc")
    assert recording.to_xarray().attrs["layout"] == layout_text(layout)
    other = Shortening(SONG2018 if layout != SONG2018 else SHARED)
    for act in (lambda: replay(recording, other), lambda: tared.require_for(replace(info, layout=other.layout))):
        with pytest.raises(
            FileFormatError, match=r"layout .*: (take a model trained for this array|calibrate this sensor)"
        ) as no:
            act()
        assert "\n" not in str(no.value)
    assert SensorCalibration.from_json(tared.to_json()).layout == layout


def test_what_states_no_layout_is_the_papers():
    """Recordings, calibrations and boards of before; the header with which the firmware is built unless told."""
    plain = Header(info=Info()).plain()
    assert plain.pop("layout") == "song2018"
    assert read_header(plain, "recording") == Header(info=Info())
    written = opened_json(SensorCalibration.as_designed(1, 2).to_json())
    assert written.pop("layout") == "song2018"
    assert SensorCalibration.from_json(json.dumps(written)).layout == SONG2018
    assert sensor_header(6, 6, SONG2018) == (FIRMWARE / "sensor.h").read_text()
    assert 'LAYOUT ""' in sensor_header(6, 6, SONG2018)
    assert sensor_header(2, 3, SHARED).startswith("// 2 x 3 units of 6 pillars each; ")
