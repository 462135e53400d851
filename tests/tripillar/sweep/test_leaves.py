"""Data sets made leaf by leaf: the same bits by any worker, through any stop, of any number wanted."""

import sys
from pathlib import Path

import numpy as np
import pytest

from dataset import DatasetSettings, read_samples, simulate
from dataset.leaves import LEAF
from dataset.simulation import BLOCK, LoadError
from geometry import Array, DesignError, SensorDesign
from geometry.errors import NotWrittenError
from geometry.storage.journal import Journal
from tests.dataset.conftest import made_up_response
from tests.decoupler.synthetic_sensor import sensor
from tests.house import House
from tests.tripillar.made_files import a_model
from tripillar.pipeline import run as pipeline
from tripillar.sweep.leaves import LeafJob, make_directory, unfinished

RESPONSE = made_up_response(SensorDesign(array=Array(rows=2, cols=3)))


def job(samples, **changed):
    settings = DatasetSettings(protocol="three-axis", samples=samples, seed=7, noise=1e-3, cap=0.25)
    return LeafJob(response=RESPONSE, settings=settings, **changed)


class Stopped(Exception):
    """In the middle of the work."""


def stopping_after(n):
    told = []

    def progress(samples):
        told.append(samples)
        if len(told) > n:
            raise Stopped

    return progress


def test_taken_up_again_it_is_to_the_last_bit_the_same(tmp_path):
    """Stopped on the way; the next run wants more samples, so that the last part is another one."""
    out, samples = tmp_path / "data.zarr", 5 * LEAF - 100
    with pytest.raises(Stopped):
        make_directory(job(4 * LEAF - 50), out, count=1, progress=stopping_after(2))
    assert not out.exists()
    told = []
    made = make_directory(job(samples), out, count=2, progress=told.append)
    assert told[0] == made.kept == 2 * LEAF
    assert sum(told) == samples
    expected = simulate(RESPONSE, job(samples).settings)
    stored = read_samples(out)
    for block, whole in zip(stored.blocks(), expected.blocks(), strict=True):
        for name, values in whole.arrays().items():
            assert np.array_equal(getattr(block, name), values)
    assert stored.made_from["redrawn"] == made.redrawn == expected.made_from["redrawn"] > 0
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("data")] == ["data.zarr"]
    assert {path.name for path in (out / "force_n").iterdir()} == {
        ".zarray", ".zattrs", *(f"{number}.0.0.0" for number in range(5))
    }  # fmt: skip


def test_less_is_kept_on_request_and_is_the_same(tmp_path):
    """float32 of forces and resistances alone, of fewer samples than a leaf, and of more."""
    made = [
        make_directory(job(n, only=(), dtype="float32"), tmp_path / f"{n}.zarr", count=1) for n in (BLOCK + 1, LEAF + 1)
    ]
    few, more = (read_samples(tmp_path / f"{n}.zarr") for n in (BLOCK + 1, LEAF + 1))
    assert (few.dtype, few[:].length_mm, few.noise, few.design) == (np.float32, None, 1e-3, RESPONSE.design)
    assert np.array_equal(few[:].resistance_ohm, more[: BLOCK + 1].resistance_ohm)
    exact = simulate(RESPONSE, job(BLOCK + 1).settings, only=())
    assert exact.length_mm is None
    assert np.array_equal(few[:].force_n, exact.force_n.astype(np.float32))
    assert made[0].recipe != made[1].recipe
    assert few.made_from["recipe"] == made[0].recipe


def test_what_is_there_is_not_made_again_unless_it_is_damaged(tmp_path, caplog):
    out = tmp_path / "data.zarr"
    assert make_directory(job(LEAF + 9), out, count=1).kept == 0
    assert make_directory(job(LEAF + 9), out, count=1).kept == LEAF + 9
    chunk = out / "length_mm/1.0.0.0"
    chunk.write_bytes(chunk.read_bytes()[:-1])
    assert make_directory(job(LEAF + 9), out, count=1).kept == 0
    assert "is damaged" in caplog.text
    assert len(read_samples(out)[:]) == LEAF + 9


def test_a_damaged_part_is_made_anew_and_another_data_set_has_a_place_of_its_own(tmp_path):
    out = tmp_path / "data.zarr"
    with pytest.raises(Stopped):
        make_directory(job(3 * LEAF), out, count=1, progress=stopping_after(2))
    chunk = unfinished(out, job(3 * LEAF)) / "data.zarr/force_n/0.0.0.0"
    chunk.write_bytes(b"\0" * chunk.stat().st_size)  # as a crash of the machine may leave it
    assert make_directory(job(9, dtype="float32"), out, count=1).kept == 0
    assert make_directory(job(3 * LEAF), out, count=1).kept == LEAF
    assert np.array_equal(read_samples(out)[:].force_n, simulate(RESPONSE, job(3 * LEAF).settings).force_n)


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
    assert make_directory(job(2 * LEAF), out, count=1).kept == LEAF


def test_nothing_is_left_of_what_cannot_begin(tmp_path, monkeypatch):
    monkeypatch.setattr("geometry.pool.CONNECT_S", 1)
    with pytest.raises(DesignError, match="no scheduler at"):
        make_directory(job(9), tmp_path / "data.zarr", None, "tcp://127.0.0.1:9")
    small = LeafJob(response=RESPONSE, settings=DatasetSettings(protocol="three-axis", samples=9, cap=0.01))
    with pytest.raises(LoadError, match=r"beyond cap=0\.01"):
        make_directory(small, tmp_path / "data.zarr", count=1)
    assert not any(tmp_path.iterdir())


def test_a_model_reads_a_directory_as_it_reads_a_file(tmp_path, monkeypatch):
    """From the command line: the same errors, and samples of both kinds."""
    house, known = House(tmp_path), made_up_response(sensor(1, 2))
    monkeypatch.setattr(pipeline, "array_response", lambda *_: (known, tmp_path / "none", False))
    a_model(tmp_path / "model")
    for name in ("a.nc", "a.zarr"):
        made = house.result(
            "dataset", "--design", "small.toml", "--protocol", "three-axis", "--samples", "90", "--noise", "0.001",
            "--only", "resistance,force", "--out", name, "--quiet",
        )  # fmt: skip
        assert made["samples"] == 90
    asked = ["evaluate", "--model", "model", "--no-limits", "--quiet", "--data"]
    assert house.result(*asked, "a.zarr") == house.result(*asked, "a.nc")
    assert read_samples(tmp_path / "a.nc").length_mm is None
