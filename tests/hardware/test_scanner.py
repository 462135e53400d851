"""The scanner on boards that do as they should: what it delivers, when it ends, and how it refuses to begin."""

import os
import socket
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import serial

from hardware.link.frames import ScanMode, encode
from hardware.link.scanner import Scanner, ScannerError
from hardware.link.serial_ports import PortError
from tests.hardware.boards import COUNTS, INFO, PATIENT_S, ScriptedPort, a_wire, closes_within, wait_until
from tests.hardware.faulty_board import FaultyBoard


def take(scanner, n):
    scans = []
    while len(scans) < n:
        scan = scanner.get(PATIENT_S)
        assert scan, scanner.trouble
        scans.append(scan)
    return scans


def reading_threads():
    return [thread for thread in threading.enumerate() if thread.name == "scanner"]


def test_scans_come_in_order_with_their_counts():
    with FaultyBoard(COUNTS, INFO) as board, Scanner(board.port) as scanner:
        assert scanner.info == INFO
        scans = take(scanner, 50)
        assert scanner.trouble is None
        stats = scanner.stats
    first = scans[0].frame.sequence
    assert [scan.frame.sequence for scan in scans] == list(range(first, first + 50))
    frames = [scan.frame for scan in scans]
    assert all((frame.counts == COUNTS[(frame.sequence + frame.overruns) % 50]).all() for frame in frames)
    assert stats.ok >= 50
    assert replace(stats, ok=0, info=0, overruns=0) == type(stats)()  # nothing else was met; the system may be late


def test_times_are_when_the_board_scanned():
    """In one process both clocks are one: a scan's time is when it was sent, give or take the system's delays."""
    with FaultyBoard(COUNTS, INFO) as board, Scanner(board.port) as scanner:
        scans = take(scanner, 100)
        sent = dict(board.sent)
    to_unix_s = time.time() - time.perf_counter()
    sent_s = np.array([sent[scan.frame.sequence] for scan in scans])
    assert (np.array([scan.received_s for scan in scans]) > sent_s).all()
    error_s = np.array([scan.time_s for scan in scans]) - to_unix_s - sent_s
    assert np.median(np.abs(error_s)) < 2e-3


def test_latest_and_get_do_not_wait_for_what_is_not_there():
    with Scanner(ScriptedPort(encode(INFO), finite=False)) as scanner:
        assert scanner.latest() is None
        assert scanner.get(0) is None
        assert scanner.get(0.01) is None


def test_latest_leaves_the_queue_alone():
    with Scanner(ScriptedPort(encode(INFO), *(a_wire(k) for k in range(5)))) as scanner:
        wait_until(lambda: scanner.stats.ok == 5)
        assert scanner.latest().frame.sequence == 4
        assert [scan.frame.sequence for scan in scanner] == [0, 1, 2, 3, 4]


def test_a_slow_reader_gets_the_newest_and_the_count_of_the_others():
    with Scanner(ScriptedPort(encode(INFO), *(a_wire(k) for k in range(30))), queue=8) as scanner:
        wait_until(lambda: scanner.stats.ok == 30)
        assert [scan.frame.sequence for scan in scanner] == list(range(22, 30))
        assert scanner.stats.dropped == 22


@pytest.mark.parametrize("size", [1, 7, 232, 1000])
def test_a_finite_port_ends_the_scans_after_the_last_one(size):
    stream = encode(INFO) + b"".join(a_wire(k) for k in range(20))
    pieces = [stream[k : k + size] for k in range(0, len(stream), size)]
    port = ScriptedPort(*pieces)
    with Scanner(port) as scanner:
        assert [scan.frame.sequence for scan in scanner] == list(range(20))
        assert scanner.get() is None
    assert port.is_open  # who opened it closes it
    assert not reading_threads()


def test_frames_before_the_info_mean_nothing_yet():
    with Scanner(ScriptedPort(a_wire(0), a_wire(1), encode(INFO), a_wire(2))) as scanner:
        assert [scan.frame.sequence for scan in scanner] == [2]
        assert scanner.stats.ok == 3


def test_overruns_are_counted_through_their_wrap():
    wires = [a_wire(k, overruns=overruns) for k, overruns in enumerate([250, 254, 1, 1])]
    with Scanner(ScriptedPort(encode(INFO), *wires)) as scanner:
        assert len(list(scanner)) == 4
        assert scanner.stats.overruns == 7  # since the first


def test_the_rate_is_set_and_told():
    with FaultyBoard(COUNTS, INFO) as board, Scanner(board.port) as scanner:
        assert scanner.set_rate(500) == scanner.info == replace(INFO, rate_hz=500)
        assert scanner.request(b"?") == scanner.info
        with pytest.raises(ScannerError, match="rate_hz=2000 must be a whole number from 1 to 1000"):
            scanner.set_rate(2000)


