"""A board's link by a clock of the tests: each fault has one outcome, is counted, and scans come again after it."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.link.frames import encode
from hardware.link.protocols import PROTOCOLS
from hardware.link.scanner import Link
from hardware.link.serial_ports import PortError
from tests.hardware.boards import COUNTS, INFO, Bench, Clock, ScriptedPort, a_wire

RESUMES_S = 1.0
SAYS_NOTHING = {"restarts": 0, "foreign": 0, "lost": 0, "bad_cobs": 0, "bad_crc": 0, "bad_form": 0, "repeated": 0}


@pytest.fixture
def bench():
    bench = Bench()
    assert bench.run(1.5)
    return bench


def trouble(bench):
    return bench.link.fault or bench.link.reception.trouble


def assert_resumes(bench):
    """Scans come that were scanned from now on, in their order and with their counts."""
    start_s = bench.clock()
    scans = [scan for scan in bench.run(RESUMES_S) if scan.received_s >= start_s]
    assert trouble(bench) is None
    assert len(scans) > 0.3 * RESUMES_S * INFO.rate_hz  # it may have started anew only after the retries
    frames = [scan.frame for scan in scans]
    assert (np.diff([frame.sequence for frame in frames[-30:]]) == 1).all()
    rows = [(frame.device_us + 1) * INFO.rate_hz // 10**6 % 50 for frame in frames[-30:]]
    assert np.array_equal([frame.counts for frame in frames[-30:]], COUNTS[rows])


def counted(bench, **expected):
    """Of all that is counted, these, and nothing else."""
    link = bench.link
    found = vars(link.reception.statistics) | {"stalls": link.n_stalls, "reconnects": link.n_reconnects}
    wanted = SAYS_NOTHING | {"stalls": 0, "reconnects": 0} | expected
    assert {name: found[name] for name in wanted} == wanted


def test_scans_come_in_their_order_at_the_boards_times(bench):
    scans = bench.run(2.0)
    assert len(scans) == pytest.approx(2.0 * INFO.rate_hz, abs=1)
    steps_s = np.diff([scan.time_s for scan in scans])
    assert steps_s == pytest.approx(1 / INFO.rate_hz, abs=3e-6)  # whole microseconds
    assert_resumes(bench)
    counted(bench)


def test_a_board_is_left_alone_at_first_and_asked_four_times_a_second_until_it_answers():
    """A boot loader is to hear nothing odd, and swallows questions; a board that has spoken is asked at once."""
    bench = Bench()
    began_s, bench.board.is_stalled = bench.clock(), True
    bench.run(3.0)
    assert {said for said, _ in bench.asked} == {b"?"}
    times_s = np.array([at_s for _, at_s in bench.asked]) - began_s
    assert 0.5 <= times_s[0] <= 0.61  # a read takes 0.1 s
    assert (np.diff(times_s) >= 0.25).all()
    assert len(times_s) >= 8
    bench.board.is_stalled = False
    assert_resumes(bench)
    n = len(bench.asked)
    bench.run(1.0)
    assert len(bench.asked) == n  # it is known
    speaks = Bench()
    speaks.run(0.02)
    assert speaks.asked


@pytest.mark.parametrize("times", [1, 3])
def test_unplugged_and_replugged(bench, times):
    for _ in range(times):
        bench.is_plugged = False
        assert bench.run(1.0) == []
        assert trouble(bench).startswith("disconnected, trying again: ")
        bench.is_plugged = True
        assert_resumes(bench)
    counted(bench, reconnects=times)


def test_in_use_when_it_comes_back(bench):
    bench.is_plugged, bench.hindrance = False, "in use by another program"
    bench.run(0.5)
    bench.is_plugged = True
    assert bench.run(1.0) == []
    bench.hindrance = None
    assert_resumes(bench)
    counted(bench, reconnects=1)


def test_a_port_that_may_not_be_opened_again_is_gone():
    bench = Bench(may_reopen=False)
    bench.run(1.0)
    bench.is_plugged = False
    with pytest.raises(PortError, match="the port is gone"):
        bench.run(1.0)


def test_a_restart_in_mid_stream_is_no_loss(bench):
    bench.restart()
    assert_resumes(bench)
    counted(bench, restarts=1)


def test_a_stall_is_told_and_what_the_board_missed_is_counted(bench):
    bench.board.is_stalled = True
    assert len(bench.run(2.0)) <= 1  # the one that was on its way
    assert trouble(bench) == "no frames for 1.0 s"
    bench.board.is_stalled = False
    assert_resumes(bench)
    counted(bench, stalls=1)
    assert bench.link.reception.statistics.overruns > 0  # modulo 256, where its counter is at its end


def test_garbage_for_longer_than_the_timeout_is_a_stall(bench):
    bench.board.garbage = [np.random.default_rng(1).bytes(232)] * 10**6
    bench.run(2.0)
    assert trouble(bench).startswith("no frames for")
    bench.board.garbage.clear()
    assert_resumes(bench)
    assert bench.link.n_stalls == 1


@pytest.mark.parametrize(
    ("garbage", "kind"),
    [
        (b"\xff" * 400, {"bad_form", "bad_crc", "bad_cobs"}),
        (bytes(400), set()),
        (b"\x05ab\0", {"bad_cobs"}),
        (b"\x06DDDDD\0", {"bad_crc"}),
        (b"", set()),
    ],
    ids=["ones", "zeros", "cobs", "crc", "nothing"],
)
def test_bursts_of_garbage_cost_the_frames_they_replace(bench, garbage, kind):
    bench.board.garbage = [garbage] * 10
    assert_resumes(bench)
    found = bench.link.reception.statistics
    assert found.lost in (10, 11)  # garbage without an end takes the next frame along
    assert {name for name in ("bad_cobs", "bad_crc", "bad_form") if getattr(found, name)} <= kind
    assert bool(kind) == bool(found.bad_cobs + found.bad_crc + found.bad_form)
    assert (found.restarts, found.foreign, bench.link.n_reconnects) == (0, 0, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"serial": 7}, "another device answers, serial 7 instead of 3"),
        ({"rows": 2, "cols": 3}, "another device answers, rows 2 instead of 6, cols 3 instead of 6"),
        ({"bits": 12}, "another device answers, bits 12 instead of 10"),
        ({"sense_ohm": 4700}, "another device answers, sense_ohm 4700 instead of 10000"),
    ],
)
def test_another_device_is_not_delivered_until_the_first_is_back(bench, change, message):
    bench.is_plugged = False
    bench.run(0.3)
    bench.become(replace(INFO, **change))
    bench.is_plugged = True
    assert bench.run(1.0) == []
    assert trouble(bench).startswith(message)
    assert bench.link.reception.statistics.foreign > 10
    bench.become(None)
    assert_resumes(bench)
    assert bench.link.reception.info == INFO
    assert bench.link.n_reconnects == 1


def test_another_device_of_another_size_tells_at_once_without_unplugging(bench):
    """As behind a socket, before any INFO."""
    bench.become(replace(INFO, rows=2, cols=3))
    assert all(scan.frame.counts.size == 108 for scan in bench.run(1.0))
    assert bench.link.reception.statistics.foreign > 10
    bench.become(None)
    assert_resumes(bench)


def test_newer_firmware_and_another_rate_are_the_same_board(bench):
    bench.become(newer := replace(INFO, firmware=(2, 0, 0), rate_hz=50))
    bench.run(2.0)
    assert trouble(bench) is None
    assert bench.link.reception.info == newer
    counted(bench, restarts=1)


@pytest.mark.parametrize("is_unplugged", [False, True])
def test_a_board_that_forgot_its_rate_is_asked_for_it_again_once_it_is_known(bench, is_unplugged):
    bench.link.wanted_hz = 500
    bench.run(0.5)
    assert bench.link.reception.info.rate_hz == 500
    for _ in range(2):
        bench.is_plugged = not is_unplugged
        bench.run(0.2)
        n = len(bench.asked)
        bench.restart()
        bench.is_plugged = True
        bench.run(2.0)
        assert [said for said, _ in bench.asked[n:]] == [b"?", b"R500\n"]
        assert bench.link.reception.info.rate_hz == 500


def test_a_mute_board_after_reconnecting_is_trouble():
    """Frames without INFO may be anybody's."""
    clock = Clock()
    again = ScriptedPort(a_wire(1), a_wire(2), finite=False)
    first = ScriptedPort(encode(INFO), a_wire(0), PortError("gone"))
    link = Link(first, lambda: again, 1.0, PROTOCOLS["tripillar"], clock, clock.sleep)
    scans = []
    for _ in range(12):
        scans += link.take(link.read())
    assert [scan.frame.sequence for scan in scans] == [0]
    assert not first.is_open
    assert link.reception.trouble.startswith("frames but no INFO")
    assert (link.n_reconnects, link.reception.statistics.ok) == (1, 3)


def test_overruns_are_counted_through_their_wrap_and_frames_before_the_info_mean_nothing():
    port = ScriptedPort(a_wire(0), encode(INFO), *(a_wire(k + 1, overruns=n) for k, n in enumerate([250, 254, 1, 1])))
    link, scans = Link(port, None, 1.0, PROTOCOLS["tripillar"]), []
    while not link.is_finished:
        scans += link.take(link.read())
    assert [scan.frame.sequence for scan in scans] == [1, 2, 3, 4]
    assert link.reception.statistics.overruns == 7 + 250  # those before the first frame came since it
    assert link.reception.statistics.ok == 5
