"""Work is bounded before it begins: what is no file, too large, too deep or too thin is refused before it is read.

No clock decides: what would take the time or the memory is counted, or must not be called.
"""

import json
import os
import socket
from itertools import product

import netCDF4
import numpy as np
import pytest

from common import bounded
from common import pool as pools
from common.errors import DesignError, FileFormatError, TriPillarError
from common.pool import open_pool
from common.storage import netcdf
from common.storage.text_file import tables_of
from dataset import table as tables
from dataset.stored import read_samples
from decoupler.data.load_table import read_loads
from decoupler.model_file import read_model
from decoupler.rubber.rubber_file import read_rubber
from decoupler.rubber.series import read_series
from fem.array.response import read_response
from fem.scene.scene_file import read_scene
from geometry import SensorDesign, Unit
from geometry import layout as layouts
from geometry.design_file import read_design
from geometry.layout import Electrode, Layout, Pillar
from hardware.link.frames import Info
from hardware.readout.calibration import read_calibration
from hardware.recording import Recorder, read_recording
from tests.house import House
from tripillar.sweeps.sweep_file import read_sweep

READERS = {
    "design.toml": read_design, "scene.toml": read_scene, "sweep.toml": read_sweep, "rubber.toml": read_rubber,
    "calibration.json": read_calibration, "samples.nc": read_samples, "samples.csv": read_samples,
    "response.nc": read_response, "model.safetensors": read_model, "series.csv": read_series,
    "press.frames": read_recording, "loads.csv": lambda path: read_loads(path, SensorDesign()),
}  # fmt: skip


def never(*_, **__):
    raise AssertionError("must not begin")


@pytest.mark.skipif(os.name != "posix", reason="devices and pipes with names are POSIX's")
@pytest.mark.parametrize(("name", "kind"), [*product(READERS, ["a device", "a pipe"])])
def test_what_is_no_regular_file_is_refused_by_every_reader(tmp_path, name, kind):
    """/dev/zero never ends, and a pipe that nobody writes to is never opened."""
    path = tmp_path / name
    if kind == "a pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(TriPillarError, match=f"^{path}: {kind}, no regular file: .+"):
        READERS[name](path)


def test_commands_refuse_what_is_no_regular_file_in_one_line(tmp_path):
    house = House(tmp_path)
    for words in (("response", "--design", "/dev/zero", "--out", "r.nc"), ("replay", "/dev/zero", "--model", "m.x")):
        assert "/dev/zero: a device, no regular file" in house.refusal(*words)


@pytest.mark.parametrize("at", ["99999999_99999999", f"0_{'9' * 5000}", "255_0"])
def test_units_that_a_table_names_are_counted_before_their_columns_are(tmp_path, monkeypatch, at):
    path = tmp_path / "wide.csv"
    names = [name.format(each) for each in ("0_0", at) for name in ("force_{}_z_n", "resistance_{}_z_ohm")]
    path.write_text(f"{','.join(names)}\n1,1,1,1\n")
    monkeypatch.setattr(tables, "columns_of", never)
    with pytest.raises(FileFormatError, match=r"wide\.csv: names \d+ × \d+ units, at most 255 each way"):
        read_samples(path)


def test_numbers_that_a_small_file_only_promises_are_counted_before_they_are_read(tmp_path, monkeypatch):
    """4.8 TB of samples that nobody wrote, in a file of some kB."""
    path, sizes = tmp_path / "vast.nc", {"sample": 10**9, "row": 10, "col": 10, "axis": 3, "pillar": 3}
    with netCDF4.Dataset(path, "w") as file:
        for dim, size in sizes.items():
            file.createDimension(dim, size)
        for name, last in (("force_n", "axis"), ("resistance_ohm", "pillar")):
            file.createVariable(name, "f8", ("sample", "row", "col", last), chunksizes=(100, 10, 10, 3))
    assert path.stat().st_size < 1e5
    monkeypatch.setattr(netcdf, "_values", never)
    with pytest.raises(FileFormatError, match=r"vast\.nc: its numbers take 9600\.0 GB of memory here, .* are free: "):
        read_samples(path)


