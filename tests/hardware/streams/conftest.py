"""A pressed sensor behind a simulated board, and a recording of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from hardware import live
from hardware.boards.virtual_board import VirtualBoard
from hardware.link.frames import Frame
from hardware.recording import Recorder, read_recording
from tests.hardware.models import INFO

BEGAN_S = 1.8e9  #: Unix time


@pytest.fixture(scope="package")
def board(pressed):
    """A simulated board, live: the `description` of its sensor, and `take(n)` scans of it."""
    with VirtualBoard(pressed.counts, INFO) as board, live(board.port, pressed.model) as scans:

        def take(n):
            return [scans.forces(scans.scanner.get(10), renewed_s=0.1) for _ in range(n)]

        yield SimpleNamespace(description=scans.description, take=take)


@pytest.fixture(scope="package")
def recording(pressed, tmp_path_factory):
    """40 scans, 5 ms apart by the board's clock; they arrive up to 3 ms late, and the board restarts after 20."""
    late_s = np.random.default_rng(2).uniform(0.0, 0.003, 40)
    late_s[[0, 20]] = 0.0  # what each run is told by at once
    path = tmp_path_factory.mktemp("recorded") / "press.frames"
    with Recorder(path, INFO) as recorder:
        for k in range(40):
            if k == 20:
                recorder.begin_run("restart")
            us = (2**32 - 20_000 + 5000 * k) % 2**32 if k < 20 else 5000 * (k - 20)
            frame = Frame(
                sequence=k % 20, device_us=us, bits=INFO.bits, counts=pressed.counts[k], scan_mode=INFO.scan_mode
            )
            recorder.append(frame, BEGAN_S + 0.005 * k + late_s[k])
    return read_recording(path)
