"""Readers × files that were damaged at random: each is read, or refused in one line; none crashes, none grows."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import psutil
import pytest
import trimesh

from common.errors import TriPillarError
from dataset.stored import read_samples
from dataset.table import read_csv
from decoupler import NetworkConfig, TrainingConfig, train, write_model
from decoupler.data.load_table import read_loads, read_pairs
from decoupler.model_file import read_model
from decoupler.rubber.fit import identified
from decoupler.rubber.rubber_file import read_rubber, write_rubber
from decoupler.rubber.series import read_series
from decoupler.twin.twin_file import read_twin
from fem.array.response import read_response, write_response
from fem.contact import read_solid
from fem.scene.scene_file import read_scene
from geometry.design_file import design_to_toml, read_design
from hardware.link.frames import Info
from hardware.readout.calibration import SensorCalibration, read_calibration, write_calibration
from hardware.recording.frames_file import read_recording
from tests.decoupler.synthetic_sensor import labelled, response, sensor
from tests.decoupler.test_rubber import bench
from tests.hardware.boards import recording_from_resistances
from tripillar.sweeps.sweep_file import read_sweep

SENSOR = sensor(1, 2)
DATA = labelled(SENSOR, "xyz", 12, seed=0)
ROOT = Path(__file__).parents[1]
GROWN_MB = 300  #: of a process by all examples of a reader
#: what is put into a file: numbers that are none, sizes that are none, marks of other formats
TOKENS = [
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e308",
    b"1e-300",
    b"99999999999",
    b",",
    b";",
    b"\t",
    b"\n",
    b'"',
    b"'",
    b"[",
    b"]",
]
TOKENS += [b"{", b"}", b"=", b"#", b"\0", b"\xff\xfe", b"\xff\xff\xff\xff", b"\x80", b"true", b"[[unit]]", b"../x", b""]


def table(rows: int, columns: dict[str, Callable[[int], float]]) -> bytes:
    lines = [",".join(columns), *(",".join(f"{of(k):.6g}" for of in columns.values()) for k in range(rows))]
    return "\n".join([*lines, ""]).encode()


def by_writing(write: Callable[[Path], object], suffix: str) -> Callable[[Path], bytes]:
    def content(folder: Path) -> bytes:
        path = folder / f"sound{suffix}"
        write(path)
        return path.read_bytes()

    return content


def of_readings() -> dict[str, Callable[[int], float]]:
    return {f"r_0_{col}_{p}": lambda k: 9e3 + k for col in range(2) for p in "zxy"}


def of_samples() -> bytes:
    places = [(col, kind) for col in range(2) for kind in "zxy"]
    columns = {f"resistance_0_{col}_{pillar}_ohm": lambda k: 9e3 + k for col, pillar in places}
    return table(12, columns | {f"force_0_{col}_{axis}_n": lambda k: 1.0 + k for col, axis in places})


def of_pairs() -> bytes:
    return table(5, {"load": float, "row": lambda _: 0, "col": lambda _: 1, "fz_n": lambda k: 5.0 * k} | of_readings())


def model(path: Path) -> None:
    write_model(train(DATA, "all", NetworkConfig(hidden=2), TrainingConfig(max_iterations=2)), path)


def strip() -> bytes:
    return table(300, {
        "time_s": lambda k: 0.1 * k, "strain": lambda k: 0.1 * np.sin(0.1 * k) ** 2,
        "force_n": lambda k: 2.0 * np.sin(0.1 * k) ** 2, "resistance_ohm": lambda k: 1e4 + 1e3 * np.sin(0.1 * k) ** 2,
    })  # fmt: skip


def ball(kind: str) -> Callable[[Path], bytes]:
    def content(_: Path) -> bytes:
        found = trimesh.creation.icosphere(subdivisions=0, radius=5.0).export(file_type=kind)
        return found.encode() if isinstance(found, str) else found

    return content


#: suffix, sound content, reader
READERS: dict[str, tuple[str, Callable[[Path], bytes], Callable[[Path], object]]] = {
    "design": (".toml", lambda _: design_to_toml(SENSOR).encode(), read_design),
    "twin": (".toml", lambda _: (design_to_toml(SENSOR) + '\n[twin]\ndecoder = "x"\n').encode(), read_twin),
    "scene": (".toml", lambda _: next((ROOT / "scenes").glob("*.toml")).read_bytes(), read_scene),
    "sweep": (".toml", lambda _: (ROOT / "examples" / "finger.toml").read_bytes(), read_sweep),
    "samples": (".nc", by_writing(DATA.write, ".nc"), lambda path: read_samples(path)[:]),
    "table": (".csv", lambda _: of_samples(), read_csv),
    "loads": (
        ".csv",
        lambda _: b"load,kind,row,col,fz_n\n" + 5 * b"a,pad,0,1,10 N\n",
        lambda path: read_loads(path, SENSOR),
    ),
    "pairs": (".csv", lambda _: of_pairs(), lambda path: read_pairs(path, SENSOR)),
    "series": (".csv", lambda _: strip(), read_series),
    "rubber": (
        ".toml",
        by_writing(lambda path: write_rubber(identified(bench(seed=0, rate_hz=0.2)), path), ".toml"),
        read_rubber,
    ),
    "model": (".safetensors", by_writing(model, ".safetensors"), read_model),
    "response": (".nc", by_writing(lambda path: write_response(response(SENSOR), path), ".nc"), read_response),
    "calibration": (
        ".json",
        by_writing(lambda path: write_calibration(SensorCalibration.as_designed(1, 2), path), ".json"),
        read_calibration,
    ),
    "recording": (
        ".frames",
        lambda _: recording_from_resistances(np.full((5, 1, 2, 3), 1e4), replace(Info(), rows=1, cols=2)),
        lambda path: read_recording(path).counts,
    ),
    **{f"tool as {kind}": (f".{kind}", ball(kind), read_solid) for kind in ("stl", "obj", "ply")},
}

EDITS = ["byte", "cut", "token", "again", "end"]


def damaged(content: bytes, generator: np.random.Generator) -> bytes:
    """A file's content after one to six edits, each anywhere."""
    for _ in range(generator.integers(1, 7)):
        kind, byte, count = EDITS[generator.integers(len(EDITS))], generator.integers(256), generator.integers(1, 41)
        at = generator.integers(len(content), endpoint=True)
        into = {"byte": bytes([byte]), "token": TOKENS[byte % len(TOKENS)], "again": content[at : at + 5 * count]}
        behind = {"byte": 1, "cut": count, "token": count % 8, "again": 0, "end": len(content)}[kind]
        content = content[:at] + into.get(kind, b"") + content[at + behind :]
    return content


@cache
def sound(name: str, folder: Path) -> bytes:
    return READERS[name][1](folder)


@pytest.mark.parametrize("examples", [50, pytest.param(40_000, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_in_one_line(name, examples, tmp_path, monkeypatch):
    suffix, _, reader = READERS[name]
    content, path, before = sound(name, tmp_path), tmp_path / f"damaged{suffix}", psutil.Process().memory_info().rss
    monkeypatch.chdir(tmp_path)
    said = list[str]()
    path.write_bytes(content)
    reader(path) if name != "twin" else None

    for number in range(examples):
        path.write_bytes(damaged(content, np.random.default_rng(number)))
        try:
            reader(path)
        except TriPillarError as refused:
            said.append(str(refused))
    assert not [line for line in said if len(line.splitlines()) != 1]
    assert psutil.Process().memory_info().rss - before < GROWN_MB * 2**20
