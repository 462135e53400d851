"""Files to write: refused before anything is computed, links followed, nothing left of killed processes."""

import os
import subprocess
import sys

import pytest

from common.storage import unfinished
from common.storage.files import replacing
from common.storage.unfinished import MARK, remove_leftovers
from geometry import FileFormatError


@pytest.mark.skipif(os.name != "posix", reason="pipes with names are POSIX's")
def test_what_is_no_file_is_refused_and_left_alone_and_a_link_is_followed(tmp_path):
    pipe, link, real = (tmp_path / name for name in ("pipe.nc", "link.txt", "real.txt"))
    os.mkfifo(pipe)
    for path, kind in ((pipe, "a pipe"), (tmp_path, "a folder"), (pipe / "a.nc", "is not a folder")):
        with pytest.raises(FileFormatError, match=kind), replacing(path):
            raise AssertionError("must not begin")
    assert pipe.is_fifo()
    link.symlink_to(real)
    for text in ("made", "made again"):
        with replacing(link) as temporary:
            temporary.write_text(text)
        assert (real.read_text(), link.is_symlink()) == (text, True)


@pytest.mark.skipif(sys.platform == "win32", reason="no locks")
def test_what_a_killed_process_leaves_is_removed_and_what_a_living_one_holds_is_not(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from common.storage.files import replacing\n"
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
    for _ in range(2):
        with replacing(tmp_path / "other.txt"):  # this process has looked through the folder already
            pass
        unfinished._looked_through.clear()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".mine", "other.txt"]