def test_memory_that_a_table_or_a_recording_would_take_is_asked_for_first(tmp_path, monkeypatch):
    monkeypatch.setattr(bounded, "MEMORY_SHARE", 0.0)
    for name, reader in (("samples.csv", read_samples), ("press.frames", read_recording)):
        (tmp_path / name).write_text("force_0_0_z_n,resistance_0_0_z_ohm\n")
        with pytest.raises(FileFormatError, match=rf"{name}: its \w+ take 0\.0 GB of memory here"):
            reader(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"a = {'[' * 50_000}{']' * 50_000}", "nested more than 100 deep"),
        (f"a = {'{a = ' * 50_000}1{'}' * 50_000}", "nested more than 100 deep"),
        (".".join("a" * 20_000) + " = 1", "a key has more than 16 parts"),
        (f"a = '{'x' * 2_000_000}'", "larger than 2 MB"),
    ],
    ids=["lists", "tables", "keys", "long"],
)
def test_a_design_that_data_state_is_bounded_as_one_in_a_file_is(tmp_path, monkeypatch, text, said):
    path = tmp_path / "deep.nc"
    ones = {"force_n": ("axis", np.ones((1, 1, 1, 3))), "resistance_ohm": ("pillar", np.ones((1, 1, 1, 3)))}
    data = {name: netcdf.Named(("sample", "row", "col", last), values) for name, (last, values) in ones.items()}
    netcdf.write_netcdf(netcdf.Content(data_vars=data, attrs={"design": text}), path)
    monkeypatch.setattr("common.storage.text_file.tomllib.loads", never)
    with pytest.raises(FileFormatError, match=rf"deep\.nc: its attribute 'design': .*{said}"):
        read_samples(path)
    with pytest.raises(DesignError, match=rf"^my\.toml: .*{said}"):
        tables_of(text, "my.toml", DesignError)


def test_a_recording_whose_header_is_nested_deeply_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "deep.frames"
    deep = f"{'[' * 20_000}{']' * 20_000}"
    monkeypatch.setattr("hardware.recording.frames_file.json.dumps", lambda plain: deep)
    Recorder(path, Info(rows=1, cols=1)).close()
    with pytest.raises(RecursionError):
        json.loads(deep)
    with pytest.raises(FileFormatError, match=r"deep\.frames: not a recording of TriPillar"):
        read_recording(path)


def test_rows_above_the_limit_are_not_asked_for(tmp_path, monkeypatch):
    asked = []
    rows = (asked.append(number) or number for number in range(10**9))
    with pytest.raises(FileFormatError, match=r"a\.csv: has more than 1,000 rows, the most that are read: give fewer"):
        list(bounded.counted(rows, 1000, "a.csv", "give fewer"))
    assert len(asked) == 1001
    assert list(bounded.counted(range(1000), 1000, "a.csv", "")) == [*range(1000)]
    monkeypatch.setattr("decoupler.data.load_table.MAX_LOADS", 2)
    monkeypatch.setattr("decoupler.rubber.series.MOST_ROWS", 2)
    for name, header in (("loads.csv", "load,row,col,fz_n"), ("series.csv", "time_s,strain,force_n,resistance_ohm")):
        (tmp_path / name).write_text(f"{header}\n" + 3 * "0,0,0,1\n")
        with pytest.raises(FileFormatError, match=rf"{name}: has more than 2 rows"):
            READERS[name](tmp_path / name)


def unit_of(n, electrodes):
    """Pillars p0 to p(n − 1) between electrodes of a unit in a square."""
    places = [(-1 + 0.2 * (k % 11), -1 + 0.2 * (k // 11)) for k in range(max(electrodes))]
    upper, lower = (
        tuple(Electrode(f"{level}{k}", places[k]) for k in range(count))
        for level, count in zip("UL", electrodes, strict=True)
    )
    pairs = [(k % electrodes[1], (k + k // electrodes[1]) % electrodes[0]) for k in range(n)]
    return {
        "upper": upper,
        "lower": lower,
        "pillars": tuple(Pillar(f"p{k}", f"L{foot}", f"U{top}") for k, (foot, top) in enumerate(pairs)),
    }


@pytest.mark.parametrize(
    ("n", "electrodes", "said"),
    [
        (65, (32, 32), "a unit has more than 64 pillars"),
        (64, (33, 32), "a unit has more than 64 electrodes"),
        (40_000, (20_000, 20_000), "a unit has more than 64 electrodes"),
    ],
)
def test_pillars_and_electrodes_of_a_unit_are_counted_before_any_two_are_compared(monkeypatch, n, electrodes, said):
    assert len(Layout(**unit_of(64, (32, 32))).pillars) == 64
    parts = unit_of(n, electrodes)
    monkeypatch.setattr(layouts, "combinations", never)
    with pytest.raises(DesignError, match=f"^{said}: give fewer"):
        Layout(**parts)


@pytest.mark.parametrize("width_mm", [0.1, 0.01, 0.001, 1e-6])
def test_pillars_that_nobody_can_cast_or_mesh_are_refused(width_mm):
    """Of one width, or one among others; a fiftieth of the height is solved."""
    assert Unit(pillar_width_mm=0.25)
    song = layouts.SONG2018
    z = Pillar("z", "L1", "U1", width_mm=width_mm)
    thin = Layout(upper=song.upper, lower=song.lower, pillars=(z, *song.pillars[1:]))
    for given in ({"pillar_width_mm": width_mm}, {"layout": thin}):
        with pytest.raises(DesignError, match=rf"pillar z is too thin to cast or mesh, {width_mm:g} mm wide and 10 mm"):
            Unit(**given)


def test_a_scheduler_that_says_nothing_is_waited_for_as_long_as_it_may_take(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(pools, "GREETING_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with (
            pytest.raises(DesignError, match=rf"no scheduler at {address} \(.+\): start one"),
            open_pool(None, address),
        ):
            pass
