"""The scanner's thread: what it delivers, when it ends, and how it refuses to begin. Faults are `test_link.py`'s."""

import os
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import serial

from hardware.boards.virtual_board import VirtualBoard
from hardware.link.frames import encode
from hardware.link.scanner import Scanner, ScannerError
from hardware.link.serial_ports import PortError, open_port
from tests.hardware.boards import COUNTS, INFO, PATIENT_S, ScriptedPort, a_wire, comes_about

HEAD = encode(INFO)


def take(scanner, n):
    scans = [scanner.get(PATIENT_S) for _ in range(n)]
    assert all(scans), scanner.trouble
    return scans


def sequences(scans):
    return [scan.frame.sequence for scan in scans]


def reading_threads():
    return [thread for thread in threading.enumerate() if thread.name == "scanner"]


def test_times_are_when_the_board_scanned():
    """In one process both clocks are one: a scan's time is when it was sent, give or take the system's delays."""
    with VirtualBoard(COUNTS, INFO) as board, Scanner(board.port) as scanner:
        scans = take(scanner, 60)
        sent, stats = dict(board.sent), scanner.stats
        assert (scanner.info, scanner.trouble) == (INFO, None)
    to_unix_s = time.time() - time.perf_counter()
    sent_s = np.array([sent[scan.frame.sequence] for scan in scans])
    assert (np.array([scan.received_s for scan in scans]) > sent_s).all()
    error_s = np.array([scan.time_s for scan in scans]) - to_unix_s - sent_s
    assert np.median(np.abs(error_s)) < 2e-3
    assert replace(stats, ok=0, info=0, overruns=0) == type(stats)()  # nothing else was met; the system may be late


def test_get_and_latest_wait_for_nothing_that_is_not_there_and_latest_leaves_the_queue():
    port = ScriptedPort(HEAD, finite=False)
    with Scanner(port) as scanner:
        assert (scanner.latest(), scanner.get(0), scanner.get(0.01)) == (None, None, None)
        port.add(*(a_wire(k) for k in range(5)))
        comes_about(scanner, lambda: scanner.stats.ok == 5)
        assert scanner.latest().frame.sequence == 4
        assert sequences(take(scanner, 5)) == [0, 1, 2, 3, 4]


def test_a_slow_reader_gets_the_newest_and_the_count_of_the_others():
    with Scanner(ScriptedPort(HEAD, *(a_wire(k) for k in range(30))), queue=8) as scanner:
        comes_about(scanner, lambda: scanner.stats.ok == 30)
        assert sequences(scanner) == list(range(22, 30))
        assert scanner.stats.dropped == scanner.dropped == 22


@pytest.mark.parametrize("size", [1, 232, 1000])
def test_a_finished_port_ends_the_scans_after_the_last_one(size):
    stream = HEAD + b"".join(a_wire(k) for k in range(20))
    port = ScriptedPort(*(stream[k : k + size] for k in range(0, len(stream), size)))
    with Scanner(port) as scanner:
        assert sequences(scanner) == list(range(20))
        assert scanner.get() is None
        assert scanner.ended
    assert port.is_open  # who opened it closes it
    assert not reading_threads()


class Answering(ScriptedPort):
    """Answers each command by INFO of a rate that it keeps to, 300 Hz at most; and no question."""

    def write(self, data):
        super().write(data)
        if data[:1] == b"R":
            self.add(encode(replace(INFO, rate_hz=min(int(data[1:]), 300))))


def test_the_rate_is_set_and_one_that_is_refused_leaves_the_one_that_was_wanted():
    port = Answering(HEAD, finite=False)
    with Scanner(port, timeout=0.3) as scanner:
        assert scanner.set_rate(200) == scanner.info == INFO
        assert scanner.set_rate(300) == replace(INFO, rate_hz=300)
        with pytest.raises(ScannerError, match="keeps to 300 Hz, not 700 Hz"):
            scanner.set_rate(700)
        with pytest.raises(ScannerError, match="rate_hz=2000 must be a whole number from 1 to 1000"):
            scanner.set_rate(2000)
        port.add(HEAD)  # it has forgotten
        comes_about(scanner, lambda: port.written.count(b"R300\n") == 2)
        scanner._timeout_s = 0.02
        with pytest.raises(ScannerError, match=r"no answer to b'\?' within 0.02 s"):
            scanner.request(b"?")


def test_closing_is_prompt_and_final_and_ends_an_iteration_that_waits():
    with VirtualBoard(COUNTS, replace(INFO, rate_hz=1)) as board:  # hardly ever a byte that would wake the reader
        with Scanner(board.port) as scanner:
            closing = threading.Timer(0.01, scanner.close)
            closing.start()
            assert len(list(scanner)) <= 1
            closing.join(PATIENT_S)
            scanner.close()
        assert not reading_threads()
        in_use = pytest.raises(PortError, match="in use by another program")
        with Scanner(board.port), in_use, Scanner(board.port):  # the port is free again, but for once
            pass
        with pytest.raises(ScannerError, match="used already"), scanner:
            pass


def test_closed_while_disconnected(tmp_path):
    with VirtualBoard(COUNTS, INFO, link=tmp_path / "board") as board, Scanner(board.port) as scanner:
        board.close()
        comes_about(scanner, lambda: scanner.trouble)
        began_s = time.process_time()
        scanner.close()
        assert time.process_time() - began_s < 0.2
    assert not reading_threads()


