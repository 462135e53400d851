"""The sensor that drives the page: its newest scan, decoupled; none is asked for twice."""

import time

import numpy as np
import pytest

from decoupler.data.columns import component_named
from decoupler.data.scaling import Scaling
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig
from hardware.boards.virtual_board import recording_from_resistances
from hardware.link.frames import Info, ScanMode
from tripillar.viewer.page.feed import SensorFeed

INFO = Info(rows=1, cols=2, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=50)


@pytest.fixture
def model():
    """Forces Fz of a linear net: 1 N for each kΩ of its unit's z pillar."""
    plain = Scaling(centre=np.zeros(2), half_range=np.full(2, 1e3))
    return Decoupler(
        component=component_named("fz"), rows=1, cols=2,
        network=NetworkConfig(hidden=1, net="skip", feature="resistance"),
        input_scaling=plain, output_scaling=Scaling(centre=np.zeros(2), half_range=np.ones(2)),
        hidden_weights=np.zeros((1, 3)), output_weights=np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
        design=None,
    )  # fmt: skip


def test_the_newest_scan_is_decoupled_and_a_recording_ends_and_plays_again(model, tmp_path):
    ohms = np.full((10, 1, 2, 3), 14e3)
    ohms[:, 0, :, 0] = [10e3, 8e3]
    ohms[:5] *= 1.1  # not the newest
    path = tmp_path / "scans.bin"
    path.write_bytes(recording_from_resistances(ohms, INFO))
    with SensorFeed(str(path), model) as feed:
        assert feed.is_recording
        for _ in range(2):
            last, end_s = None, time.monotonic() + 20
            while not feed.ended and time.monotonic() < end_s:
                last = feed.newest() or last
                time.sleep(0.01)
            assert feed.status == "recording ended"
            np.testing.assert_allclose(last.force_n[0, :, 2], [10.0, 8.0], rtol=2e-3)  # steps of 12 bits
            assert np.isnan(last.force_n[..., :2]).all()
            assert feed.newest() is None
            feed.play_again()
