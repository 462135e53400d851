"""Gain, offset and rest of a sensor: taken out, written, and refused where they make no sense."""

import json

import numpy as np
import pytest

from common.errors import FileFormatError
from common.storage.seal import opened_json
from hardware.readout.calibration import Electronics, SensorCalibration, read_calibration, write_calibration

SHAPE = (2, 3, 3)
REST_OHM = np.array([1e4, 1.4e4, 1.4e4])


def a_calibration(**changes):
    generator = np.random.default_rng(0)
    values = {
        "gain": generator.uniform(0.8, 1.2, SHAPE),
        "offset_ohm": generator.normal(0.0, 200.0, SHAPE),
        "rest_ohm": generator.uniform(9e3, 15e3, SHAPE),
        "electronics": Electronics(switch_ohm=70.0, line_ohm=3.0),
        "serial": 17,
        "made_from": {"loads": 4},
    }
    return SensorCalibration(**values | changes)


def as_designed(calibration, measured_ohm):
    """Resistances that the sensor as designed would show."""
    return calibration.as_designed_ohm(measured_ohm) * calibration.tare_factor(REST_OHM)


def test_gain_offset_and_a_tare_are_taken_out():
    """A rubber whose resistivity drifted by 7 % shows the design's resistances again, at rest and pressed."""
    fresh, share = a_calibration(rest_ohm=None), np.array([0.5, 0.8, 0.9])[:, None, None, None]
    designed = share * REST_OHM * np.ones(SHAPE)
    assert as_designed(fresh, fresh.gain * designed + fresh.offset_ohm) == pytest.approx(designed, rel=1e-12)
    tared = fresh.tared(fresh.gain * 1.07 * REST_OHM + fresh.offset_ohm)
    assert as_designed(tared, fresh.gain * 1.07 * designed + fresh.offset_ohm) == pytest.approx(designed, rel=1e-12)


@pytest.mark.parametrize("open_ohm", [4.2e5, 1e9])  # 10 bits tell an open pillar of a divider from no more than this
def test_a_broken_pillar_is_not_tared(open_ohm):
    calibration = SensorCalibration.as_designed(2, 3)
    rest = np.tile(REST_OHM, (2, 3, 1))
    rest[0, 0, 1] = open_ohm
    shown = as_designed(calibration.tared(rest), rest[None])
    assert shown[0, 0, 0, 1] == open_ohm


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kind": "spam"}, "kind 'spam'"),
        ({"gain": [[[1.0, 1.0]]]}, "gain of shape"),
        ({"gain": np.full(SHAPE, np.nan).tolist()}, "gain or a resistance at rest that is not above 0"),
        ({"electronics": {"spam": 1}}, "spam"),
        ({"serial": "x"}, "serial"),
        ('{"version": 1' + "0" * 5000 + "}", "a number has thousands of digits"),
        *((text, "") for text in ("", "[]", '{"kind": "tripillar calibration", "version": 1}')),
    ],
)
def test_what_is_no_calibration_is_refused(change, says):
    text = change if isinstance(change, str) else json.dumps(opened_json(a_calibration().to_json()) | change)
    message = r"is no calibration .*: give a file made by 'tripillar tare'"
    with pytest.raises(FileFormatError, match=message) as refused:
        SensorCalibration.from_json(text)
    assert says in str(refused.value)


def test_a_file_holds_all_of_it_and_a_number_changed_by_hand_states_no_hash(tmp_path):
    calibration = a_calibration()
    write_calibration(calibration, tmp_path / "own.json")
    found = read_calibration(tmp_path / "own.json")
    for name, value in vars(calibration).items():
        assert np.array_equal(getattr(found, name), value), name
    plain = json.loads(calibration.to_json())
    plain["gain"][0][0][0] += 1.0
    with pytest.raises(FileFormatError, match="do not match the hash it states; drop 'sha256' if you changed them"):
        SensorCalibration.from_json(json.dumps(plain))
    del plain["sha256"]
    assert SensorCalibration.from_json(json.dumps(plain)).gain[0, 0, 0] == plain["gain"][0][0][0]
