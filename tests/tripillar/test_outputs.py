"""Files to write: refused before anything is computed, links followed, nothing left of killed processes."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from geometry import FileFormatError
from geometry.storage.files import replacing, require_folder
from geometry.storage.unfinished import MARK, remove_leftovers, remove_unfinished
from tests.house import House


@pytest.mark.skipif(os.name != "posix", reason="pipes with names are POSIX's")
def test_what_is_no_file_is_refused_and_left_alone(tmp_path):
    pipe = tmp_path / "pipe.nc"
    os.mkfifo(pipe)
    for path, kind in ((pipe, "a pipe"), (tmp_path, "a folder"), (pipe / "a.nc", "is not a folder")):
        with pytest.raises(FileFormatError, match=kind), replacing(path):
            raise AssertionError("must not begin")
    assert pipe.is_fifo()
    with pytest.raises(FileFormatError, match="is not a folder"):
        require_folder(pipe)


def test_a_link_is_followed(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "link.txt").symlink_to(tmp_path / "there" / "real.txt")
    for text in ("made", "made again"):
        with replacing(tmp_path / "link.txt") as temporary:
            temporary.write_text(text)
        assert (tmp_path / "there" / "real.txt").read_text() == text
    assert (tmp_path / "link.txt").is_symlink()


@pytest.mark.skipif(sys.platform == "win32", reason="no locks")
def test_what_a_killed_process_leaves_is_removed_and_what_a_living_one_holds_is_not(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from geometry.storage.files import replacing\n"
        "with replacing(Path(sys.argv[1])) as temporary:\n"
        "    temporary.write_text('half'); print('begun', flush=True); time.sleep(60)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "data.txt")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "begun\n"
        (tmp_path / ".mine").mkdir()
        remove_leftovers(tmp_path)
        assert len([path for path in tmp_path.iterdir() if MARK in path.name]) == 1
        process.kill()
    with replacing(tmp_path / "other.txt"):  # this process has looked through the folder already
        pass
    from geometry.storage import unfinished

    unfinished._looked_through.clear()
    with replacing(tmp_path / "other.txt"):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == [".mine", "other.txt"]


def test_an_interrupt_as_soon_as_the_folder_is_there_removes_it(tmp_path, monkeypatch):
    make = os.mkdir

    def make_and_be_interrupted(*where, **settings):
        make(*where, **settings)
        remove_unfinished()
        raise KeyboardInterrupt

    monkeypatch.setattr("geometry.storage.unfinished._of_this_process", set())  # not those of other tests
    monkeypatch.setattr(os, "mkdir", make_and_be_interrupted)
    with pytest.raises(KeyboardInterrupt), replacing(tmp_path / "data.txt"):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_what_swallows_it(tmp_path, number, code):
    """Libraries swallow an exception, or compute on; what is unfinished or was started ends, in a line."""
    program = (
        "from tripillar.terminal import interrupts; interrupts.install()\n"
        "import subprocess, time; from pathlib import Path; from geometry.storage.files import replacing\n"
        "started = subprocess.Popen(['sleep', '60'])\n"
        "with replacing(Path('data.txt')) as temporary:\n"
        "    print(started.pid, flush=True)\n"
        "    while True:\n"
        "        try: time.sleep(60)\n"
        "        except BaseException: pass"
    )
    house = House(tmp_path)
    environment = house.environment | {"PYTHONPATH": os.getcwd()}
    for _ in range(5):  # until the machine holds nobody up
        with subprocess.Popen(
            [sys.executable, "-c", program], cwd=tmp_path, env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        ) as process:  # fmt: skip
            started = int(process.stdout.readline())
            begin = time.monotonic()
            process.send_signal(number)
            said = process.communicate(timeout=60)[1]
        seconds = time.monotonic() - begin
        if seconds < 2:
            break
    assert seconds < 2
    assert (process.returncode, said) == (code, "tripillar: interrupted.\n")
    assert not psutil.pid_exists(started) or psutil.Process(started).status() == psutil.STATUS_ZOMBIE
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]