def test_what_ends_the_reading_is_raised_after_the_scans_before_it():
    """Also when it is no fault of the port, and again as often as scans are asked for; on leaving if not before."""
    with Scanner(ScriptedPort(HEAD, a_wire(0), KeyError("a bug"))) as scanner:
        assert scanner.get().frame.sequence == 0
        for ask in (scanner.get, scanner.latest, lambda: list(scanner)):
            with pytest.raises(KeyError, match="a bug"):
                ask()
    with pytest.raises(KeyError, match="a bug"), Scanner(ScriptedPort(HEAD, KeyError("a bug"))) as scanner:
        scanner._thread.join(PATIENT_S)
    assert not reading_threads()


@pytest.mark.parametrize("reconnect", [False, True])
def test_a_port_that_has_gone_and_is_not_opened_again(tmp_path, reconnect):
    """By will, or because it was given open."""
    with VirtualBoard(COUNTS, INFO, link=tmp_path / "board") as board:
        port = open_port(board.port) if reconnect else board.port
        with Scanner(port, reconnect=reconnect) as scanner:
            assert scanner.get(PATIENT_S)
            board.close()
            with pytest.raises(PortError, match=r"(port|board): the port is gone"):
                list(scanner)


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        ([], "nothing received within 0.1 s: is this the board's port"),
        ([b"garbage" * 10], "70 bytes but no valid frame: wrong baud rate[?] 9600 is set"),
        ([bytes(50)], "50 bytes but no valid frame: wrong baud rate"),
        ([a_wire(0), a_wire(1)], "2 frames but no INFO in answer"),
    ],
    ids=["nothing", "garbage", "zeros", "no INFO"],
)
@pytest.mark.parametrize("finite", [True, False], ids=["finite", "silent"])
def test_what_is_no_board_is_refused_in_one_line(pieces, message, finite):
    port = ScriptedPort(*pieces, finite=finite)
    port.written = b"nothing waits for a question here"
    with pytest.raises(ScannerError, match=message) as refusal, Scanner(port, timeout=0.1, baud=9600):
        pass
    assert "\n" not in str(refusal.value)
    assert not reading_threads()


def test_settings_that_make_no_sense_and_a_scanner_that_was_not_entered():
    with pytest.raises(ScannerError, match="queue=0 must be 1 or more"):
        Scanner("loop://", queue=0)
    with pytest.raises(ScannerError, match="timeout=0 must be above 0"):
        Scanner("loop://", timeout=0)
    with pytest.raises(PortError, match="no such port"), Scanner("/dev/no-such-port"):
        pass
    for ask in (Scanner.get, lambda scanner: scanner.set_rate(1), lambda scanner: scanner.info):
        with pytest.raises(ScannerError, match="enter"):
            ask(Scanner("loop://"))


def test_a_server_that_goes_and_comes_back():
    """A board on the network: two connections one after the other, each asked once it has spoken."""
    goes, is_done = threading.Event(), threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve(first, end):
            connection, _ = server.accept()
            with connection:
                connection.sendall(b"\0")
                assert connection.recv(1) == b"?"
                connection.sendall(HEAD + a_wire(first) + a_wire(first + 1))
                end.wait(PATIENT_S)

        board = threading.Thread(target=lambda: [serve(0, goes), serve(2, is_done)])
        board.start()
        with Scanner(f"socket://127.0.0.1:{server.getsockname()[1]}") as scanner:
            assert sequences(take(scanner, 2)) == [0, 1]
            goes.set()
            assert sequences(take(scanner, 2)) == [2, 3]
            assert scanner.stats.reconnects == 1
        is_done.set()
        board.join()


def test_killed_and_started_again(tmp_path):
    """A board's process dies at once, leaves its link behind, and another one takes over."""
    program = (
        "import sys\nfrom hardware.boards.virtual_board import VirtualBoard\n"
        "from tests.hardware.boards import COUNTS, INFO\n"
        "VirtualBoard(COUNTS, INFO, link=sys.argv[1]); print('ready', flush=True); sys.stdin.read()"
    )
    link, root = tmp_path / "board", Path(__file__).parents[2]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", program, link], cwd=root, **pipes) as first:
        assert first.stdout.readline() == "ready\n"
        with Scanner(str(link)) as scanner:
            assert scanner.get(PATIENT_S)
            first.kill()
            comes_about(scanner, lambda: scanner.trouble)
            with VirtualBoard(COUNTS, INFO, link=link):
                comes_about(scanner, lambda: scanner.stats.reconnects == 1 and not scanner.trouble)
                comes_about(scanner, lambda: scanner.stats.info == 2)
                assert scanner.get(PATIENT_S)


def test_a_port_that_one_joins_in_mid_stream_and_a_loop():
    """The first piece of a frame is no damage; nor is the question, which a loop gives back before the frames."""
    board_end, host_end = os.openpty()
    try:
        with serial.serial_for_url(os.ttyname(host_end), timeout=0.05) as port:
            os.write(board_end, a_wire(0)[100:] + HEAD + a_wire(1))
            with Scanner(port) as scanner:
                assert sequences(take(scanner, 1)) == [1]
                assert scanner.stats.bad_crc == scanner.stats.bad_cobs == 0
    finally:
        os.close(board_end)
        os.close(host_end)
    port = serial.serial_for_url("loop://", timeout=0.01)
    threading.Timer(0.05, port.write, [b"\0" + HEAD + b"".join(a_wire(k) for k in range(3))]).start()
    with port, Scanner(port) as scanner:
        assert sequences(take(scanner, 3)) == [0, 1, 2]
