"""The limits of readings: two routes to each bound, an estimator that meets it, and what cannot be known."""

import numpy as np
import pytest

from dataset.measurement import ReadingError
from decoupler import component_named
from decoupler.data.columns import force_columns, pillar_columns
from decoupler.inverse.limits import bayes, cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from tests.decoupler.synthetic_sensor import labelled, response, sensor

SENSOR = sensor(2, 3)
ALL = component_named("all")
FORWARD = SensorModel.of(response(SENSOR), ALL)
DATA = labelled(SENSOR, "xyz", n_samples=150, seed=0)
FORCES, COLUMNS = force_columns(DATA.force_n, ALL), pillar_columns(DATA.resistance_ohm, ALL, DATA.layout)
NOISE = 0.002
READ = ReadingError(noise=NOISE), DATA.shape


def test_bound_is_the_inverse_of_the_information_in_resistances():
    """By ohms instead of lengths, from derivatives of R = c l²; rounding of a condition near 100."""
    lengths, J = FORWARD.jacobian(FORCES[:5])
    by_ohm = 2.0 * (FORWARD.ohm_per_mm2 * lengths)[..., None] * J
    errors = ReadingError(noise=NOISE, bits=12)
    weighted = by_ohm / errors.deviation(COLUMNS[:5])[..., None]
    information = weighted.swapaxes(1, 2) @ weighted
    expected = np.sqrt(np.einsum("nff->nf", np.linalg.inv(information)))
    np.testing.assert_allclose(cramer_rao(FORWARD, FORCES[:5], errors, DATA.shape), expected, rtol=1e-9)
    assert not cramer_rao(FORWARD, FORCES[:3], ReadingError(), DATA.shape).any()


def test_newtons_step_on_noisy_readings_meets_the_bound():
    """From the true forces one step suffices, to first order. Of 2700 errors the size is known to 1.4 %."""
    noisy = COLUMNS * (1.0 + NOISE * np.random.default_rng(1).standard_normal(COLUMNS.shape))
    lengths, J = FORWARD.jacobian(FORCES)
    errors = np.linalg.solve(J, (FORWARD.lengths_of(noisy) - lengths)[..., None])[..., 0]
    ratio = errors / cramer_rao(FORWARD, FORCES, *READ)
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.05)


def test_knowing_the_usual_loads_helps_and_most_where_noise_is_large():
    """Bayes' bound lies below the other, meets it without noise and the forces' own spread with endless noise."""
    read = [(ReadingError(noise=noise), DATA.shape) for noise in (1e-5, 0.05, 1e3)]
    small, some, large = (bayes(FORWARD, FORCES, *each) for each in read)
    np.testing.assert_allclose(small, cramer_rao(FORWARD, FORCES, *read[0]), rtol=0.01)
    assert (some < cramer_rao(FORWARD, FORCES, *read[1])).all()
    np.testing.assert_allclose(large, np.broadcast_to(FORCES.std(axis=0), large.shape), rtol=0.01)


def test_fewer_pillars_than_forces_determine_nothing_without_the_usual_loads():
    readable = np.ones(FORWARD.n_pillars, dtype=bool)
    readable[0] = False
    assert np.isinf(cramer_rao(FORWARD, FORCES, *READ, readable)).all()
    healthy, hurt = bayes(FORWARD, FORCES, *READ), bayes(FORWARD, FORCES, *READ, readable)
    assert (hurt >= healthy * (1 - 1e-9)).all()
    assert (hurt < 1.001 * FORCES.std(axis=0).max()).all()
    assert hurt[:, :3].max() > 10 * healthy[:, :3].max()  # the unit whose z pillar is gone
