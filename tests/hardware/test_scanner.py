"""Ports and the scanner's thread: what opens, what is delivered, when it ends, how it refuses; faults in test_link."""

import errno
import os
import socket
import termios
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import serial

from common.errors import DesignError
from hardware.boards.python_board import PythonBoard
from hardware.link.frames import encode
from hardware.link.protocols import PROTOCOLS
from hardware.link.scanner import Link, Scanner, ScannerError
from hardware.link.serial_ports import PortError, open_port, symlinked
from tests.hardware.boards import COUNTS, INFO, ScriptedPort, a_wire, comes_about
from tests.house import PATIENT_S

HEAD = encode(INFO)


def take(scanner, n):
    scans = [scanner.get(PATIENT_S) for _ in range(n)]
    assert all(scans), scanner.trouble
    return scans


def sequences(scans):
    return [scan.frame.sequence for scan in scans]


@pytest.fixture(autouse=True)
def no_thread_is_left():
    yield
    assert not [thread for thread in threading.enumerate() if thread.name == "scanner"]


# ports


def no_permission(url, **options):
    raise serial.SerialException(errno.EACCES, f"could not open port {url}: Permission denied")


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("missing", "missing: no such port; there are: /dev/ttyUSB0, /dev/ttyUSB1. Plug the board in"),
        ("owned", "no permission: join the group that owns it, as with 'sudo usermod -aG dialout"),
        ("/", "a folder, not a port"),
        ("carrier://pigeon", "protocol 'carrier' not known.*: name a device as /dev/ttyUSB0, or socket://HOST:PORT"),
        ("socket://nowhere", "no connection .*: give socket://HOST:PORT of a running server"),
    ],
)
def test_what_does_not_open_is_told_in_one_line(monkeypatch, url, message):
    listed = [type("Found", (), {"device": f"/dev/ttyUSB{k}"}) for k in (1, 0)]
    monkeypatch.setattr("hardware.link.serial_ports.comports", lambda: listed)
    if url == "owned":  # root may open anything
        monkeypatch.setattr(serial, "serial_for_url", no_permission)
    with pytest.raises(PortError, match=message) as refusal, Scanner(url):
        pass
    assert str(refusal.value).startswith(f"{url}: ")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("fault", [TypeError("fd is None"), termios.error(5, "I/O error"), OSError("read failed")])
def test_whatever_a_broken_port_raises_is_one_error(fault):
    gone = pytest.raises(PortError, match="port: the port is gone")  # given open, it is not opened again
    with Scanner(ScriptedPort(HEAD, fault)) as scanner, gone:
        list(scanner)


def test_a_port_that_takes_nothing_does_not_hold_up_the_reading():
    """4 kB fill a pty that nobody reads; then a write gives up after its timeout."""
    board_end, host_end = os.openpty()
    link = Link(open_port(os.ttyname(host_end)), None, 1.0, PROTOCOLS["tripillar"])
    link.commands.extend([bytes(3000)] * 3)
    os.write(board_end, b"here")
    while link.commands:
        assert link.read() in (b"here", b"h", b"ere", b"")
    link.close()
    os.close(board_end)
    os.close(host_end)


def test_a_server_is_read_in_few_reads_and_asked_once_it_has_spoken():
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection:
                connection.sendall(b"\0")
                assert connection.recv(1) == b"?"
                connection.sendall(HEAD + b"".join(a_wire(k) for k in range(12)))
                connection.recv(1)

        board = threading.Thread(target=serve)
        board.start()
        with Scanner(f"socket://127.0.0.1:{server.getsockname()[1]}") as scanner:
            scans = take(scanner, 12)
            assert sequences(scans) == list(range(12))
            assert len({scan.received_s for scan in scans}) < 8  # pyserial's own would be read byte by byte
        board.join()


def test_a_loop_that_one_joins_in_mid_stream():
    """The first piece of a frame is no damage; nor is the question, which a loop gives back before the frames."""
    port = serial.serial_for_url("loop://", timeout=0.01)
    port.write(a_wire(0)[100:] + HEAD + b"".join(a_wire(k) for k in range(1, 4)))
    with port, Scanner(port) as scanner:
        assert sequences(take(scanner, 3)) == [1, 2, 3]
        assert scanner.stats.bad_crc == scanner.stats.bad_cobs == 0


# the thread


def test_times_are_when_the_board_scanned():
    """In one process both clocks are one: a scan's time is when it was sent, give or take the system's delays."""
    with PythonBoard(COUNTS, INFO) as board, Scanner(board.port) as scanner:
        scans = take(scanner, 60)
        sent, stats = dict(board.sent), scanner.stats
        assert (scanner.info, scanner.trouble) == (INFO, None)
    to_unix_s = time.time() - time.perf_counter()
    sent_s = np.array([sent[scan.frame.sequence] for scan in scans])
    assert (np.array([scan.received_s for scan in scans]) > sent_s).all()
    error_s = np.array([scan.time_s for scan in scans]) - to_unix_s - sent_s
    assert np.median(np.abs(error_s)) < 2e-3
    met = replace(stats, ok=0, info=0, overruns=0, uncounted=False)  # the system may be late
    assert met == type(stats)()  # nothing else was met


