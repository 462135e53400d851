"""Whether the board has restarted, told by both clocks, and that nothing is counted lost over it."""

import time
from dataclasses import replace

import pytest

from hardware.link.frames import FrameDecoder, encode
from hardware.link.reception import Reception
from tests.hardware.boards import INFO, a_wire

SCANS = 5 * INFO.rate_hz  # 5 s of them
FAR = 60_000  # a sequence number from which 0 seems to be a step forward
NOW_S = 1000.0  # by the host


def wires(first, n, *, uptime_s=0.0):
    """Frames of consecutive numbers, the first at an uptime."""
    start_us = round(uptime_s * 1e6)
    return [
        a_wire(first + k, device_us=(start_us + k * 1_000_000 // INFO.rate_hz) % 2**32, overruns=7) for k in range(n)
    ]


def arrivals(start_s, n):
    return [start_s + k / INFO.rate_hz for k in range(n)]


def feed(reception, sent, received_s):
    return [scan for wire, at_s in zip(sent, received_s, strict=True) for scan in reception.take(wire, at_s)]


@pytest.fixture
def reception():
    reception = Reception()
    reception.take(encode(INFO), NOW_S)
    return reception


UPTIMES_MIN = [20, 40, 60, 71]


@pytest.mark.parametrize("uptime_min", UPTIMES_MIN)
@pytest.mark.parametrize("boot_s", [0.1, 2.0])
def test_a_reset_after_any_uptime_is_a_restart(reception, uptime_min, boot_s):
    """From 35.8 min on, the clock seems to go forward, here together with the sequence."""
    feed(reception, wires(FAR, SCANS, uptime_s=60 * uptime_min), arrivals(NOW_S, SCANS))
    restarted_s = NOW_S + 5 + boot_s
    reception_s = time.time() - time.perf_counter()
    scans = feed(reception, wires(0, SCANS), arrivals(restarted_s, SCANS))
    assert (reception.statistics.restarts, reception.statistics.lost) == (1, 0)
    assert reception.statistics.overruns == 7  # since the restart: the first ones came before the first frame
    assert reception.asks
    times_s = [scan.time_s - reception_s for scan in scans]
    assert times_s == pytest.approx(arrivals(restarted_s, SCANS), abs=0.01)  # no fit over both runs


@pytest.mark.parametrize("uptime_min", UPTIMES_MIN)
def test_a_reset_while_the_board_was_unplugged_is_a_restart(reception, uptime_min):
    feed(reception, wires(FAR, SCANS, uptime_s=60 * uptime_min), arrivals(NOW_S, SCANS))
    reception.connected()
    feed(reception, wires(0, SCANS), arrivals(NOW_S + 20, SCANS))
    assert (reception.statistics.restarts, reception.statistics.lost) == (1, 0)


def test_a_reset_during_a_stall_is_a_restart(reception):
    """The fit is forgotten by then, what the last frame's time was is not."""
    feed(reception, wires(FAR, SCANS, uptime_s=3600), arrivals(NOW_S, SCANS))
    reception.doubt()
    feed(reception, wires(0, SCANS), arrivals(NOW_S + 15, SCANS))
    assert (reception.statistics.restarts, reception.statistics.lost) == (1, 0)


def test_a_host_that_hung_has_lost_what_no_buffer_held(reception):
    """After ten seconds it finds the first half second in the buffers, all of it late, and then the present."""
    feed(reception, wires(0, SCANS), arrivals(NOW_S, SCANS))
    feed(reception, wires(SCANS, 100, uptime_s=5), [NOW_S + 15] * 100)
    feed(reception, wires(15 * INFO.rate_hz, 100, uptime_s=15), arrivals(NOW_S + 15, 100))
    assert (reception.statistics.restarts, reception.statistics.lost) == (0, 10 * INFO.rate_hz - 100)


@pytest.mark.parametrize("drift", [-0.009, 0.009])
def test_a_pause_on_a_resonators_clock_is_no_restart(reception, drift):
    """Ten minutes, at the end of which the clocks differ by 5.4 s."""
    feed(reception, wires(0, 10), arrivals(NOW_S, 10))
    feed(reception, wires(20, 10, uptime_s=600), arrivals(NOW_S + 600 * (1 + drift), 10))
    assert (reception.statistics.restarts, reception.statistics.lost) == (0, 10)


def test_what_is_sent_between_two_connections_is_not_lost(reception):
    feed(reception, wires(0, 10), arrivals(NOW_S, 10))
    reception.connected()
    feed(reception, wires(400, 10, uptime_s=2), arrivals(NOW_S + 2, 10))
    assert (reception.statistics.restarts, reception.statistics.lost, reception.statistics.overruns) == (0, 0, 0)


def test_frames_alone_cannot_tell():
    """As the page says: with the sequence and the clock both forward, the decoder finds nothing but lost frames."""
    decoder = FrameDecoder()
    decoder.feed(b"".join(wires(FAR, 1, uptime_s=3600) + wires(0, 1)))
    assert (decoder.statistics.restarts, decoder.statistics.lost) == (0, 2**16 - FAR - 1)


def test_frames_of_a_new_connection_are_trouble_until_the_info_comes(reception):
    feed(reception, wires(0, 1), [NOW_S])
    reception.connected()
    assert reception.trouble is None
    assert feed(reception, wires(1, 1), [NOW_S]) == []
    assert reception.trouble.startswith("frames but no INFO")
    reception.take(encode(replace(INFO, rate_hz=10)), NOW_S)
    assert reception.trouble is None


@pytest.mark.parametrize("stopped_s", [1, 5, 20, 60])
@pytest.mark.parametrize("is_noted", [False, True], ids=["unnoticed", "noted"])
def test_a_reader_that_was_stopped_has_lost_what_no_buffer_held(reception, stopped_s, is_noted):
    """Whether or not the scanner took the silence for a stall before it saw what the buffers had held."""
    feed(reception, wires(0, SCANS), arrivals(NOW_S, SCANS))
    woken_s = NOW_S + 5 + stopped_s
    if is_noted:
        reception.doubt()
    feed(reception, wires(SCANS, 17, uptime_s=5), [woken_s] * 17)
    first = SCANS + stopped_s * INFO.rate_hz
    feed(reception, wires(first, 100, uptime_s=5 + stopped_s), arrivals(woken_s, 100))
    assert (reception.statistics.restarts, reception.statistics.lost) == (0, stopped_s * INFO.rate_hz - 17)


def test_a_repeated_frame_is_delivered_once_and_is_no_restart(reception):
    sent = wires(0, 3)
    scans = feed(reception, [sent[0], sent[1], sent[1], sent[2]], arrivals(NOW_S, 4))
    assert [scan.frame.sequence for scan in scans] == [0, 1, 2]
    assert {scan.run for scan in scans} == {0}
    met = reception.statistics
    assert (met.ok, met.repeated, met.restarts, met.lost) == (3, 1, 0, 0)


def test_frames_of_another_board_are_counted_and_spoil_no_other_number(reception):
    """They are refused until the board has answered; of its own only those are lost that were refused meanwhile."""
    feed(reception, wires(500, 10), arrivals(NOW_S, 10))
    other = a_wire(60_000, info=replace(INFO, rows=2))
    feed(reception, [other, other, *wires(510, 3, uptime_s=0.05)], arrivals(NOW_S + 0.1, 5))
    reception.take(encode(INFO), NOW_S + 0.2)
    scans = feed(reception, wires(513, 5, uptime_s=0.065), arrivals(NOW_S + 0.2, 5))
    assert [scan.frame.sequence for scan in scans] == list(range(513, 518))
    met = reception.statistics
    assert (met.foreign, met.repeated, met.restarts, met.lost) == (4, 1, 0, 3)


def test_the_sequence_wraps_without_loss(reception):
    scans = feed(reception, wires(65_530, 20), arrivals(NOW_S, 20))
    assert {scan.run for scan in scans} == {0}
    assert (reception.statistics.restarts, reception.statistics.lost) == (0, 0)
