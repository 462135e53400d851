"""A board's link by a clock of the tests: each fault has one outcome, is counted, and scans come again after it."""

from dataclasses import replace

import numpy as np
import psutil
import pytest

from hardware.link.frames import Info, ScanMode, encode
from hardware.link.protocols import PROTOCOLS
from hardware.link.scanner import Link
from hardware.link.serial_ports import PortError
from hardware.readout.calibration import Electronics
from hardware.readout.forces import ForceReader
from tests.hardware.boards import COUNTS, INFO, Bench, Clock, ScriptedPort, a_wire
from tests.hardware.models import PillarModel

COUNTERS = ("restarts", "foreign", "lost", "bad_cobs", "bad_crc", "bad_form", "repeated", "stalls", "reconnects")


@pytest.fixture
def bench():
    bench = Bench()
    assert bench.run(1.5)
    return bench


def assert_resumes(bench):
    """Scans come that were scanned from now on, in their order and with their counts."""
    start_s = bench.clock()
    frames = [scan.frame for scan in bench.run(1.0) if scan.received_s >= start_s]
    assert bench.trouble is None
    assert len(frames) > 0.3 * INFO.rate_hz  # it may have started anew only after the retries
    assert (np.diff([frame.sequence for frame in frames[-30:]]) == 1).all()
    rows = [(frame.device_us + 1) * INFO.rate_hz // 10**6 % 50 for frame in frames[-30:]]
    assert np.array_equal([frame.counts for frame in frames[-30:]], COUNTS[rows])


def counted(bench):
    """The counts of what should not happen, where they are not 0."""
    found = vars(bench.link.reception.statistics)
    return {name: found[name] for name in COUNTERS if found[name]}


def another(**changes):
    return {"device": replace(INFO, **changes)}


UNPLUGGED, PLUGGED, ITSELF = {"is_plugged": False}, {"is_plugged": True}, {"device": None}
GONE = "disconnected: plug the board in again"
NOISE = np.random.default_rng(1).bytes(232)
FAULTS = [  # what happens one after another, what is told, what mends it, what is counted then; None: some
    ([], None, {}, {}),
    ([UNPLUGGED], GONE, PLUGGED, {"reconnects": 1}),
    ([UNPLUGGED | {"is_hindered": True}, PLUGGED], GONE, {"is_hindered": False}, {"reconnects": 1}),
    ([another(firmware=(2, 0, 0))], None, ITSELF, {"restarts": 2}),  # newer, but the same board
    ([{"is_stalled": True}], "no frames for 1.0 s", {"is_stalled": False}, {"stalls": 1}),
    ([{"garbage": [NOISE] * 999}], "no frames for", {"garbage": []}, {"stalls": 1, "lost": None, "bad_cobs": None}),
    ([another(rows=2, cols=3)], "another device answers, rows 2 instead of 6, cols 3", ITSELF,
     {"foreign": None, "restarts": 1}),
    ([UNPLUGGED, another(bits=12) | PLUGGED], "another device answers, bits 12 instead of 10", ITSELF,
     {"foreign": None, "restarts": 1, "reconnects": 1}),
    ([UNPLUGGED, another(serial=7) | PLUGGED], "another device answers, serial 7 instead of 3", ITSELF,
     {"foreign": None, "restarts": 1, "reconnects": 1, "lost": None}),
]  # fmt: skip


@pytest.mark.parametrize(("faults", "told", "cure", "expected"), FAULTS)
def test_each_fault_is_told_and_counted_and_mended(bench, faults, told, cure, expected):
    for fault in faults:
        bench.become(**fault)
        scans = bench.run(2.0)
    if told is None:
        assert bench.trouble is None
    else:
        assert bench.trouble.startswith(told)
        assert len(scans) <= 1  # the one that was on its way
    bench.become(**cure)
    assert_resumes(bench)
    assert bench.link.reception.info == INFO
    found = counted(bench)
    assert found.keys() == expected.keys()
    assert all(found[name] == n for name, n in expected.items() if n is not None)


def test_a_board_is_left_alone_at_first_and_asked_four_times_a_second_until_it_answers():
    """A boot loader is to hear nothing odd, and swallows questions; a board that has spoken is asked at once."""
    bench = Bench()
    began_s, bench.is_stalled = bench.clock(), True
    bench.run(3.0)
    assert {said for said, _ in bench.asked} == {b"?"}
    times_s = np.array([at_s for _, at_s in bench.asked]) - began_s
    assert 0.5 <= times_s[0] <= 0.61  # a read takes 0.1 s
    assert (np.diff(times_s) >= 0.25).all()
    assert len(times_s) >= 8
    bench.is_stalled = False
    assert_resumes(bench)
    n = len(bench.asked)
    bench.run(1.0)
    assert len(bench.asked) == n  # it is known
    bench.is_stalled = True
    bench.run(1.5)
    assert len(bench.asked) > n  # after a stall anybody may be there
    speaks = Bench()
    speaks.run(0.02)
    assert speaks.asked


@pytest.mark.parametrize("is_unplugged", [False, True])
def test_a_board_that_forgot_its_rate_is_asked_for_it_again_once_it_is_known(bench, is_unplugged):
    bench.link.wanted_hz = 500
    bench.run(0.5)
    assert bench.link.reception.info.rate_hz == 500
    for _ in range(2):
        bench.is_plugged = not is_unplugged
        bench.run(0.2)
        n = len(bench.asked)
        bench.become(**ITSELF | PLUGGED)
        bench.run(2.0)
        assert [said for said, _ in bench.asked[n:]] == [b"?", b"R500\n"]
        assert bench.link.reception.info.rate_hz == 500


def test_a_mute_board_after_reconnecting_is_trouble_and_overruns_are_counted_through_their_wrap():
    """Frames without INFO may be anybody's, as those before the first INFO."""
    clock = Clock()
    again = ScriptedPort(a_wire(6), a_wire(7), finite=False)
    first = ScriptedPort(finite=False)
    first.add(a_wire(0), encode(INFO), *(a_wire(k + 1, overruns=n) for k, n in enumerate([250, 254, 1, 1])))
    first.add(PortError("gone"))
    link = Link(first, lambda: again, 1.0, PROTOCOLS["tripillar"], clock, clock.sleep)
    scans = [scan for _ in range(16) for scan in link.take(link.read())]
    assert [scan.frame.sequence for scan in scans] == [1, 2, 3, 4]
    assert not first.is_open
    assert link.reception.trouble.startswith("frames but no INFO")
    met = link.reception.statistics
    assert (met.reconnects, met.ok, met.overruns) == (1, 7, 7 + 250)  # none skipped before the first frame counts


@pytest.mark.parametrize("seconds", [50, pytest.param(3600, marks=pytest.mark.long)])
def test_many_frames_in_flat_memory(seconds):
    """Between a tenth of the time and its end, the process grows by less than 4 MB: 5.5 bytes a frame of an hour."""
    info = Info(rate_hz=200, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700)
    states = [1e4, 1.4e4, 1.4e4] * np.random.default_rng(0).uniform(0.6, 1.1, (100, 6, 6, 3))
    bench, process, memory_mb, n = Bench(Electronics().crossbar(info).counts(states), info), psutil.Process(), [], 0
    bench._number = 65_000  # wraps early
    reader = ForceReader(info, PillarModel(lambda ohms: ohms / ohms[:, :1, :1] - 1))
    for part in range(2 * seconds):
        if scans := bench.run(0.5):
            assert np.isfinite(reader.forces(np.stack([scan.frame.counts for scan in scans])).force_n).all()
            n += len(scans)
        if part % (seconds // 5) == seconds // 5 - 1:
            memory_mb.append(process.memory_info().rss / 2**20)
    assert bench.link.reception.statistics.ok == pytest.approx((bench.clock() - 1000.0) * info.rate_hz, abs=2)
    assert bench.link.reception.statistics.ok - n < info.rate_hz  # those before it was asked what they are
    assert counted(bench) == {}
    assert max(memory_mb[1:]) - memory_mb[0] < 4
