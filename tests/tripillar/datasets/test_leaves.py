"""Data sets made leaf by leaf: the same bits by any worker, through any stop, of any number wanted."""

import sys
from pathlib import Path

import numpy as np
import pytest

from common.errors import NotWrittenError
from common.storage.journal import Journal
from dataset import DatasetSettings, read_samples, simulate
from dataset.leaves import LEAF
from dataset.simulation import LoadError
from geometry import Array, SensorDesign
from tests.dataset.conftest import made_up_response
from tests.house import House
from tripillar.datasets.leaves import LeafJob, make_directory, unfinished

RESPONSE = made_up_response(SensorDesign(array=Array(rows=1, cols=2)))


def job(samples, **changed):
    settings = DatasetSettings(protocol="three-axis", samples=samples, seed=7, noise=1e-3, cap=0.16)
    return LeafJob(response=RESPONSE, settings=settings, **changed)


class Stopped(Exception):
    """In the middle of the work."""


def stopped_after_two(out, job):
    told = []

    def progress(samples):
        told.append(samples)
        if len(told) > 2:
            raise Stopped

    with pytest.raises(Stopped):
        make_directory(job, out, count=1, progress=progress)
    assert not out.exists()


def test_taken_up_again_it_is_to_the_last_bit_the_same(tmp_path):
    """Stopped on the way; one part is damaged; the next run wants more, so that the last part is another one.

    What is there is then not made again, unless it is damaged.
    """
    out, samples, told = tmp_path / "data.zarr", 5 * LEAF - 100, []
    stopped_after_two(out, job(4 * LEAF - 50))
    chunk = unfinished(out, job(9)) / "data.zarr/force_n/0.0.0.0"
    chunk.write_bytes(b"\0" * chunk.stat().st_size)  # as a crash of the machine may leave it
    made = make_directory(job(samples), out, count=2, progress=told.append)
    assert told[0] == made["kept"] == LEAF
    assert sum(told) == samples
    expected = simulate(RESPONSE, job(samples).settings)
    for block, whole in zip(read_samples(out).blocks(), expected.blocks(), strict=True):
        for name, values in whole.arrays().items():
            assert np.array_equal(getattr(block, name), values)
    assert read_samples(out).made_from["redrawn"] == made["redrawn"] == expected.made_from["redrawn"] > 0
    assert [path.name for path in tmp_path.iterdir()] == ["data.zarr"]
    assert make_directory(job(samples), out, count=1)["kept"] == samples
    chunk = out / "length_mm/1.0.0.0"
    chunk.write_bytes(chunk.read_bytes()[:-1])
    assert make_directory(job(samples), out, count=1)["kept"] == 0
    assert len(read_samples(out)[:]) == samples


def test_less_is_kept_on_request_and_is_the_same(tmp_path):
    """float32 of forces and resistances alone, of fewer samples than a leaf, and of more."""
    made = [make_directory(job(n, only=(), dtype="float32"), tmp_path / f"{n}.zarr", count=1) for n in (9, LEAF + 1)]
    few, more = (read_samples(tmp_path / f"{n}.zarr") for n in (9, LEAF + 1))
    assert (few.dtype, few[:].length_mm, few.noise, few.design) == (np.float32, None, 1e-3, RESPONSE.design)
    assert np.array_equal(few[:].resistance_ohm, more[:9].resistance_ohm)
    exact = simulate(RESPONSE, job(9).settings, only=())
    assert np.array_equal(few[:].force_n, exact.force_n.astype(np.float32))
    assert few.made_from["recipe"] == made[0]["recipe"] != made[1]["recipe"]


@pytest.mark.skipif(sys.platform != "linux", reason="needs the device of a full disk")
def test_a_full_disk_keeps_what_there_is(tmp_path, monkeypatch):
    out = tmp_path / "data.zarr"
    real = Path.write_bytes

    def full(path, content):
        if path.name == "chunk.new" and len(Journal(unfinished(out, job(2 * LEAF))).keys()) == 1:
            return real(Path("/dev/full"), content)
        return real(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(NotWrittenError, match=r"disk is full.* are kept: give the same command again"):
        make_directory(job(2 * LEAF), out, count=1)
    monkeypatch.undo()
    assert make_directory(job(2 * LEAF), out, count=1)["kept"] == LEAF


def test_nothing_is_left_of_what_cannot_begin(tmp_path):
    small = LeafJob(response=RESPONSE, settings=DatasetSettings(protocol="three-axis", samples=9, cap=0.01))
    with pytest.raises(LoadError, match=r"beyond cap=0\.01"):
        make_directory(small, tmp_path / "data.zarr", count=1)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_samples_for_tests_are_of_the_same_sensor_under_other_loads(tmp_path, suffix):
    house = House(tmp_path)
    words = (
        "dataset", "--design", "small.toml", "--protocol", "contact", "--samples", "50", "--test-share", "0.2",
        "--gain-spread", "0.1", "-o", f"data{suffix}",
    )  # fmt: skip
    told = house.result(*words)
    assert (told["samples"], told["test_samples"], told["test_file"]) == (40, 10, f"data-test{suffix}")
    learned, tested = (read_samples(house.folder / f"data{part}{suffix}")[:] for part in ("", "-test"))
    assert (len(learned), len(tested)) == (40, 10)
    shears = tested.force_n[..., :2]  # pressures are the largest now and then
    assert not np.isin(shears[shears != 0], learned.force_n).any()
    assert learned.made_from["specimen"] == tested.made_from["specimen"]
    if suffix == ".zarr":
        card = house.folder / "data-README.md"
        assert card.read_text().startswith("# 40 samples of 1 × 2 units, contact\n")
        card.write_text(licensed := card.read_text().replace("to be filled in by", "CC0, chosen by"))
        house.result(*words)
        assert card.read_text() == licensed
    (house.folder / f"other-test{suffix}").mkdir()
    (house.folder / f"other-test{suffix}/notes.txt").touch()
    assert f"other-test{suffix} is a folder" in house.refusal(*words[:-1], f"other{suffix}")


def test_a_table_of_loads_is_divided_between_samples_to_learn_from_and_for_tests(tmp_path):
    house = House(tmp_path)
    pads = "\n".join(f"{k},pad,0,{k % 2},{10 * (k + 1)}" for k in range(10))
    (house.folder / "loads.csv").write_text(f"load,kind,row,col,fz_n\n{pads}\n")
    words = ("dataset", "--design", "small.toml", "--protocol", "table", "--loads", "loads.csv", "--samples", "60")
    house.result(*words, "--test-share", "0.3", "-o", "data.nc")
    learned, tested = ({*read_samples(house.folder / name)[:].force_n.max(axis=(1, 2, 3)).round(6).tolist()}
                       for name in ("data.nc", "data-test.nc"))  # fmt: skip
    assert (len(learned | tested), learned & tested) == (10, set())
    assert "divides no table of 10 loads" in house.refusal(*words, "--test-share", "0.04", "-o", "other.nc", "-q")
