"""Nothing is run that others could have put there."""

import os

import pytest

from hardware.boards.simavr_board import SimavrBoard, UntrustedError, find_tools, require_own
from hardware.boards.simulated import firmware_built, suited_kind
from hardware.link.frames import Info

NOBODY = 65534


@pytest.fixture
def cache(tmp_path):
    """A cache with one program in a folder of it, of which only the owner can change anything."""
    folder = tmp_path / "cache" / "firmware-1"
    folder.mkdir(parents=True, mode=0o700)
    (folder / "program").write_text("#!/bin/sh\n")
    (folder / "program").chmod(0o755)
    (tmp_path / "cache").chmod(0o755)
    return tmp_path / "cache"


def given_away(path):
    if os.geteuid() != 0:
        pytest.skip("only the superuser can give files to others")
    os.chown(path, NOBODY, NOBODY)


def test_what_is_ones_own_is_run(cache):
    require_own(cache / "firmware-1", cache)
    require_own(cache / "firmware-2", cache)  # not there yet
    cache.chmod(0o1777)  # as /tmp: others can add to it, but not replace what is there
    require_own(cache / "firmware-1", cache)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda cache: cache.chmod(0o777),
        lambda cache: (cache / "firmware-1").chmod(0o777),
        lambda cache: (cache / "firmware-1").chmod(0o1777),
        lambda cache: (cache / "firmware-1" / "program").chmod(0o757),
        lambda cache: given_away(cache),
        lambda cache: given_away(cache / "firmware-1"),
        lambda cache: given_away(cache / "firmware-1" / "program"),
        lambda cache: (cache / "firmware-1" / "other").symlink_to("/bin/true"),
        lambda cache: (cache / "firmware-1").rename(cache / "real") and (cache / "firmware-1").symlink_to("real"),
    ],
    ids=["cache", "folder", "sticky folder", "program", "cache's owner", "folder's owner", "owner", "link", "linked"],
)
def test_what_others_could_have_written_is_refused_in_one_line(cache, spoil):
    spoil(cache)
    with pytest.raises(UntrustedError, match=r"not run: remove it, or set TRIPILLAR_CACHE") as refused:
        require_own(cache / "firmware-1", cache)
    assert "\n" not in str(refused.value)


def test_a_group_of_others_is_others(cache):
    """A group that is not its owner's own, such as users."""
    if os.geteuid() != 0:
        pytest.skip("only the superuser can give files to a group that it is not in")
    program = cache / "firmware-1" / "program"
    os.chown(program, -1, 100)
    program.chmod(0o775)
    with pytest.raises(UntrustedError, match="can be written by others"):
        require_own(cache / "firmware-1", cache)
    os.chown(program, -1, os.getegid())  # one's own, as umask 002 leaves files
    require_own(cache / "firmware-1", cache)


def test_a_board_that_others_could_have_written_is_not_started(cache):
    program = cache / "firmware-1" / "program"
    program.write_text(f"#!/bin/sh\ntouch {cache}/it-ran\n")
    program.chmod(0o777)
    with pytest.raises(UntrustedError), SimavrBoard(cache / "elf", "atmega328p", cache / "table", program=program):
        pass
    assert not (cache / "it-ran").exists()


@pytest.mark.skipif(find_tools() is not None, reason=str(find_tools()))
def test_simulate_refuses_a_planted_program(tmp_path, monkeypatch):
    """Somebody else replaces the program in a cache that all can write to: it does not run."""
    monkeypatch.setenv("TRIPILLAR_CACHE", str(tmp_path / "cache"))
    info = Info(rows=1, cols=2, scan_mode=2, sense_ohm=4700)
    folder = firmware_built(info)
    assert folder.stat().st_mode & 0o077 == 0
    planted = folder / "simavr-board"
    planted.write_text(f"#!/bin/sh\ntouch {tmp_path}/it-ran\n")
    (tmp_path / "cache").chmod(0o777)
    with pytest.raises(UntrustedError, match=f"{tmp_path}/cache can be written by others"):
        firmware_built(info)
    with pytest.raises(UntrustedError):
        suited_kind(info)  # not even where the chip is only one of two boards
    assert not (tmp_path / "it-ran").exists()
