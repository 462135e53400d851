"""A data set and a model, each made in milliseconds; their readers."""

from pathlib import Path

from dataset import DatasetSettings, read_samples, simulate
from decoupler import NetworkConfig, TrainingConfig, read_model, train, write_model
from geometry import Array, SensorDesign
from tests.dataset.conftest import made_up_response
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SMALL = sensor(1, 2)


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
