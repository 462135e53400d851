"""A hundred seconds, or an hour, of frames at 200 Hz by the board's clock: nothing lost, memory flat."""

import numpy as np
import psutil
import pytest

from hardware.link.frames import Info, ScanMode
from hardware.readout.calibration import Electronics
from hardware.readout.forces import ForceReader
from tests.hardware.boards import Bench
from tests.hardware.models import PillarModel

INFO = Info(rate_hz=200, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700)


@pytest.mark.parametrize("seconds", [100, pytest.param(3600, marks=pytest.mark.long)])
def test_many_frames_in_flat_memory(seconds):
    """Between a tenth of the time and its end, the process grows by less than 4 MB.

    That is 5.5 bytes a frame of an hour, half a frame of a hundred seconds.
    """
    states = [1e4, 1.4e4, 1.4e4] * np.random.default_rng(0).uniform(0.6, 1.1, (100, 6, 6, 3))
    bench, process, memory_mb, n = Bench(Electronics().crossbar(INFO).counts(states), INFO), psutil.Process(), [], 0
    bench.board.frames._number = 65_000  # wraps early
    reader = ForceReader(INFO, PillarModel(lambda ohms: ohms / ohms[:, :1, :1] - 1))
    began_s = bench.clock()
    for part in range(10 * seconds // 5):
        scans = bench.run(0.5)
        if scans:
            forces = reader.forces(np.stack([scan.frame.counts for scan in scans]))
            assert np.isfinite(forces.force_n).all()
            n += len(scans)
        if part % (seconds // 5) == seconds // 5 - 1:
            memory_mb.append(process.memory_info().rss / 2**20)
    statistics = bench.link.reception.statistics
    assert statistics.ok == pytest.approx((bench.clock() - began_s) * INFO.rate_hz, abs=2)
    assert statistics.ok - n < INFO.rate_hz  # those before it was asked what they are
    assert statistics.lost == statistics.restarts == statistics.bad_crc == statistics.overruns == 0
    assert max(memory_mb[1:]) - memory_mb[0] < 4