def test_a_reset_board_is_asked_for_its_rate_again():
    with FaultyBoard(COUNTS, INFO) as board, Scanner(board.port) as scanner:
        scanner.set_rate(500)
        for n_restarts in (1, 2):
            board.restart()
            wait_until(lambda n=n_restarts: scanner.stats.restarts == n)
            wait_until(lambda: scanner.info.rate_hz == INFO.rate_hz)
            wait_until(lambda: scanner.info.rate_hz == 500)


def test_a_board_that_comes_back_is_asked_for_its_rate_again(tmp_path):
    with FaultyBoard(COUNTS, INFO, link=tmp_path / "board") as board, Scanner(board.port) as scanner:
        scanner.set_rate(500)
        board.unplug()
        wait_until(lambda: scanner.trouble)
        board.restart()
        board.replug()
        wait_until(lambda: scanner.stats.reconnects and scanner.info.rate_hz == INFO.rate_hz)
        wait_until(lambda: scanner.info.rate_hz == 500)


class HoldsUpTo300Hz(ScriptedPort):
    """Answers to commands, but to no question."""

    def write(self, data):
        super().write(data)
        if data[:1] == b"R":
            self.pieces.append(encode(replace(INFO, rate_hz=300)))


def test_the_rate_is_asked_for_again_only_once_the_board_is_known():
    port = HoldsUpTo300Hz(encode(INFO), finite=False)
    with Scanner(port) as scanner:
        scanner.set_rate(300)
        n_written = len(port.written)
        port.pieces.extend([a_wire(100), a_wire(0)])  # a restart
        wait_until(lambda: b"?" in port.written[n_written:])
        assert b"R" not in port.written[n_written:]
        port.pieces.append(encode(INFO))
        wait_until(lambda: port.written.endswith(b"R300\n"))


def test_a_rate_that_is_refused_leaves_the_one_that_was_wanted():
    port = HoldsUpTo300Hz(encode(INFO), finite=False)
    with Scanner(port, timeout=0.5) as scanner:
        scanner.set_rate(300)
        with pytest.raises(ScannerError, match="keeps to 300 Hz, not 700 Hz"):
            scanner.set_rate(700)
        port.pieces.append(encode(INFO))  # it has forgotten
        wait_until(lambda: port.written.endswith(b"R300\n"))


def test_a_board_that_keeps_its_rate_is_told_of():
    class Stubborn(ScriptedPort):
        def write(self, data):
            super().write(data)
            self.pieces.append(encode(INFO))

    refused = pytest.raises(ScannerError, match="the board keeps to 200 Hz, not 300 Hz")
    with Scanner(Stubborn(finite=False), timeout=0.5) as scanner, refused:
        scanner.set_rate(300)


def test_no_answer_to_a_request():
    refused = pytest.raises(ScannerError, match=r"no answer to b'\?' within 0.05 s")
    with Scanner(ScriptedPort(encode(INFO), finite=False)) as scanner, refused:
        scanner._timeout_s = 0.05
        scanner.request(b"?")


def test_closing_is_prompt_and_final():
    with FaultyBoard(COUNTS, replace(INFO, rate_hz=1)) as board:  # hardly ever a byte that would wake the reader
        with Scanner(board.port) as scanner:
            closes_within(scanner, 0.2)
            scanner.close()
            assert list(scanner) in ([], [scanner.latest()])
        assert not reading_threads()
        with Scanner(board.port):  # the port is free again
            pass
        with pytest.raises(ScannerError, match="used already"), scanner:
            pass


def test_closing_ends_an_iteration_that_waits():
    with Scanner(ScriptedPort(encode(INFO), finite=False)) as scanner:
        threading.Timer(0.05, scanner.close).start()
        assert list(scanner) == []


def test_what_ends_the_reading_is_raised_after_the_scans_before_it():
    """Also when it is no fault of the port, and again as often as scans are asked for."""
    with Scanner(ScriptedPort(encode(INFO), a_wire(0), KeyError("a bug"))) as scanner:
        assert scanner.get().frame.sequence == 0
        for ask in (scanner.get, scanner.latest, lambda: list(scanner)):
            with pytest.raises(KeyError, match="a bug"):
                ask()


