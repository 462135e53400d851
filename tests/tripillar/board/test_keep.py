"""What a recording's summary says, against what was sent, and against what is read from the file."""

from dataclasses import replace

import pytest

from hardware.link.frames import encode
from hardware.link.scanner import Scanner
from hardware.link.serial_ports import PortError
from hardware.recording import read_recording
from tests.hardware.boards import INFO, ScriptedPort, a_wire
from tripillar.board.keep import met_beside, record_scans

HEAD = encode(INFO)


def recorded(path, *pieces, **options):
    """Record what ports give, one after the other; the summary, and what the file says."""
    ports = [ScriptedPort(HEAD, *each) for each in pieces]
    scanner = Scanner("scripted", opener=lambda url, **options: ports.pop(0), **options)
    with scanner:
        met = record_scans(scanner, path, 60.0, append=path.exists())
    return met, read_recording(path)


def wires(*numbers):
    return [a_wire(number) for number in numbers]


def test_what_was_lost_repeated_and_damaged_is_said_and_read_alike(tmp_path):
    """Scans 65530 to 65540, of which 65533 and 65537 never came, 65535 came twice and 65534 damaged."""
    damaged = bytearray(a_wire(65534))
    damaged[50] ^= 1
    first, second = wires(65530, 65531, 65532), wires(65535, 65535, 65536, 65538, 65539, 65540)
    met, recording = recorded(tmp_path / "a.frames", [*first, bytes(damaged), *second])
    assert (met.scans, met.statistics.lost, met.statistics.repeated) == (8, 3, 1)
    assert met_beside(met.statistics) == ["1 damaged", "1 repeated"]
    assert recording.sequence.tolist() == [65530, 65531, 65532, 65535, 0, 2, 3, 4]
    assert (recording.statistics.lost, recording.statistics.restarts) == (3, 0)
    assert (recording.statistics.repeated, recording.statistics.bad_crc + recording.statistics.bad_cobs) == (1, 1)


def test_frames_of_another_board_are_in_the_summary(tmp_path):
    other = a_wire(5, info=replace(INFO, rows=2))
    met, recording = recorded(tmp_path / "a.frames", [*wires(0, 1), other, HEAD, *wires(2, 3)])
    assert met.statistics.foreign == recording.statistics.foreign == 1
    assert (met.scans, met.statistics.lost, recording.statistics.lost) == (4, 0, 0)
    assert "1 of another board" in met_beside(met.statistics)


def test_restarts_and_new_connections_are_no_losses(tmp_path):
    """Unplugged after scan 101, back at 150; then reset."""
    met, recording = recorded(
        tmp_path / "a.frames", [*wires(100, 101), PortError("gone")], [*wires(150, 151), *wires(0, 1, 3)]
    )
    assert (met.scans, met.statistics.lost, met.statistics.restarts, met.statistics.reconnects) == (7, 1, 1, 1)
    assert (recording.statistics.lost, recording.statistics.restarts) == (1, 1)
    assert recording.run.tolist() == [0, 0, 1, 1, 2, 2, 2]


def test_frames_between_two_sessions_are_not_lost(tmp_path):
    path = tmp_path / "a.frames"
    recorded(path, wires(0, 1))
    met, recording = recorded(path, wires(500, 501, 503))
    assert (met.scans, met.statistics.lost) == (3, 1)
    assert (recording.statistics.ok, recording.statistics.lost, recording.statistics.restarts) == (5, 1, 0)


@pytest.mark.parametrize("queue", [1, 4])
def test_scans_that_were_not_taken_in_time_are_lost_and_said(tmp_path, queue):
    met, recording = recorded(tmp_path / "a.frames", [b"".join(wires(*range(50)))], queue=queue)
    assert met.scans + met.statistics.dropped == 50
    assert recording.statistics.lost == met.statistics.lost  # those before the first scan taken nobody can miss
    assert any("too slow" in said for said in met_beside(met.statistics))
