"""The table of light touches: exact where readings are, at the limit where they are noisy, and said in newtons."""

from dataclasses import replace

import numpy as np
import pytest

from decoupler import NetworkConfig, TrainingConfig, train
from decoupler.data.pairs import Pairs
from decoupler.twin import identify
from tests.decoupler.synthetic_sensor import labelled, response, sensor, softness
from tripillar.pipeline.comparison import TOUCHES_N, touches
from tripillar.pipeline.manufactured import READ, SPECIMEN

SENSOR = sensor(2, 3)
RESPONSE = response(SENSOR)


@pytest.fixture(scope="module")
def rows():
    """Of a net that knows the response, on that sensor and on one that gives 5 % less way and has gains of its own."""
    truth = replace(RESPONSE, influence_mm_per_n=0.95 * RESPONSE.influence_mm_per_n)
    data = labelled(SENSOR, "z", n_samples=200, seed=0)
    model = train(data, "fz", NetworkConfig(hidden=2, feature="inverse"), TrainingConfig(), response=RESPONSE)
    pairs = labelled(SENSOR, "z", n_samples=10, seed=1)
    specimen_ohm = SPECIMEN.apply(pairs.resistance_ohm, np.random.default_rng(0))
    pairs = Pairs.of(replace(pairs, resistance_ohm=specimen_ohm, noise=SPECIMEN.noise))
    identified = identify(pairs, RESPONSE, softness(SENSOR)).decoder
    found = touches({"ours": model.forces}, model, identified, RESPONSE, truth)
    return {row.decoupler: row for row in found}


def test_touches_are_exact_where_readings_are_at_the_limit_where_they_are_noisy_and_known_once_identified(rows):
    """192 readings: their root mean square is known to 5 %, and three times that is allowed."""
    assert max(rows["ours"].exact_n) < TOUCHES_N[0] / 2
    ours, limit = (np.sqrt(np.mean(np.square(rows[name].read_n))) for name in ("ours", "limit of the readings"))
    assert ours < 1.15 * limit
    assert rows["limit of the readings"].exact_n == (0.0, 0.0, 0.0, 0.0)
    untuned, identified, zeroed = (
        rows[f"ours, as made, {how}"] for how in ("untuned", "identified", "identified, zeroed at rest")
    )
    assert untuned.read_n[0] > 3 * identified.read_n[0] > 3 * zeroed.read_n[0]
    assert zeroed.exact_n[0] < TOUCHES_N[0]


def test_it_is_read_as_the_specimen_is():
    assert (READ.noise, READ.bits) == (SPECIMEN.noise, SPECIMEN.bits)
