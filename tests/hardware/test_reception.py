"""Restarts of the board, told by both clocks, with nothing counted lost over them; and the fit of its clock."""

import time
from dataclasses import replace

import numpy as np
import pytest

from hardware.link.frames import encode
from hardware.link.reception import DeviceClock, Reception
from tests.hardware.boards import INFO, a_wire

LASTS_S = 2
SCANS = LASTS_S * INFO.rate_hz
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


@pytest.mark.parametrize("uptime_min", [20, 40, 71])
@pytest.mark.parametrize("pause_s", [0.1, 20.0])
@pytest.mark.parametrize("note", [lambda reception: None, Reception.connected, Reception.doubt])
def test_a_reset_after_any_uptime_is_a_restart(reception, uptime_min, pause_s, note):
    """From 35.8 min on, the clock seems to go forward, here together with the sequence; noted or not."""
    feed(reception, wires(FAR, SCANS, uptime_s=60 * uptime_min), arrivals(NOW_S, SCANS))
    note(reception)
    to_unix_s = time.time() - time.perf_counter()
    again_s = arrivals(NOW_S + LASTS_S + pause_s, SCANS)
    reception.take(encode(INFO), again_s[0])
    scans = feed(reception, wires(0, SCANS), again_s)
    assert (reception.statistics.restarts, reception.statistics.lost) == (1, 0)
    assert reception.statistics.overruns == 7  # since the restart: the first ones came before the first frame
    assert [scan.time_s - to_unix_s for scan in scans] == pytest.approx(again_s, abs=0.01)  # no fit over both runs


@pytest.mark.parametrize("drift", [-0.009, 0.009])
def test_a_pause_on_a_resonators_clock_is_no_restart(reception, drift):
    """Ten minutes, at the end of which the clocks differ by 5.4 s."""
    feed(reception, wires(0, 10), arrivals(NOW_S, 10))
    feed(reception, wires(20, 10, uptime_s=600), arrivals(NOW_S + 600 * (1 + drift), 10))
    assert (reception.statistics.restarts, reception.statistics.lost) == (0, 10)


@pytest.mark.parametrize("stopped_s", [1, 60])
@pytest.mark.parametrize("is_noted", [False, True], ids=["unnoticed", "noted"])
def test_a_reader_that_was_stopped_has_lost_what_no_buffer_held(reception, stopped_s, is_noted):
    """Whether or not the scanner took the silence for a stall before it saw what the buffers had held."""
    feed(reception, wires(0, SCANS), arrivals(NOW_S, SCANS))
    woken_s = NOW_S + LASTS_S + stopped_s
    if is_noted:
        reception.doubt()
    feed(reception, wires(SCANS, 17, uptime_s=LASTS_S), [woken_s] * 17)
    first = SCANS + stopped_s * INFO.rate_hz
    feed(reception, wires(first, 100, uptime_s=LASTS_S + stopped_s), arrivals(woken_s, 100))
    assert (reception.statistics.restarts, reception.statistics.lost) == (0, stopped_s * INFO.rate_hz - 17)


def test_frames_of_another_board_are_counted_and_spoil_no_other_number(reception):
    """They are refused until the board has answered; of its own only those are lost that were refused meanwhile."""
    feed(reception, wires(500, 10), arrivals(NOW_S, 10))
    other = a_wire(60_000, info=replace(INFO, rows=2))
    feed(reception, [other, other, *wires(510, 3, uptime_s=0.05)], arrivals(NOW_S + 0.1, 5))
    assert reception.trouble.startswith("frames of 36 counts of 10 bits in mode DIVIDER came, but the board has 108")
    assert reception.asks
    reception.take(encode(INFO), NOW_S + 0.2)
    scans = feed(reception, wires(513, 5, uptime_s=0.065), arrivals(NOW_S + 0.2, 5))
    assert [scan.frame.sequence for scan in scans] == list(range(513, 518))
    met = reception.statistics
    assert (met.foreign, met.repeated, met.restarts, met.lost) == (4, 1, 0, 3)
    reception.take(encode(replace(INFO, serial=7)), NOW_S + 1)
    assert reception.statistics.foreign == 5


def test_overruns_are_said_with_what_the_counter_cannot_hold():
    """The board counts 255 and then no more."""
    reception = Reception()
    for second, (overruns, said) in enumerate([(12, "0"), (254, "242"), (255, "at least 243")]):
        reception.take(a_wire(second, overruns=overruns), 1000.0 + second)
        assert reception.statistics.overruns_said == f"{said} overruns"


