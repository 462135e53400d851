"""Bits flipped anywhere in every kind of file that is written and read back: refused, or the same content."""

import random
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from dataset import DatasetSettings, read_samples, simulate
from decoupler import NetworkConfig, TrainingConfig, read_model, train, write_model
from fem.array import cell_file
from fem.array.cell import CondensedCell
from fem.array.port_modes import PortModes
from fem.array.response import read_response, write_response
from geometry import FileFormatError, SensorDesign
from geometry.mesh import TetMesh, read_mesh, write_mesh
from geometry.storage.seal import MARK
from hardware.readout.calibration import SensorCalibration, read_calibration, write_calibration
from studies.paper.results import Results
from studies.paper.storage import read_results, write_results
from tests.dataset.conftest import made_up_response
from tests.decoupler.synthetic_sensor import labelled, response, sensor
from tripillar.sweep.rows import Row, read_row, write_row

FLIPS = 400
SMALL = sensor(1, 2)


def flat(found):
    """All that was read as bytes and texts, to be compared bit by bit."""
    if isinstance(found, np.ndarray):
        return found.dtype.str, found.shape, found.tobytes()
    if hasattr(found, "__dataclass_fields__"):
        return [flat(getattr(found, spec.name)) for spec in fields(found)]
    return repr(found)


def a_mesh(path: Path):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    write_mesh(TetMesh(points, np.array([[0, 1, 2, 3], [4, 2, 1, 3]]), np.array([0, 1]), "recipe"), path)
    return read_mesh


def a_cell(path: Path):
    matrices = {name: np.random.default_rng(0).normal(size=(6, 6)) for name in cell_file.MATRICES}
    cell = CondensedCell(ports=PortModes(7.5, 10.0, 2, 2), **matrices, unknowns=100, residual=1e-12)
    cell_file.write_refined(cell_file.RefinedCell(cell=cell, error_estimate=1e-3, steps=("one", "two")), path)
    return cell_file.read_refined


def a_response(path: Path):
    write_response(response(SMALL), path)
    return read_response


def a_dataset(path: Path, samples: int = 4):
    settings = DatasetSettings(
        protocol="contact", samples=samples, seed=3, noise=0.001, bits=16, dead_pillars=((0, 1, "z"),)
    )
    simulate(made_up_response(SMALL), settings).write(path)
    return read_samples


def a_model(path: Path):
    data = labelled(SMALL, "xyz", n_samples=40, seed=0)
    config = NetworkConfig(hidden=2, feature="inverse")
    write_model(train(data, "all", config, TrainingConfig(max_iterations=1), response=response(SMALL)), path)
    return read_model


def a_calibration(path: Path):
    write_calibration(SensorCalibration.as_designed(1, 2), path)
    return read_calibration


def a_row(path: Path):
    row = Row(recipe=path.stem, values={"pad.size_mm": 9.0}, design="x", figures={"error_n": 1.5})
    write_row(row, path.parent)
    return lambda path: read_row(path.parent, path.stem)


def results(path: Path):
    lists = {"data_sets": [], "results": [], "shown": []}
    numbers = {spec.name: 2 for spec in fields(Results) if spec.name not in lists}
    write_results(Results(**numbers | lists), "r", path)
    return lambda path: read_results(path, "r", Results)


KINDS = {
    "mesh.vtu": a_mesh, "cell.npz": a_cell, "response.nc": a_response, "dataset.nc": a_dataset,
    "model.safetensors": a_model, "calibration.json": a_calibration, "row.json": a_row, "results.json": results,
}  # fmt: skip


def read_or_refused(read, path: Path):
    """What a file holds, None if it is refused in one line that names it; any other error is a failure."""
    try:
        return read(path)
    except FileFormatError as error:
        said = str(error)
    assert str(path) in said
    assert "\n" not in said
    return None


@pytest.mark.parametrize("name", KINDS)
def test_flipped_bits_are_refused_or_change_nothing(name, tmp_path):
    """400 bits at random with a seed, and all of the mark that says where the hash is. `None`: it is made anew."""
    path = tmp_path / name
    read = KINDS[name](path)
    whole, good = path.read_bytes(), flat(read(path))
    bits = random.Random(7).sample(range(8 * len(whole)), FLIPS)
    mark = whole.rfind(MARK)
    bits += range(8 * mark, 8 * (mark + len(MARK))) if mark >= 0 else []
    refused = 0
    for bit in bits:
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        found = read_or_refused(read, path)
        assert found is None or flat(found) == good, f"bit {bit} changes what is read"
        refused += found is None
    assert refused > 0.9 * FLIPS  # the few others fell on the mark, or on blanks and names of no meaning in JSON


def test_a_cached_response_is_made_anew_if_damaged(tmp_path, caplog):
    """One line names the file; the answer is that of an intact cache."""
    from fem.array.solving import ResponseSettings, array_response

    settings = ResponseSettings(method="layer")
    design = SensorDesign(array=SMALL.array)
    first, path, _ = array_response(design, settings)
    assert array_response(design, settings)[2]
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
    again, _, reused = array_response(design, settings)
    assert not reused
    assert np.array_equal(again.influence_mm_per_n, first.influence_mm_per_n)
    assert caplog.messages == [f"{path} is damaged or of an earlier version: it is made anew."]
    assert array_response(design, settings)[2]
