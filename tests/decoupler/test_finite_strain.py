"""Forces at finite strain: a law of the learned form comes back, derivatives are slopes, rest stays rest."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.samples import joined
from decoupler import SampleError, component_named, train
from decoupler.data.columns import force_columns
from decoupler.export.checked import ExportError, export_model
from decoupler.inverse.effective_forces import N_FEATURES, EffectiveForces, neighbours
from decoupler.inverse.forward_model import ForwardModel, ModelInverse
from decoupler.inverse.limits import exact_inverse
from decoupler.model.model_file import read_model, write_model
from decoupler.training.finite_strain import at_finite_strain
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(1, 2)
LINEAR = ForwardModel.of(response(SENSOR), component_named("all"))
FORCES = force_columns(labelled(SENSOR, "xyz", n_samples=1200, seed=0).force_n, component_named("all"))
SIZES = np.concatenate([np.full(3, np.std(FORCES)), np.std(FORCES @ LINEAR.influence) * np.ones(6)])


def law(strength: float) -> ForwardModel:
    """An array whose effective forces differ from those that act by a random law, a few percent at strength 1."""
    weights = np.random.default_rng(3).standard_normal((N_FEATURES, 3))
    weights *= strength * 2e-4 * np.std(FORCES)
    found = EffectiveForces(
        influence=LINEAR.influence, near=neighbours(1, 2), sizes=SIZES, weights=weights, misfit_n=np.zeros(3)
    )
    return replace(LINEAR, correction=found)


def test_law_is_learned_from_samples():
    """1000 samples leave a hundredth of what the linear response misses on 200 others; left-out errors foretell it."""
    ohms = law(1.0).resistances(FORCES)
    found = at_finite_strain(LINEAR, (1, 2), ohms[:1000], FORCES[:1000]).correction
    assert found is not None
    effective_n = exact_inverse(LINEAR, ohms[1000:], FORCES.mean(axis=0))
    learned, missed = (np.std(each - FORCES[1000:]) for each in (found.actual(effective_n), effective_n))
    assert learned < 0.01 * missed
    assert np.sqrt(np.mean(found.misfit_n**2)) == pytest.approx(learned, rel=0.5)


def test_derivatives_are_slopes():
    """Of forces by effective ones, of lengths by forces, of forces by resistances; differences of 1e-3 N and Ω."""
    model = law(1.0)
    assert model.correction is not None
    inverse = ModelInverse.about(model, FORCES[:50], np.ones(model.n_pillars, dtype=bool), 0.0)
    ohms, at = model.resistances(FORCES[:1]), FORCES[:1]
    cases = [
        (model.correction.actual, at, model.correction.jacobian(at)[1]),
        (model.lengths, at, model.jacobian(at)[1]),
        (inverse.forces, ohms, inverse.derivatives(ohms)),
    ]
    for function, point, slopes in cases:
        step = 1e-3 * np.eye(point.shape[1])
        found = (function(point + step) - function(point - step)) / 2e-3
        np.testing.assert_allclose(found.T, slopes[0], atol=1e-6 * np.abs(slopes).max())


def test_effective_forces_are_turned_around_and_rest_is_rest():
    model = law(1.0).correction
    assert model is not None
    np.testing.assert_allclose(model.actual(model.effective(FORCES[:20])), FORCES[:20], atol=1e-7)
    assert not model.actual(np.zeros((1, LINEAR.n_forces))).any()
    assert np.array_equal(model.actual(FORCES[3:4])[0], model.actual(FORCES[:7])[3])  # alone and in a batch


def test_forces_beyond_the_samples_are_refused():
    """Fz = Gz − Gz² / s has no Gz for Fz above s / 4."""
    found = law(0.0).correction
    assert found is not None
    weights = found.weights.copy()
    weights[2 * 126 + 2, 2] = -SIZES[2]  # of the pressing force, squared
    with pytest.raises(SampleError, match="beyond its samples"):
        replace(found, weights=weights).effective(np.tile([0.0, 0.0, SIZES[2]], (1, 2)))


def test_training_joins_linear_samples_and_some_at_finite_strain(tmp_path):
    """On samples at finite strain the net errs less than a tenth of one of linear samples; the file keeps it."""
    loads = labelled(SENSOR, "xyz", n_samples=1200, seed=0)
    ohms = law(1.0).resistances(FORCES).reshape(loads.force_n.shape)
    finite = replace(loads, resistance_ohm=ohms, strain_model=np.ones(len(loads)))
    model, linear = (train(data, response=response(SENSOR)) for data in (joined([loads[:200], finite[:1000]]), loads))
    errors, missed = (np.std(each.forces(ohms[1000:]) - loads.force_n[1000:]) for each in (model, linear))
    assert errors < 0.1 * missed
    write_model(model, tmp_path / "model.safetensors")
    back = read_model(tmp_path / "model.safetensors")
    assert np.array_equal(back.forces(ohms[1000:]), model.forces(ohms[1000:]))
    with pytest.raises(ExportError, match="not exported yet"):
        export_model(model, tmp_path / "model.h")


def test_other_sensors_are_not_joined():
    one, other = (labelled(sensor(1, cols), "xyz", n_samples=3, seed=0) for cols in (1, 2))
    with pytest.raises(SampleError, match="data set 2 has another design"):
        joined([one, other])
