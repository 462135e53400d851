"""The bench of trained nets on a small array: errors and times of every kind; no time is asserted."""

from decoupler import NetworkConfig
from studies.bench import inference
from tests.decoupler.synthetic_sensor import response, sensor


def test_measures_errors_and_times(monkeypatch):
    monkeypatch.setattr(inference, "SAMPLES", {"train": (60, 1), "test": (20, 2)})
    monkeypatch.setattr(inference, "WARM_UP_S", 0.0)
    monkeypatch.setattr(inference, "REPEATS", {1: 2, inference.MANY: 1})
    found = inference.measure(response(sensor(2, 2)), "three-axis", "all", NetworkConfig(hidden=2, feature="inverse"))
    assert set(found.full_scale_pct) == {"fx", "fy", "fz"}
    assert all(error < 1.0 for error in found.full_scale_pct.values())  # it starts from the response of these very data
    assert min(found.scan_us, found.batch_ms, found.training_s) > 0
