"""Forces as lines for a pipe: every scan, with deviations that are calculated less often."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from hardware.link.frames import Frame
from hardware.link.reception import Scan
from hardware.readout.live import Forces
from tripillar.board import follow

RATE_HZ = 150


class Reading:
    """What `print_lines` needs of a session."""

    scanner = SimpleNamespace(trouble=None, dropped=3)
    model = SimpleNamespace(component=SimpleNamespace(axes=("z",)))

    def __init__(self, knows_uncertainty):
        self.knows_uncertainty, self.calculated = knows_uncertainty, 0

    def forces(self, scan):
        force_n = np.full((1, 1, 2, 1), scan.frame.sequence + 1 / 3)
        return Forces(force_n=force_n, resistance_ohm=np.ones((1, 1, 2, 3)), saturated=np.zeros((1, 1, 2, 3), bool))

    def deviations(self, found):
        self.calculated += 1
        return found.force_n[0] / 100 if self.knows_uncertainty else None


@pytest.mark.parametrize("knows_uncertainty", [True, False])
def test_every_scan_is_a_line_and_deviations_are_a_tenth_of_a_second_old_at_most(
    knows_uncertainty, monkeypatch, capsys
):
    frames = [Frame(sequence=k, device_us=0, bits=10, counts=np.ones(6, int)) for k in range(RATE_HZ)]
    scans = [
        Scan(frame=frame, received_s=100 + k / RATE_HZ, time_s=k / RATE_HZ, restarts=0, run=0)
        for k, frame in enumerate(frames)
    ]
    monkeypatch.setattr(follow, "scans", lambda scanner, seconds: scans)
    reading = Reading(knows_uncertainty)
    follow.print_lines(reading, 1.0)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["sequence"] for line in lines] == list(range(RATE_HZ))
    assert [line["force_n"] for line in lines] == [[[[round(k + 1 / 3, 4)]] * 2] for k in range(RATE_HZ)]
    assert {line["dropped"] for line in lines} == {3}
    assert reading.calculated <= 11
    if knows_uncertainty:
        ages = [k + 1 / 3 - 100 * line["deviation_n"][0][0][0] for k, line in enumerate(lines)]
        assert max(ages) / RATE_HZ < 0.1 + 0.01
    else:
        assert {line["deviation_n"] for line in lines} == {None}
