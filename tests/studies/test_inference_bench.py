"""The bench of trained nets on a small array: errors and times of every kind; no time is asserted."""

from decoupler import NetworkConfig
from studies.bench import inference
from tests.decoupler.synthetic_sensor import response, sensor


def test_measures_errors_and_times(monkeypatch):
    monkeypatch.setattr(inference, "WARM_UP_S", 0.0)
    monkeypatch.setattr(inference, "REPEATS", {1: 2, inference.MANY: 1})
    samples = {"train": (60, 1), "test": (20, 2)}
    network = NetworkConfig(hidden=2, feature="inverse")
    found = inference.trained_and_timed(response(sensor(2, 2)), "three-axis", "all", network, samples)
    assert set(found.errors) == {f"{name} [% of full scale]" for name in ("fx", "fy", "fz")}
    assert all(error < 1.0 for error in found.errors.values())  # it starts from the response of these very data
    assert min(*found.seconds.values(), *found.notes.values()) > 0
