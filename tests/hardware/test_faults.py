"""A table of faults: each has one outcome, is counted, and scans come again within a second of its end."""

import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.boards.virtual_board import VirtualBoard
from hardware.link.frames import encode
from hardware.link.scanner import Scanner, ScannerError
from hardware.link.serial_ports import PortError, open_port
from tests.hardware.boards import COUNTS, INFO, PATIENT_S, ScriptedPort, a_wire, closes_within, wait_until
from tests.hardware.faulty_board import FaultyBoard

ROOT = Path(__file__).parents[2]
RESUMES_S = 1.0
TIMEOUT_S = 1.0  # of those scanners that are to notice a stall; 4 s by default
FOR_EVER = 3600  # seconds, or frames, until a test ends them


@pytest.fixture
def link(tmp_path):
    return tmp_path / "board"


@pytest.fixture
def board(link):
    with FaultyBoard(COUNTS, INFO, link=link) as board:
        yield board


@pytest.fixture
def scanner(board):
    with Scanner(board.port) as scanner:
        assert scanner.get(PATIENT_S)
        yield scanner


@pytest.fixture
def impatient(board):
    with Scanner(board.port, timeout=TIMEOUT_S) as scanner:
        assert scanner.get(PATIENT_S)
        yield scanner


def drain(scanner):
    while scanner.get(0):
        pass


def assert_resumes(scanner):
    """Scans come that were sent from now on."""
    drain(scanner)
    start_s = time.perf_counter()
    wait_until(lambda: (scan := scanner.get(0)) and scan.received_s >= start_s, RESUMES_S)
    assert scanner.trouble is None


def test_unplugged_and_replugged_again_and_again(board, scanner):
    for k in range(1, 4):
        board.unplug()
        wait_until(lambda: scanner.trouble)
        assert scanner.trouble.startswith("disconnected, trying again: ")
        drain(scanner)
        assert scanner.get(0.3 if k == 1 else 0.0) is None  # some attempts that fail
        board.replug()
        assert_resumes(scanner)
        assert scanner.stats.reconnects == k


@pytest.mark.parametrize("is_open", [False, True], ids=["no reconnecting", "an open port that was given"])
def test_a_port_that_may_not_be_opened_again_is_gone(board, is_open):
    port = open_port(board.port) if is_open else board.port
    with Scanner(port, reconnect=is_open) as scanner:
        assert scanner.get(PATIENT_S)
        board.unplug()
        with pytest.raises(PortError, match="the port is gone"):
            list(scanner)
    if is_open:
        port.close()


def test_closed_while_disconnected(board, scanner):
    board.unplug()
    wait_until(lambda: scanner.trouble)
    closes_within(scanner, 0.2)