# the clock, by simulated boards whose true time is known

RATE_HZ = 150
MIN_DELAY_S = 3e-3  # of every frame; no receiver can tell it from an offset of the clock


def late_arrivals(seconds, *, drift=50e-6, first_us=0, jitter_s=5e-4, bursts=False, seed=0):
    """Times of a board whose clock runs slow by `drift`: (true [s], board's [µs, wrapped], received [s])."""
    generator = np.random.default_rng(seed)
    true_s = 1000 + np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    device_us = np.round(first_us + (true_s - true_s[0]) * 1e6 / (1 + drift)).astype(np.int64) % 2**32
    delay_s = MIN_DELAY_S + generator.exponential(jitter_s, true_s.size)
    if bursts:  # every 7 s, for 1.5 s: a second at least in which no frame is quick
        delay_s += np.where((true_s % 7) < 1.5, generator.uniform(0.02, 0.5), 0)
    return true_s, device_us, np.maximum.accumulate(true_s + delay_s)  # frames do not overtake each other


# The quickest of the 150 frames of a second is late by 5e-4 / 150 = 3 µs on average. Before the drift of a resonator
# is known, it is the quickest of the first ten or so that is kept instead: 50 µs, and twice that is rare.
BOUND_S = 1e-4


@pytest.mark.parametrize("options", [{"drift": -50e-6}, {"drift": 5e-3}, {"bursts": True}, {"first_us": 2**32 - 10**7}])
def test_drift_jitter_bursts_of_delay_and_the_rollover_leave_microseconds(options):
    """In bursts, for 1.5 s in 7 s, all frames are up to half a second late; their time is not."""
    clock, (true_s, device_us, received_s) = DeviceClock(), late_arrivals(60, **options)
    error_s = -true_s - MIN_DELAY_S
    for k, (device, received) in enumerate(zip(device_us.tolist(), received_s.tolist(), strict=True)):
        clock.add(device, received)
        error_s[k] += clock.host_time(device)  # as told on its arrival
    unsettled = 4 * abs(options.get("drift", 50e-6)) + BOUND_S
    assert np.abs(error_s[RATE_HZ : 4 * RATE_HZ]).max() < unsettled
    assert np.abs(error_s[5 * RATE_HZ :]).max() < BOUND_S
    assert clock.drift == pytest.approx(options.get("drift", 50e-6), abs=1e-5)


def test_times_of_a_backlog_are_apart_as_its_scans_are_and_never_repeat(reception):
    """Within a piece times are a period apart, in each of its runs; from one piece to the next they grow."""
    sent = wires(500, 10, uptime_s=100.0) + wires(0, 10, uptime_s=0.0)
    scans = reception.take(b"".join(sent), NOW_S)
    assert [scan.run for scan in scans] == [0] * 10 + [1] * 10
    sent = wires(10, 50)
    scans += [*reception.take(b"".join(sent[:25]), NOW_S), *reception.take(b"".join(sent[25:]), NOW_S + 0.001)]
    steps_s = np.diff([scan.time_s for scan in scans])
    assert (steps_s > 0).all()
    assert steps_s[:9] == pytest.approx(1 / INFO.rate_hz, abs=1e-6)


@pytest.mark.parametrize("pace", [10.0, 2.0, 0.5, 0.1])
def test_a_clock_that_is_far_off_is_told_and_one_that_is_caught_up_with_is_not(pace):
    """What the drift is bound to hides it: frames at 150 Hz of the board's clock come 10 times as fast, or as slow."""
    clock, (true_s, device_us, received_s) = DeviceClock(), late_arrivals(60, drift=0.0)
    for device, true, received in zip(device_us.tolist(), true_s, received_s, strict=True):
        clock.add(device, received + (true - 1000) * (1 / pace - 1))
    assert clock.pace == pytest.approx(pace, rel=1e-3)
    clock.restart()
    assert clock.pace == 1.0
    for device, true, received in zip(device_us.tolist(), true_s, received_s, strict=True):
        clock.add(device, max(received, 1003.0 + 0.1 * (true - 1000)))  # a second's frames in a tenth of one
    assert clock.pace == pytest.approx(1.0, abs=1e-3)
