"""One file of every kind that is written and read back, each made in milliseconds."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from dataset import DatasetSettings, read_samples, simulate
from decoupler import NetworkConfig, TrainingConfig, read_model, train, write_model
from fem.array import substructured
from fem.array.cell import CondensedCell, PortModes
from fem.array.response import read_response, write_response
from geometry import Array, SensorDesign
from geometry.mesh import TetMesh, read_mesh, write_mesh
from geometry.storage.journal import Journal
from hardware.readout.calibration import SensorCalibration, read_calibration, write_calibration
from studies.paper.results import Results, read_results, write_results
from tests.dataset.conftest import made_up_response
from tests.decoupler.synthetic_sensor import labelled, response, sensor
from tripillar.sweep.rows import Row

SMALL = sensor(1, 2)


def a_mesh(path: Path):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    write_mesh(TetMesh(points, np.array([[0, 1, 2, 3], [4, 2, 1, 3]]), np.array([0, 1]), "recipe"), path)
    return read_mesh


def a_cell(path: Path):
    matrices = {name: np.random.default_rng(0).normal(size=(6, 6)) for name in substructured.MATRICES}
    cell = CondensedCell(ports=PortModes(7.5, 10.0, 2, 2), **matrices, unknowns=100, residual=1e-12)
    substructured.write_refined(
        substructured.RefinedCell(cells=((1.0, {(): cell}),), error_estimate=1e-3, steps=("one", "two")), path
    )
    return substructured.read_refined


def a_response(path: Path):
    write_response(response(SMALL), path)
    return read_response


def a_dataset(path: Path, samples: int = 4, pitch_mm: float = 15.0):
    settings = DatasetSettings(
        protocol="contact", samples=samples, seed=3, noise=0.001, bits=16, dead_pillars=((0, 1, "z"),)
    )
    design = SensorDesign(array=Array(rows=1, cols=2, pitch_mm=pitch_mm))
    simulate(made_up_response(design), settings).write(path)
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
    row = Row(cache_key=path.stem, values={"pad.size_mm": 9.0}, design="x", metrics={"error_n": 1.5})
    Journal(path.parent).keep(path.stem, vars(row))
    return lambda path: Journal(path.parent).read(path.stem, lambda plain: Row(**plain))


def results(path: Path):
    lists = {"data_sets": [], "results": [], "shown": []}
    numbers = {spec.name: 2 for spec in fields(Results) if spec.name not in lists}
    write_results(Results(**numbers | lists), "r", path)
    return lambda path: read_results(path, "r", Results)


KINDS = {
    "mesh.vtu": a_mesh, "cell.npz": a_cell, "response.nc": a_response, "dataset.nc": a_dataset,
    "model.safetensors": a_model, "calibration.json": a_calibration, "row.json": a_row, "results.json": results,
}  # fmt: skip
