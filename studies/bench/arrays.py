"""``python -m studies.bench.arrays``: time and memory of array responses from 2 × 2 to 48 × 48, and of each way there.

Every response is computed in a process of its own, without cache. Where `references.json` has columns of an array's
response, the error against them is given for the loaded unit and its first neighbours.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from fem.array.unit_check import meshed_response
from fem.fields.array_field import array_field
from fem.scene.scene import Sensor
from fem.scene.solution import largest_error
from geometry.design import Array, Material, SensorDesign
from geometry.layout import FloatArray, pad_squares
from geometry.mesh import sensor_mesh, suited_settings
from studies.bench.reference import read_reference
from studies.bench.scenes import small_array_scenes
from studies.bench.whole_grid import whole_grid_response
from tripillar.sweep.memory import peak_mib
from tripillar.terminal.console import wrote
from tripillar.terminal.entry import run_alone
from tripillar.terminal.tables import show
from tripillar.terminal.writing import write_json

REFERENCES = Path(__file__).with_name("references.json")
#: name, units a side, settings of the response (or the level of one grid of the whole slab, or how the whole array is
#: meshed), matrix's modulus [MPa]
CASES: list[tuple[str, int, dict[str, Any], float]] = [
    *[("cells", n, {"tolerance": 1e-3}, 6.1) for n in (2, 6, 12, 24, 48)],
    ("cells, 1e-2", 6, {"tolerance": 1e-2}, 6.1),
    *[("whole array, same hexahedra, level 1", n, {"level": 1}, 6.1) for n in (2, 6)],
    ("whole array, same hexahedra, level 2", 6, {"level": 2}, 6.1),
    ("whole array, Taylor-Hood", 2, {"mesh": suited_settings}, 6.1),
    ("whole array, Taylor-Hood", 6, {"mesh": suited_settings}, 6.1),
    ("layer", 6, {"method": "layer"}, 6.1),
    ("half-space", 6, {"method": "halfspace"}, 6.1),
    *[("cells, soft matrix", n, {"tolerance": 1e-2}, 1.0) for n in (2, 6, 12)],
    ("whole array, Taylor-Hood, soft matrix", 6, {"mesh": suited_settings}, 1.0),
]
REFERRED = {(6, 6.1): "response", (2, 1.0): "oblique"}  #: units and modulus → how its reference's scenes begin


def designed(units: int, matrix_mpa: float) -> SensorDesign:
    """The paper's sensor with so many units a side and a matrix of another modulus."""
    return SensorDesign(array=Array(rows=units, cols=units), matrix_material=Material(young_mpa=matrix_mpa))


def errors(influence: FloatArray, name: str = "response") -> dict[str, float]:
    """Error of a response against its stored columns: of the loaded unit and of its first neighbours, relative."""
    scenes = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"]
    rows, cols = influence.shape[:2]
    found: dict[str, float] = {}
    for place, (row, col) in {"inner": (rows // 2, cols // 2), "edge": (0, cols // 2), "corner": (0, 0)}.items():
        for axis, letter in enumerate("xyz"):
            probes = scenes.get(f"{name}-{place}-{letter}", {}).get("probes", {})
            for key, near in {"self": 0, "first": 1}.items():
                for i, j in np.ndindex(rows, cols):
                    if abs(i - row) + abs(j - col) != near or f"{i * cols + j}-U1" not in probes:
                        continue
                    exact = np.array([probes[f"{i * cols + j}-U{k}"] for k in (1, 2)])
                    misfit = np.linalg.norm(influence[i, j, :, :, row, col, axis] - exact) / np.linalg.norm(exact)
                    label = f"{place} {key}"
                    found[label] = max(found.get(label, 0.0), float(misfit))
    return found


def field_error(name: str) -> float:
    """Largest relative error of `array_field` at the stored points inside a small array, of the scene's name."""
    scene = small_array_scenes()[name]
    assert isinstance(scene.body, Sensor)
    design = scene.body.design
    squares = pad_squares(design)
    centres = np.column_stack([(squares[:, :2] + squares[:, 2:]) / 2, np.zeros(design.n_units)])
    unit = [int(probe.name.split("-")[0]) for probe in scene.probes]
    points = np.array([probe.position_mm for probe in scene.probes]) - centres[unit]
    field = array_field(design)
    moved = field.observe(points).displacement_mm(field.state(scene.tractions_mpa))
    found = {probe.name: moved[unit[k], k] for k, probe in enumerate(scene.probes)}
    return largest_error(found, read_reference(name).probes)


def measure_one(number: int) -> None:
    """Compute one case here and print what it took, as JSON."""
    from fem.array.solving import ResponseSettings, solve_response

    _, units, settings, matrix_mpa = CASES[number]
    design = designed(units, matrix_mpa)
    if "level" in settings:
        response = whole_grid_response(design, **settings)
    elif "mesh" in settings:
        response = meshed_response(design, sensor_mesh(design, settings["mesh"](design))[0])
    else:
        response = solve_response(design, ResponseSettings(**settings))
    referred = REFERRED.get((units, matrix_mpa))
    found = {
        "seconds": response.seconds,
        "unknowns": response.unknowns,
        "estimate": None if np.isnan(response.error_estimate) else response.error_estimate,
        "residual": response.residual,
        "peak_mib": peak_mib(),
        "errors": errors(response.influence_mm_per_n, referred) if referred else {},
    }
    print(json.dumps(found))


def bench(
    out: Annotated[Path, typer.Option(help="JSON file to write.")] = Path("out/bench/arrays.json"),
    only: Annotated[str, typer.Option(help="Cases whose name holds this.")] = "",
    one: Annotated[int | None, typer.Option(hidden=True)] = None,
) -> None:
    """Measure every case, each in a fresh process with two threads and an empty cache."""
    if one is not None:
        measure_one(one)
        return
    rows = []
    table = Table(title="Array responses, everything included, nothing cached")
    for title in ("way", "units", "seconds", "of which", "MiB", "estimate", "error against the reference"):
        table.add_column(title)
    for number, (name, units, settings, matrix_mpa) in enumerate(CASES):
        if only not in name:
            continue
        with tempfile.TemporaryDirectory() as cache:
            done = subprocess.run(
                [sys.executable, "-m", "studies.bench.arrays", "--one", str(number)],
                capture_output=True,
                text=True,
                env=os.environ | {"TRIPILLAR_CACHE": cache, "OMP_NUM_THREADS": "2"},
            )
        if done.returncode:
            print(f"{name}, {units} × {units}: {done.stderr.strip().splitlines()[-1]}", file=sys.stderr)
            continue
        found = json.loads(done.stdout)
        rows.append({"name": name, "units": units, "settings": settings, "matrix_mpa": matrix_mpa} | found)
        total = sum(found["seconds"].values())
        parts = ", ".join(f"{step} {seconds:.1f}" for step, seconds in found["seconds"].items())
        judged = ", ".join(f"{place} {error:.1e}" for place, error in found["errors"].items())
        estimate = "" if found["estimate"] is None else f"{found['estimate']:.1e}"
        table.add_row(name, f"{units} × {units}", f"{total:.1f}", parts, f"{found['peak_mib']:.0f}", estimate, judged)
        print(f"{name}, {units} × {units}: {total:.1f} s", file=sys.stderr)
    show(table)
    write_json(rows, out)
    wrote([out])


if __name__ == "__main__":
    run_alone(bench)