def test_what_ends_the_reading_is_raised_on_leaving_if_not_before():
    with pytest.raises(KeyError, match="a bug"), Scanner(ScriptedPort(encode(INFO), KeyError("a bug"))) as scanner:
        wait_until(lambda: not scanner._thread.is_alive())
    assert not reading_threads()


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        ([], "nothing received within 0.5 s: is this the board's port"),
        ([b"garbage" * 10], "70 bytes but no valid frame: wrong baud rate"),
        ([bytes(50)], "50 bytes but no valid frame: wrong baud rate"),
        ([a_wire(0), a_wire(1)], "2 frames but no INFO in answer"),
    ],
    ids=["nothing", "garbage", "zeros", "no INFO"],
)
@pytest.mark.parametrize("finite", [True, False], ids=["finite", "silent"])
def test_what_is_no_board_is_refused_in_one_line(pieces, message, finite):
    with (
        pytest.raises(ScannerError, match=message) as refusal,
        Scanner(ScriptedPort(*pieces, finite=finite), timeout=0.5),
    ):
        pass
    assert "\n" not in str(refusal.value)
    assert not reading_threads()


def test_the_question_is_repeated():
    """As a board needs it that is still starting: four times a second, no more often."""
    port = Booting(swallows=3)
    with Scanner(port, timeout=PATIENT_S):
        pass
    assert [question for question, _ in port.writes] == [b"?"] * 4
    assert (np.diff([asked_s for _, asked_s in port.writes]) >= 0.25).all()


class Booting:
    """A port to a board that swallows so many questions, as a boot loader does, or at first says a byte, if none."""

    in_waiting = 0

    def __init__(self, swallows):
        self.swallows = swallows
        self.writes = []  # (data, time)
        self.to_read = [] if swallows else [b"\0"]

    def read(self, size):
        if self.to_read:
            return self.to_read.pop(0)
        time.sleep(0.002)
        return b""

    def write(self, data):
        self.writes.append((data, time.perf_counter()))
        if len(self.writes) > self.swallows:
            self.to_read.append(encode(INFO))


def test_a_board_is_asked_as_soon_as_it_has_spoken(monkeypatch):
    monkeypatch.setattr("hardware.link.link.LISTEN_S", 3600)
    port = Booting(swallows=0)
    with Scanner(port, timeout=PATIENT_S):
        pass
    assert port.writes[0][0] == b"?"


def test_a_boot_loader_may_swallow_questions_for_two_seconds():
    """With the default timeout: an Arduino resets when its port is opened."""
    start_s = time.perf_counter()
    port = Booting(swallows=6)  # 0.5 s and six quarters of a second
    with Scanner(port):
        pass
    assert port.writes[0][1] - start_s >= 0.5  # it is left alone first


def test_a_port_that_does_not_open():
    with pytest.raises(PortError, match="no such port"), Scanner("/dev/no-such-port"):
        pass


def test_settings_that_make_no_sense():
    with pytest.raises(ScannerError, match="queue=0 must be 1 or more"):
        Scanner("loop://", queue=0)
    with pytest.raises(ScannerError, match="timeout=0 must be above 0"):
        Scanner("loop://", timeout=0)


@pytest.mark.parametrize("ask", [Scanner.get, Scanner.set_rate, lambda scanner, _: scanner.info])
def test_a_scanner_is_to_be_entered(ask):
    with pytest.raises(ScannerError, match="enter"):
        ask(Scanner("loop://"), 1)


def test_a_board_on_a_socket():
    """A server of frames, as on the network; it answers as any board."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection:
                assert connection.recv(1) == b"?"
                connection.sendall(encode(INFO) + b"".join(a_wire(k) for k in range(100)))
                connection.recv(1)  # until the scanner closes

        board = threading.Thread(target=serve)
        board.start()
        with Scanner(f"socket://127.0.0.1:{server.getsockname()[1]}") as scanner:
            assert [scan.frame.sequence for scan in take(scanner, 100)] == list(range(100))
        board.join()


def test_a_loop():
    """What is written comes back: the question too, before the frames, and costs what it runs into: nothing."""
    port = serial.serial_for_url("loop://", timeout=0.01)
    threading.Timer(0.05, port.write, [b"\0" + encode(INFO) + b"".join(a_wire(k) for k in range(3))]).start()
    with port, Scanner(port) as scanner:
        assert [scan.frame.sequence for scan in take(scanner, 3)] == [0, 1, 2]


def test_any_array_and_any_scan_mode():
    info = replace(INFO, rows=2, cols=3, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL)
    with FaultyBoard(np.arange(18), info) as board, Scanner(board.port) as scanner:
        assert take(scanner, 1)[0].frame.counts.tolist() == list(range(18))


def test_a_port_that_one_joins_in_mid_stream():
    """The first piece of a frame is no damage."""
    board_end, host_end = os.openpty()
    try:
        with serial.serial_for_url(os.ttyname(host_end), timeout=0.05) as port:
            os.write(board_end, a_wire(0)[100:] + encode(INFO) + a_wire(1))
            with Scanner(port) as scanner:
                assert take(scanner, 1)[0].frame.sequence == 1
                assert scanner.stats.bad_crc == scanner.stats.bad_cobs == 0
    finally:
        os.close(board_end)
        os.close(host_end)