@pytest.mark.parametrize("size", [1, 1000])
def test_a_finished_port_ends_the_scans_and_a_slow_reader_gets_the_newest(size):
    stream = HEAD + b"".join(a_wire(k) for k in range(30))
    port = ScriptedPort(*(stream[k : k + size] for k in range(0, len(stream), size)))
    with Scanner(port, queue=8) as scanner:
        comes_about(scanner, lambda: scanner._has_ended)
        assert sequences(scanner) == list(range(22, 30))
        assert scanner.stats.dropped == 22
        assert scanner.get() is None
        assert scanner.ended
    assert port.is_open  # who opened it closes it


class Answering(ScriptedPort):
    """Answers each command by INFO of a rate that it keeps to, 300 Hz at most, or not at all; and no question."""

    is_mute = False

    def write(self, data):
        super().write(data)
        if data[:1] == b"R" and not self.is_mute:
            self.add(encode(replace(INFO, rate_hz=min(int(data[1:]), 300))))


def test_the_rate_is_set_and_one_that_is_refused_leaves_the_one_that_was_wanted():
    port = Answering(HEAD, finite=False)
    with Scanner(port, timeout=2.0) as scanner:  # so long it waits for another answer
        assert (scanner.get(0), scanner.get(0.01)) == (None, None)
        assert scanner.set_rate(200) == scanner.info == INFO
        assert scanner.set_rate(300) == replace(INFO, rate_hz=300)
        with pytest.raises(ScannerError, match="keeps to 300 Hz, not 700 Hz"):
            scanner.set_rate(700)
        with pytest.raises(ScannerError, match="rate_hz=2000 must be a whole number from 1 to 1000"):
            scanner.set_rate(2000)
        port.add(HEAD)  # it has forgotten
        comes_about(scanner, lambda: port.written.count(b"R300\n") >= 2 and scanner.info.rate_hz == 300)  # answered
        port.is_mute = True
        with pytest.raises(ScannerError, match="no answer within 2 s"):
            scanner.set_rate(100)


def test_closing_is_prompt_and_final_and_ends_an_iteration_that_waits():
    """Also of a port that is lost: it does not spin while it waits to open it again."""
    with PythonBoard(COUNTS, replace(INFO, rate_hz=1)) as board:  # hardly ever a byte
        with Scanner(board.port) as scanner:
            closing = threading.Timer(0.01, scanner.close)
            closing.start()
            assert len(list(scanner)) <= 1
            closing.join(PATIENT_S)
        in_use = pytest.raises(PortError, match="in use by another program")
        with Scanner(board.port) as scanner:  # the port is free again, but for once
            with in_use:
                Scanner(board.port)
            board.close()
            comes_about(scanner, lambda: scanner.trouble)
            began_s = time.process_time()
            scanner.close()
            scanner.close()
            assert time.process_time() - began_s < 0.2


def test_what_ends_the_reading_is_raised_after_the_scans_before_it():
    """Also when it is no fault of the port, and again as often as scans are asked for; on leaving if not before."""
    with Scanner(ScriptedPort(HEAD, a_wire(0), KeyError("a bug"))) as scanner:
        assert scanner.get().frame.sequence == 0
        for ask in (scanner.get, lambda: list(scanner)):
            with pytest.raises(KeyError, match="a bug"):
                ask()
    with pytest.raises(KeyError, match="a bug"), Scanner(ScriptedPort(HEAD, KeyError("a bug"))) as scanner:
        scanner._thread.join(PATIENT_S)


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        ([], "nothing received within 0.05 s: is this the board's port"),
        ([b"garbage" * 10], "70 bytes but no valid frame: wrong baud rate[?] 9600 is set"),
        ([a_wire(0), a_wire(1)], "2 frames but no INFO in answer"),
    ],
)
@pytest.mark.parametrize("finite", [True, False], ids=["finite", "silent"])
def test_what_is_no_board_is_refused_in_one_line(pieces, message, finite):
    port = ScriptedPort(*pieces, finite=finite)
    port.written = b"nothing waits for a question here"
    with pytest.raises(ScannerError, match=message) as refusal:
        Scanner(port, timeout=0.05, baud=9600)
    with pytest.raises(ScannerError, match="timeout=0 must be"):
        Scanner(port, timeout=0)
    assert "\n" not in str(refusal.value)


def test_killed_and_started_again(tmp_path):
    """A board dies, leaves its link behind as by kill -9, and another one takes over; a file is replaced by none."""
    first, link = PythonBoard(COUNTS, INFO), tmp_path / "board"
    with symlinked(link, first.port) as port, Scanner(port) as scanner:
        assert scanner.get(PATIENT_S)
        first.close()
        comes_about(scanner, lambda: scanner.trouble)
        assert link.is_symlink()
        with PythonBoard(COUNTS, INFO) as second, symlinked(link, second.port):
            comes_about(scanner, lambda: scanner.stats.reconnects == 1 and not scanner.trouble)
            comes_about(scanner, lambda: scanner.stats.info == 2)
            assert scanner.get(PATIENT_S)
    assert not link.is_symlink()
    link.write_text("mine")
    with pytest.raises(DesignError, match="board exists and is no link"), symlinked(link, "port"):
        pass
    assert link.read_text() == "mine"
