"""Files are written whole or not at all, and a cache key changes with all that it is made of."""

import os
import signal
import stat
from dataclasses import replace

import numpy as np
import pytest

from geometry import Array, Material, SensorDesign
from geometry.storage.files import digest, replacing, uninterrupted


def test_readers_see_the_old_file_until_the_new_one_is_whole(tmp_path):
    """A write that fails half way leaves it, and no litter."""
    path = tmp_path / "a" / "b" / "data.txt"  # missing folders are made
    for old, text in ((None, "old"), ("old", "new")):
        with replacing(path) as temporary:
            temporary.write_text(text)
            assert (path.read_text() if path.exists() else None) == old
            assert temporary.parent.parent == path.parent  # a rename across file systems would be a copy
            assert temporary.name == path.name
        assert path.read_text() == text
    with pytest.raises(RuntimeError, match="half way"), replacing(path) as temporary:  # noqa: PT012, both are the point
        temporary.write_text("ne")
        raise RuntimeError("half way")
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX's")
@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_files_have_the_permissions_that_open_gives(tmp_path, umask):
    before = os.umask(umask)
    try:
        with replacing(tmp_path / "ours") as temporary:
            temporary.write_text("new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "ours").stat().st_mode) == 0o666 & ~umask


def test_digest_changes_with_every_field_but_not_with_the_order_of_a_dict():
    """Pinned: a change of the first one makes every cache and every recorded key worthless."""
    assert digest("mesh", 1, 2.5, None, {"b": 1, "a": 2}) == "4f0c2e2586d962e9"
    design = SensorDesign()
    assert digest(design) == digest(SensorDesign(array=Array(pitch_mm=15)))
    other = Material(young_mpa=6.2)
    others = [
        replace(design, **change)
        for change in ({"resistivity_ohm_mm": 4001.0}, {"array": Array(rows=5)}, {"pillar_material": other})
    ]
    assert len({digest(each) for each in [design, *others, replace(design, matrix_material=other)]}) == 5
    assert digest("ab", "c") != digest("a", "bc")  # parts do not run together
    assert digest(["a", "b"]) != digest("a", "b")


def test_digest_changes_with_dtype_shape_and_value_of_an_array_not_with_its_memory():
    array, one_bit = np.arange(6.0), np.arange(6.0)
    one_bit[3] = np.nextafter(one_bit[3], 4.0)
    table = array.reshape(2, 3)
    others = [one_bit, table, table.T, array.reshape(3, 2), array.astype(np.float32), array.view(np.int64)]
    assert len({digest(each) for each in [array, *others]}) == 7
    assert digest(np.asfortranarray(table)) == digest(table)


def test_an_interrupt_waits_for_the_block_and_then_comes():
    """Ctrl-C inside the block lets it finish; afterwards it is raised, and the old handler is back."""
    before = signal.getsignal(signal.SIGINT)
    finished = []
    with pytest.raises(KeyboardInterrupt), uninterrupted():  # noqa: PT012, both lines are the point
        signal.raise_signal(signal.SIGINT)
        finished.append(True)
    assert finished
    assert signal.getsignal(signal.SIGINT) is before
