"""Finite strain: maps of a made-up law come back from samples, derivatives are slopes, the posterior decodes them."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.measurement import measured
from dataset.samples import Samples, joined
from decoupler import SampleError, component_named, train
from decoupler.export.checked import ExportError, export_model
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.specimen import Specimen
from decoupler.inverse.strain_maps import FEW, N_CURVED, N_FEATURES, StrainMaps, neighbours
from decoupler.model.model_file import read_model, write_model
from decoupler.training.finite_strain import with_strain_maps
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR, ALL = sensor(1, 2), component_named("all")
EVEN = response(SENSOR)
#: not its own image in a mirror, as made-up laws are not
RESPONSE = replace(
    EVEN, influence_mm_per_n=EVEN.influence_mm_per_n * np.linspace(1.0, 1.001, 2)[:, None, None, None, None]
)
LINEAR = ForwardModel.of(RESPONSE, ALL)
STATES = labelled(SENSOR, "xyz", n_samples=1200, seed=0).force_n.reshape(1200, -1)
SIZES = np.concatenate([np.full(3, np.std(STATES)), np.std(STATES @ LINEAR.influence) * np.ones(6)])


def law(strength: float) -> ForwardModel:
    """An array whose forces and squared lengths differ from its linear ones by some percent at strength 1."""
    weights = np.zeros((N_FEATURES, 6))
    weights[:N_CURVED] = np.random.default_rng(3).standard_normal((N_CURVED, 6))
    weights *= strength * 2e-4 * np.repeat([np.std(STATES), 100.0], 3)
    maps = StrainMaps(
        influence=LINEAR.influence,
        near=neighbours(1, 2),
        sizes=SIZES,
        weights=weights,
        misfit=np.repeat([0.1, 1e-3], 3),
        growth=np.array([1.0, 0.0]),
    )
    return replace(LINEAR, maps=maps)


def samples(model: ForwardModel, noise: float = 0.0) -> Samples:
    """Samples at finite strain whose states are `STATES`."""
    squares, _, force_n, _ = model.at_states(STATES)
    shape = (len(STATES), 1, 2, 3)
    moved = (STATES @ model.influence).reshape(-1, 3, 2, 2).transpose(0, 2, 3, 1)
    ohms = (model.ohm_per_mm2 * squares).reshape(shape)
    return Samples(
        force_n=force_n.reshape(shape),
        resistance_ohm=measured(ohms, noise, None, np.random.default_rng(0)),
        displacement_mm=moved.reshape(len(STATES), 1, 2, 2, 3),
        length_mm=np.sqrt(squares).reshape(shape),
        strain_model=np.ones(len(STATES)),
        design=SENSOR,
        noise=noise,
    )


def test_maps_are_learned_from_samples():
    """1000 samples leave a hundredth of what the linear response misses on 200 others; left-out errors foretell it."""
    truth = samples(law(1.0))
    found = with_strain_maps(RESPONSE, ALL, truth[:1000])
    assert found.maps is not None
    squares, _, force_n, _ = found.at_states(STATES[1000:])
    true_n = truth.force_n[1000:].reshape(200, -1)
    assert np.std(force_n - true_n) < 0.01 * np.std(STATES[1000:] - true_n)
    lengths = LINEAR.lengths(STATES[1000:])
    true = truth.length_mm[1000:].reshape(200, -1) ** 2
    assert np.std(squares - true) < 0.01 * np.std(lengths**2 - true)
    assert np.sqrt(np.mean(found.maps.misfit_n**2)) == pytest.approx(np.std(force_n - true_n), rel=0.5)
    with pytest.raises(SampleError, match="hold no displacements"):
        with_strain_maps(RESPONSE, ALL, truth.labels())


def test_mirrored_forces_are_known():
    """20 samples of positive Fy teach an array that is its own image, and no other, what negative forces do."""
    weights = np.zeros((N_FEATURES, 6))
    weights[126 * np.arange(3) + 2, np.arange(3)] = [0.1 * STATES.std()] * 3  # products of Gx, Gy, Gz with Gz
    flipped = STATES[100:200] * np.tile([1.0, -1.0, 1.0], 2)
    missed = []
    for given in (EVEN, RESPONSE):
        linear = ForwardModel.of(given, ALL)
        maps = replace(law(0.0).maps, influence=linear.influence, weights=weights)
        truth = replace(linear, maps=maps)
        found = with_strain_maps(given, ALL, samples(truth)[:20])
        off_n = found.maps.forces(flipped) - maps.forces(flipped)
        missed.append(np.std(off_n[:, 1::3]) / np.std(maps.forces(flipped)[:, 1::3] - flipped[:, 1::3]))
    assert missed[0] < 0.02
    assert missed[1] > 0.1


def test_derivatives_are_slopes():
    """Of squares and forces by states, and of squares by the unknowns of a specimen."""
    model, at = law(1.0), STATES[:1]
    _, by_state, _, by_force = model.at_states(at)
    for part, slopes in ((0, by_state), (2, by_force)):
        assert_slopes(lambda x, part=part: model.at_states(x)[part], at, slopes[0], 1e-3)
    changes = np.random.default_rng(1).standard_normal((2, len(FEW), 6)) * 1e-4 * np.repeat([np.std(STATES), 100.0], 3)
    exact = Specimen.as_designed(changes, LINEAR.n_pillars)
    some = np.random.default_rng(2).standard_normal(len(exact.unknowns)) * 1e-3
    specimen = replace(exact, unknowns=some)

    def shown(unknowns: np.ndarray) -> np.ndarray:
        """Squares as a sensor of the specimen's gains and offsets shows them under the same forces."""
        other = [replace(exact, unknowns=x) for x in unknowns]
        rest = LINEAR.lengths(np.zeros((1, 6)))[0] ** 2
        gain, offset, *_ = specimen.parts
        squares = [(1 + o.parts[0]) * o.model(model).lengths(forces)[0] ** 2 + o.parts[1] * rest for o in other]
        return (np.array(squares) - offset * rest) / (1 + gain)

    own = specimen.model(model)
    forces = own.at_states(at)[2]
    assert_slopes(shown, some[None], specimen.derivatives(own, at)[0], 1e-4)


