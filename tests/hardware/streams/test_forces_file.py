"""Files of forces: what any reader finds in them, and slices of forces are forces."""

import numpy as np
import pytest
import xarray as xr

from geometry.errors import FileFormatError
from hardware import replay, write_forces
from hardware.recording.topics import FORCES, INFO, SCAN, SENSOR, WRENCH
from tests.hardware.recording.test_mcap import messages


def by_unit(content, name):
    """One of the units' values, shape (rows, cols, k)."""
    return np.array([unit[name] for unit in content["units"]]).reshape(content["rows"], content["cols"], -1)


def test_an_mcap_file_holds_the_scans_and_beside_each_its_forces_and_net_load(recording, pressed, tmp_path):
    forces, path = replay(recording, pressed.model), tmp_path / "press.mcap"
    write_forces(recording, forces, path)
    found = messages(path)
    assert list(found) == [INFO, SENSOR, SCAN, FORCES, WRENCH]
    assert [content for _, content in found[SENSOR]] == [forces.description.plain()]
    assert [len(found[topic]) for topic in (SCAN, FORCES, WRENCH)] == [40] * 3
    for k, (message, content) in enumerate(found[FORCES]):
        assert message.log_time / 10**9 == content["time"] == recording.received_s[k]
        assert [(unit["row"], unit["col"]) for unit in content["units"]] == list(np.ndindex(2, 3))
        assert np.abs(by_unit(content, "force_n") - forces.force_n[k]).max() <= 0.5001e-6  # six decimals
        assert np.abs(by_unit(content, "deviation_n") - forces.deviation_n[k]).max() <= 0.5001e-6
    for k, (_, content) in enumerate(found[WRENCH]):
        assert content["net_force_n"] == pytest.approx(forces.wrench.force_n[k], rel=1e-5)  # six digits


def test_netcdf_holds_what_the_forces_are(recording, pressed, tmp_path):
    forces, path = replay(recording, pressed.model), tmp_path / "press.nc"
    write_forces(recording, forces, path)
    with xr.open_dataset(path) as data:
        for name in ("force_n", "deviation_n", "chi2"):
            assert np.array_equal(data[name], getattr(forces, name)), name
        assert np.array_equal(data["net_force_n"], forces.wrench.force_n)
        assert data["force_n"].coords["axis"].values.tolist() == ["x", "y", "z"]


@pytest.mark.parametrize(("name", "ros2"), [("press.txt", False), ("press.nc", True)])
def test_other_suffixes_are_refused(recording, pressed, tmp_path, name, ros2):
    with pytest.raises(FileFormatError, match=r"no form of forces: end the name in"):
        write_forces(recording, replay(recording, pressed.model), tmp_path / name, ros2)


def test_a_slice_of_forces_is_forces_with_all_that_is_known_of_them(recording, pressed):
    """One scan is without the first axis; deviations are the same before and after they were asked for."""
    fresh, asked = replay(recording, pressed.model), replay(recording, pressed.model)
    assert asked.deviation_n.shape == asked.force_n.shape == (40, 2, 3, 3)
    for which in (7, slice(3, 9)):
        for part in (fresh[which], asked[which]):
            for name in ("force_n", "resistance_ohm", "saturated", "time_s", "sequence", "chi2", "unexplained"):
                assert np.array_equal(getattr(part, name), getattr(asked, name)[which]), name
            assert part.deviation_n == pytest.approx(asked.deviation_n[which], rel=1e-9)
            for name, values in vars(asked.wrench).items():
                assert getattr(part.wrench, name) == pytest.approx(values[which], rel=1e-6, nan_ok=True), name
    assert fresh.description is fresh[0].description