def test_killed_and_started_again(link):
    """A board's process dies at once, leaves its link behind, and another one, of newer firmware, takes over."""
    program = (
        "import sys\nfrom hardware.boards.virtual_board import VirtualBoard\n"
        "from tests.hardware.boards import COUNTS, INFO\n"
        "VirtualBoard(COUNTS, INFO, link=sys.argv[1]); print('ready', flush=True); sys.stdin.read()"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", program, link], cwd=ROOT, **pipes) as first:
        assert first.stdout.readline() == "ready\n"
        with Scanner(str(link)) as scanner:
            assert scanner.get(PATIENT_S)
            first.kill()
            wait_until(lambda: scanner.trouble)
            with VirtualBoard(COUNTS, replace(INFO, firmware=(2, 0, 0)), link=link):
                assert_resumes(scanner)
                assert scanner.info.firmware == (2, 0, 0)
                assert scanner.stats.reconnects == 1
                assert scanner.stats.foreign == 0


def test_a_server_that_goes_and_comes_back():
    """As of a board on the network: two connections one after the other."""
    goes, is_done = threading.Event(), threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve(first, end):
            connection, _ = server.accept()
            with connection:
                connection.sendall(b"\0")  # a board that runs is asked at once
                connection.recv(1)
                connection.sendall(encode(INFO) + a_wire(first) + a_wire(first + 1))
                end.wait(PATIENT_S)

        board = threading.Thread(target=lambda: [serve(0, goes), serve(2, is_done)])
        board.start()
        with Scanner(f"socket://127.0.0.1:{server.getsockname()[1]}") as scanner:
            assert [scanner.get(PATIENT_S).frame.sequence for _ in range(2)] == [0, 1]
            goes.set()
            assert [scanner.get(PATIENT_S).frame.sequence for _ in range(2)] == [2, 3]
            assert scanner.stats.reconnects == 1
        is_done.set()
        board.join()


def test_restarted_in_mid_stream(board, scanner):
    drain(scanner)
    scanner.get(PATIENT_S)
    board.restart()
    wait_until(lambda: scanner.stats.restarts)
    assert_resumes(scanner)
    stats = scanner.stats
    assert (stats.restarts, stats.reconnects) == (1, 0)
    assert stats.lost == 0  # a step back is no loss


def test_a_restarted_board_is_asked_again_and_its_clock_fitted_anew():
    """After 1000 s on its own clock it starts at 0, and at another rate; its scans are of now, all the same."""
    port = ScriptedPort(encode(INFO), a_wire(0, device_us=10**9), a_wire(0), finite=False)
    with Scanner(port) as scanner:
        wait_until(lambda: port.written.startswith(b"??"))
        port.pieces.append(encode(replace(INFO, rate_hz=50)))
        wait_until(lambda: scanner.info.rate_hz == 50)
        times = [scanner.get().time_s, scanner.get().time_s]
    assert times == pytest.approx([time.time()] * 2, abs=60)  # no system halts for so long


def test_stalled(board, impatient):
    scanner = impatient
    board.stall()
    wait_until(lambda: scanner.trouble)
    assert scanner.trouble == f"no frames for {TIMEOUT_S:.1f} s"
    drain(scanner)
    assert scanner.get(0.1) is None
    board.stall(False)
    wait_until(lambda: scanner.trouble is None)
    assert_resumes(scanner)
    assert (scanner.stats.stalls, scanner.stats.reconnects, scanner.stats.lost) == (1, 0, 0)
    assert scanner.stats.overruns > 0  # what the board missed, modulo 256


def test_a_host_that_hangs_costs_what_the_buffers_do_not_hold(board):
    """The system's buffer overflows; frames are lost and counted, the damaged one at the seam too."""

    class Hanging:
        def __init__(self, port):
            self.port = port
            self.hangs = False

        @property
        def in_waiting(self):
            wait_until(lambda: not self.hangs)
            return self.port.in_waiting

        def __getattr__(self, name):
            return getattr(self.port, name)

    port = Hanging(open_port(board.port))
    with Scanner(port) as scanner:
        scanner.get(PATIENT_S)
        port.hangs = True
        wait_until(lambda: board.dropped_bytes > 1000)
        port.hangs = False
        wait_until(lambda: scanner.stats.lost)
        assert_resumes(scanner)
        assert scanner.stats.lost >= 1000 // 232
    port.close()


def test_a_reader_slower_than_the_board(board):
    with Scanner(board.port, queue=5) as scanner:
        wait_until(lambda: scanner.stats.dropped >= 20)
        board.stall()  # what it has sent has come
        sent, _ = board.sent[-1]
        wait_until(lambda: scanner.latest().frame.sequence == sent)
        assert sent - scanner.get().frame.sequence < 5  # the oldest were dropped, not the newest
        board.stall(False)
        assert_resumes(scanner)


def test_the_port_is_in_use(board, scanner):
    with pytest.raises(PortError, match="in use by another program"), Scanner(board.port):
        pass
    assert_resumes(scanner)


def test_the_port_is_in_use_when_it_comes_back(board):
    """Another program was quicker: the scanner waits for it to close."""
    hindrances = []

    def opener(url, **options):
        if hindrances:
            raise PortError(f"{url}: {hindrances[-1]}")
        return open_port(url, **options)

    with Scanner(board.port, opener=opener) as scanner:
        hindrances.append("in use by another program")
        board.unplug()
        board.replug()
        wait_until(lambda: scanner.trouble)
        hindrances.clear()
        assert_resumes(scanner)


def test_a_wrong_baud_rate(board):
    """Bits read at another pace are as good as random."""
    board.garble(np.random.default_rng(0).bytes(100), n_frames=10_000)
    message = r"\d+ bytes but no valid frame: wrong baud rate\? 9600 is set"
    with pytest.raises(ScannerError, match=message), Scanner(board.port, timeout=TIMEOUT_S, baud=9600):
        pass


@pytest.mark.parametrize(
    "garbage", [b"\xff" * 400, bytes(400), b"\x05ab\0", b"\x07DDDDD\0"], ids=["ones", "zeros", "cobs", "crc"]
)
def test_bursts_of_garbage(board, scanner, garbage):
    board.garble(garbage, n_frames=10)
    wait_until(lambda: scanner.stats.lost >= 10)
    assert_resumes(scanner)
    stats = scanner.stats
    assert stats.lost in (10, 11)  # garbage without an end takes the next frame along
    if any(garbage):
        assert stats.bad_cobs + stats.bad_crc + stats.bad_form >= 1
    assert (stats.restarts, stats.reconnects, stats.foreign) == (0, 0, 0)


def test_random_garbage_for_longer_than_the_timeout_is_a_stall(board, impatient):
    scanner = impatient
    board.garble(np.random.default_rng(1).bytes(232), n_frames=FOR_EVER * INFO.rate_hz)
    wait_until(lambda: scanner.trouble)
    assert scanner.trouble.startswith("no frames for")
    board.do(board.frames.garbage.clear)
    wait_until(lambda: scanner.trouble is None)
    assert_resumes(scanner)
    assert scanner.stats.stalls == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"serial": 7}, "another device answers, serial 7 instead of 3"),
        ({"rows": 2, "cols": 3}, "another device answers, rows 2 instead of 6, cols 3 instead of 6"),
        ({"bits": 12}, "another device answers, bits 12 instead of 10"),
        ({"sense_ohm": 4700}, "another device answers, sense_ohm 4700 instead of 10000"),
    ],
    ids=["serial", "size", "bits", "sense_ohm"],
)
def test_another_device_is_plugged_in(board, scanner, change, message):
    """None of its scans is delivered once it has said who it is; the first one's are, when that is back."""
    board.unplug()
    wait_until(lambda: scanner.trouble)
    drain(scanner)
    board.impostor(replace(INFO, **change))
    board.replug()
    wait_until(lambda: scanner.stats.foreign > 10)
    assert scanner.get(0) is None
    assert scanner.trouble.startswith(message)
    board.impostor(None)
    assert_resumes(scanner)
    assert scanner.info == INFO
    assert scanner.stats.reconnects == 1


def test_another_device_without_unplugging(board, scanner):
    """As behind a socket. Frames of another size tell at once, before any INFO."""
    board.impostor(replace(INFO, rows=2, cols=3))
    wait_until(lambda: scanner.stats.foreign > 10)
    assert all(scan.frame.counts.size == 108 for scan in iter(lambda: scanner.get(0), None))
    board.impostor(None)
    assert_resumes(scanner)


def test_a_mute_board_after_reconnecting_is_trouble(board):
    """Frames without INFO may be anybody's."""
    first = ScriptedPort(encode(INFO), a_wire(0), PortError("gone"))
    ports = [first, ScriptedPort(a_wire(1), a_wire(2), finite=False)]
    with Scanner("scripted", opener=lambda url, **options: ports.pop(0)) as scanner:
        assert scanner.get(PATIENT_S).frame.sequence == 0
        wait_until(lambda: scanner.stats.ok == 3)
        assert not first.is_open
        assert scanner.trouble.startswith("frames but no INFO")
        assert scanner.get(0) is None
        assert scanner.stats.reconnects == 1
