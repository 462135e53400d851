"""A connected board: its forces live, and the summary of a recording against what was sent and what the file says."""

import subprocess
import sys
import time
from collections import deque
from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

from hardware import session
from hardware.boards.python_board import PythonBoard
from hardware.link.frames import ScanMode, encode
from hardware.link.reception import LinkStatistics
from hardware.link.scanner import Scanner, ScannerError
from hardware.link.serial_ports import PortError, is_beginning
from hardware.readout.calibration import Electronics
from hardware.recording import read_recording
from hardware.session import live, measure_link, record_scans
from tests.hardware.boards import COUNTS, INFO, ScriptedPort, a_wire, recording_from_resistances
from tests.hardware.models import PillarModel
from tripillar.face.boards import other_counts

HEAD = encode(INFO)


def recorded(path, *pieces, **options):
    """Record what ports give, one after the other; the summary, and what the file says."""
    ports = [ScriptedPort(HEAD, *each) for each in pieces]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hardware.link.scanner.open_port", lambda url, baud: ports.pop(0))
        scanner = Scanner("scripted", **options)
    with scanner:
        n, met = record_scans(scanner, path, 60.0, append=path.exists())
    return n, met, read_recording(path)


def wires(*numbers):
    return [a_wire(number) for number in numbers]


def spoilt(wire):
    return wire[:50] + bytes([wire[50] ^ 1]) + wire[51:]


OTHER = a_wire(5, info=replace(INFO, rows=2))
RECORDED = [  # what ports give, one after the other; scans; what is counted; in words
    (  # 65533 and 65537 never came, 65535 came twice and 65534 damaged
        [[*wires(65530, 65531, 65532), spoilt(a_wire(65534)), *wires(65535, 65535, 65536, 65538, 65539, 65540)]],
        8,
        {"lost": 3, "repeated": 1, "bad_crc": 1},
        ["1 damaged", "1 repeated"],
    ),
    ([[*wires(0, 1), OTHER, HEAD, *wires(2, 3)]], 4, {"foreign": 1}, ["1 of another board"]),
    (  # unplugged after scan 101, back at 150; then reset
        [[*wires(100, 101), PortError("gone")], [*wires(150, 151), *wires(0, 1, 3)]],
        7,
        {"lost": 1, "restarts": 1},
        ["1 restarts", "1 reconnects"],
    ),
]


@pytest.mark.parametrize(("pieces", "scans", "counted", "said"), RECORDED)
def test_what_was_lost_repeated_and_damaged_is_said_and_read_alike(tmp_path, pieces, scans, counted, said):
    n, met, recording = recorded(tmp_path / "a.frames", *pieces)
    assert n == len(recording.sequence) == scans
    assert other_counts(met) == said
    for name in ("lost", "repeated", "restarts", "foreign", "bad_crc", "bad_cobs"):
        assert getattr(met, name) == getattr(recording.statistics, name) == counted.get(name, 0)


def test_scans_that_were_not_taken_in_time_are_lost_and_said(tmp_path):
    n, met, _ = recorded(tmp_path / "a.frames", [b"".join(wires(*range(50)))], queue=4)
    assert n + met.dropped == 50
    assert met.lost == 0  # on the link
    assert any("too slow" in said for said in other_counts(met))


def test_the_rates_of_a_link_are_by_the_hosts_and_the_boards_clock():
    """The host's clock runs 1 % faster than the board's, and every other scan is 2 ms late; the board's wraps."""
    k = np.arange(301)
    times = zip((2**32 - 10**6 + k * 10**6 / 150).round() % 2**32, 7.0 + 1.01 * k / 150 + 2e-3 * (k % 2), strict=True)
    scans = deque(SimpleNamespace(frame=SimpleNamespace(device_us=int(us)), received_s=at_s) for us, at_s in times)
    scanner = SimpleNamespace(stats=LinkStatistics(ok=301), trouble=None, ended=True)
    scanner.get = lambda timeout: scans.popleft() if scans else None
    found = measure_link(scanner, None, 60.0)
    assert (found["scans"], found["statistics"]["ok"], found["latency_ms"]) == (301, 301, None)
    assert found["seconds"] == pytest.approx(2.02)
    assert found["rate_hz"] == pytest.approx(150 / 1.01)
    assert found["device_rate_hz"] == pytest.approx(150, rel=1e-5)  # whole microseconds
    assert found["jitter_us"] == pytest.approx(2000 / np.sqrt(2), rel=1e-2)  # steps scatter by √2 of what arrivals do
    with pytest.raises(ScannerError, match="0 scans within 60 s are too few"):
        measure_link(scanner, None, 60.0)


def test_live_gives_forces_scan_by_scan_from_a_board_or_a_recording(tmp_path):
    """A program of four lines; a recording ends, a board goes on."""
    info = replace(INFO, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4_700)
    ohms = np.broadcast_to([8e3, 11e3, 12e3], (5, 6, 6, 3))
    model = PillarModel(lambda ohms: 1e-3 * ohms[..., :1])  # the z pillar's resistance in kΩ
    path = tmp_path / "press.frames"
    path.write_bytes(recording_from_resistances(ohms, info))
    with live(str(path), model, speed=np.inf) as scans:
        played = list(scans)
    counts = Electronics().crossbar(info).counts(ohms)
    with PythonBoard(counts, info) as board, live(board.port, model) as scans:
        read = list(islice(scans, 5))
        assert scans.scanner.info == info
    for found in [played, read]:
        assert len(found) == 5
        for scan in found:
            assert scan.force_n == pytest.approx(np.full((6, 6, 1), 8.0), rel=5e-3)  # a step of 10 bits
            assert not scan.deviation_n.any()
    assert abs(read[-1].time_s - time.time()) < 60


def test_a_port_that_is_about_to_appear_is_waited_for_and_that_is_said(tmp_path, monkeypatch, caplog):
    """And no other: not a recording's name, not a server's; nor for longer than said but where a board begins."""
    link, looked = tmp_path / "board", []
    monkeypatch.setattr(session, "APPEARS_S", 0.0)
    monkeypatch.setattr(session, "is_beginning", lambda port: port == str(link))
    with PythonBoard(COUNTS, INFO) as board:
        monkeypatch.setattr(
            session.time, "sleep", lambda seconds: looked.append(seconds) or link.symlink_to(board.port)
        )
        with session.connect(f"tripillar+{link}") as (scanner, _):
            assert scanner.info == INFO
    assert [record.message.partition("; there are: ")[0] for record in caplog.records] == [f"{link}: no such port"]
    for port in (str(tmp_path), "missing.frames", "socket://127.0.0.1:9", "", str(tmp_path / "never")):
        session._await(port)
    monkeypatch.setattr(session, "APPEARS_S", 10.0)
    for port in ("missing.frames", "socket://127.0.0.1:9", "", str(tmp_path / "no folder" / "never")):
        session._await(port)
    assert len(looked) == len(caplog.records) == 1


def test_a_board_begins_as_soon_as_its_process_does(tmp_path, monkeypatch):
    """Named from wherever one stands, and no longer than it lives."""
    monkeypatch.chdir(tmp_path)
    words = [sys.executable, "-c", "import time; time.sleep(60)", "board", "--link", "port", "--seconds", "9"]
    with subprocess.Popen(words) as process:
        assert is_beginning("port")
        assert is_beginning(str(tmp_path / "port"))
        assert not is_beginning("other")
        process.kill()
    assert not is_beginning("port")
