"""Nothing is run that others could have put there."""

import os

import pytest

from hardware.boards.simavr_board import SimavrBoard, UntrustedError, require_own
from hardware.boards.simulated import firmware_built
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


def given_away(path, owner=NOBODY, group=NOBODY):
    if os.geteuid() != 0:
        pytest.skip("only the superuser can give files to others")
    os.chown(path, owner, group)


def spoil_group(cache):
    given_away(cache / "firmware-1" / "program", -1, 100)  # a group that is not its owner's own, such as users
    (cache / "firmware-1" / "program").chmod(0o775)


def linked(cache):
    (cache / "firmware-1").rename(cache / "real")
    (cache / "firmware-1").symlink_to("real")


@pytest.mark.parametrize(
    ("change", "is_trusted"),
    [
        (lambda cache: None, True),
        (lambda cache: cache.chmod(0o1777), True),  # as /tmp: others can add to it, but not replace what is there
        (lambda cache: (cache / "firmware-1" / "program").chmod(0o775), True),  # as umask 002 leaves files
        (lambda cache: cache.chmod(0o777), False),
        (lambda cache: (cache / "firmware-1").chmod(0o777), False),
        (lambda cache: (cache / "firmware-1" / "program").chmod(0o757), False),
        (spoil_group, False),
        (lambda cache: given_away(cache / "firmware-1" / "program"), False),
        (lambda cache: (cache / "firmware-1" / "other").symlink_to("/bin/true"), False),
        (linked, False),
    ],
)  # fmt: skip
def test_what_others_could_have_written_is_refused_in_one_line(cache, change, is_trusted):
    change(cache)
    if is_trusted:
        require_own(cache / "firmware-1", cache)
        require_own(cache / "firmware-2", cache)  # not there yet
        return
    with pytest.raises(UntrustedError, match=r"not run: remove it, or set TRIPILLAR_CACHE") as refused:
        require_own(cache / "firmware-1", cache)
    assert "\n" not in str(refused.value)


def test_simulate_refuses_a_planted_program(tmp_path, monkeypatch):
    """Somebody else replaces the program in a cache that all can write to: it does not run."""
    monkeypatch.setenv("TRIPILLAR_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr("hardware.boards.simulated.find_tools", lambda: None)
    (tmp_path / "make").write_text('#!/bin/sh\nfor each; do case $each in OUT=*) mkdir "${each#OUT=}"; esac; done\n')
    (tmp_path / "make").chmod(0o755)
    info = Info(rows=1, cols=2, scan_mode=2, sense_ohm=4700)
    folder = firmware_built(info)
    assert folder.stat().st_mode & 0o077 == 0
    planted = folder / "simavr-board"
    planted.write_text(f"#!/bin/sh\ntouch {tmp_path}/it-ran\n")
    (tmp_path / "cache").chmod(0o777)
    with pytest.raises(UntrustedError, match=f"{tmp_path}/cache can be written by others"):
        firmware_built(info)
    planted.chmod(0o777)
    with pytest.raises(UntrustedError, match="can be written by others"):
        SimavrBoard(folder / "elf", "atmega328p", folder / "table", program=planted)
    assert not (tmp_path / "it-ran").exists()