def assert_slopes(function, point, slopes, size):
    step = size * np.eye(point.shape[1])
    found = (function(point + step) - function(point - step)) / (2 * size)
    np.testing.assert_allclose(found.T, slopes, atol=1e-5 * np.abs(slopes).max())


def test_states_are_found_and_rest_is_rest():
    maps = law(1.0).maps
    assert maps is not None
    np.testing.assert_allclose(maps.states(maps.forces(STATES[:20])), STATES[:20], atol=1e-6)
    assert not maps.forces(np.zeros((1, 6))).any()
    assert np.array_equal(maps.forces(STATES[3:4])[0], maps.forces(STATES[:7])[3])  # alone and in a batch


def test_forces_beyond_the_samples_are_refused():
    """Fz = Gz − Gz² / s has no Gz for Fz above s / 4."""
    maps = law(0.0).maps
    assert maps is not None
    weights = maps.weights.copy()
    weights[2 * 126 + 2, 2] = -SIZES[2]  # of the pressing force, squared
    with pytest.raises(SampleError, match="beyond its samples"):
        replace(maps, weights=weights).states(np.tile([0.0, 0.0, SIZES[2]], (1, 2)))


def test_training_takes_the_posterior_of_what_it_learned(tmp_path):
    """Joined with linear samples: errors are those of the noise, deviations hold them, the file keeps the same bits."""
    truth = samples(law(1.0), noise=1e-3)
    linear = replace(samples(law(0.0), noise=1e-3), strain_model=np.zeros(1200))[:20]
    model = train(joined([linear, truth[:1000]]), response=RESPONSE)
    ohms, force_n = truth.resistance_ohm[1000:], truth.force_n[1000:]
    error_n = np.abs(model.forces(ohms) - force_n)
    one, two = model.half_widths(ohms)
    assert np.std(model.first_answers(model.columns(ohms)) - force_n.reshape(200, -1)) > 1.2 * np.std(error_n)
    assert 0.6 < (error_n < one).mean() < 0.8
    assert 0.92 < (error_n < two).mean() < 0.99
    assert np.array_equal(model.forces(ohms[7:8])[0], model.forces(ohms)[7])
    write_model(model, tmp_path / "model.safetensors")
    assert np.array_equal(read_model(tmp_path / "model.safetensors").forces(ohms), model.forces(ohms))
    with pytest.raises(ExportError, match="not exported yet"):
        export_model(model, tmp_path / "model.h")


def test_other_sensors_are_not_joined():
    one, other = (labelled(sensor(1, cols), "xyz", n_samples=3, seed=0) for cols in (1, 2))
    with pytest.raises(SampleError, match="data set 2 has another design"):
        joined([one, other])
