"""Files that go wrong in the usual ways are noticed and named; honest ones, however poor, are not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from dataset import Imperfections, Samples
from decoupler.data.columns import COMPONENTS, component_named
from decoupler.evaluation.plausibility import disturbance, doubt, explained, nothing_to_learn
from decoupler.inverse.sensor_model import SensorModel
from geometry.design import Unit
from geometry.layout import Electrode, Layout, Pillar
from tests.decoupler.synthetic_sensor import labelled, response, sensor

ALL = component_named("all")
SENSOR = sensor(3, 3)
JOINT = SensorModel.of(response(SENSOR), ALL)
SPECIMEN = Imperfections(gain_spread=0.1, offset_ohm=100.0, noise=1e-3, bits=12)


def read(data, specimen=SPECIMEN, seed=0):
    """What a specimen shows of exact readings."""
    generator = np.random.default_rng([seed, 1])
    ohm = specimen.apply(data.resistance_ohm, generator)
    dead = specimen.dead_mask(3, 3)
    return replace(
        data, resistance_ohm=ohm, noise=specimen.noise, bits=specimen.bits, dead=dead if dead.any() else None
    )


def lighter(data, times):
    """The same sensor under a fraction of its loads."""
    force_n = times * data.force_n
    ohm = JOINT.resistances(force_n.reshape(len(force_n), -1)).reshape(data.resistance_ohm.shape)
    return replace(data, force_n=force_n, resistance_ohm=ohm)


PAIRS = read(labelled(SENSOR, "xyz", n_samples=30, seed=1))


@pytest.mark.parametrize(("axes", "times"), [("z", 1.0), ("xyz", 1.0), ("xyz", 0.01)])
def test_honest_samples_are_never_doubted(axes, times):
    """Exact or noisy, read by a converter or not, of a poor specimen with dead pillars, one of them or many."""
    component = ALL if len(axes) > 1 else component_named(f"f{axes}")
    exact = lighter(labelled(SENSOR, axes, n_samples=100, seed=2), times)
    own = SensorModel.of(response(SENSOR), component)
    poor = {"gain_spread": 0.1, "offset_ohm": 100.0, "dead_pillars": ((0, 2, "z"),), "dead_rows": (3,)}
    for noise, bits, more in ((0.0, None, {}), (0.0, 12, poor), (1e-3, 12, poor), (1e-2, None, {})):
        data = read(exact, Imperfections(noise=noise, bits=bits, **more))
        for n in (1, 3, 100):
            for forward in (JOINT, own, None):
                assert doubt(data[:n], component, forward) is None, (noise, bits, more, n)
        assert disturbance(data, component, JOINT) is None


def turned(*, force=lambda F: F, ohm=lambda R: R):
    return replace(PAIRS, force_n=force(PAIRS.force_n), resistance_ohm=ohm(PAIRS.resistance_ohm))


OTHERS = read(labelled(SENSOR, "xyz", n_samples=30, seed=9))
SHUFFLED = np.random.default_rng(0).permutation(30)
NOT_LINKED = "if nothing linked them: give readings of this sensor, each beside its own load"
WRONG = {
    "kΩ": (turned(ohm=lambda R: R / 1000), r"0\.00\d+ times the design's: give them in Ω"),
    "kN": (turned(force=lambda F: F / 1000), "seem to be in kN: multiply"),
    "mN": (turned(force=lambda F: F * 1000), "seem to be in mN: divide"),
    "kgf": (turned(force=lambda F: F / 9.80665), r"in kgf: multiply them by 9\.81"),
    "taken for kgf": (turned(force=lambda F: F * 9.80665), r"taken for kgf: divide them by 9\.81"),
    "signs": (turned(force=lambda F: -F), "all forces seem to have the other sign"),
    "sign of z": (turned(force=lambda F: F * [1, 1, -1]), "Fz seems to have the other sign"),
    "axes": (turned(force=lambda F: F[..., [1, 0, 2]]), "axes seem to stand in the order y, x, z"),
    "transposed": (turned(force=lambda F: F.swapaxes(1, 2)), "rows and columns of the forces seem to be exchanged"),
    "columns": (turned(ohm=lambda R: R[:, :, ::-1]), "columns of the forces seem to stand in reverse order"),
    "pillars": (turned(ohm=lambda R: R[..., [1, 0, 2]]), "pillars seem to stand in the order x, z, y"),
    "order": (turned(ohm=lambda R: R[SHUFFLED]), NOT_LINKED),
    "of others": (turned(ohm=lambda R: OTHERS.resistance_ohm), NOT_LINKED),
    "constant": (turned(ohm=lambda R: np.repeat(R[:1], 30, axis=0)), NOT_LINKED),
    "contacts": (
        replace(PAIRS, made_from={"protocol": "indent"}),
        "no loads on pads: 'tripillar train --touch'",
    ),
    "unloaded": (turned(force=lambda F: 0 * F), "every force is 0 N, though the resistances differ by more"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(name):
    """Thirty pairs and ten of a poor specimen: whatever it is, one line says it."""
    data, said = WRONG[name]
    assert re.search(said, doubt(data, ALL, JOINT) or ""), doubt(data, ALL, JOINT)
    assert doubt(data[:10], ALL, JOINT) is not None


def test_kilohms_are_noticed_without_a_design():
    """One pair is enough; other sizes may be another rubber's."""
    kilohms = turned(ohm=lambda R: 1e-3 * R)
    assert "as in kΩ: give them in Ω" in doubt(kilohms[:1], ALL, None)
    for times in (1e-5, 1e-2, 1.0, 100.0):
        assert doubt(turned(ohm=lambda R, times=times: times * R), ALL, None) is None


def test_one_net_alone_is_warned_of_forces_that_it_leaves_out_and_of_what_never_changes():
    fz = COMPONENTS["fz"]
    assert "forces along x and y act as well" in (disturbance(PAIRS, fz, JOINT) or "")
    assert "use the component 'all'" in (disturbance(PAIRS, fz, None) or "")
    upright = Layout((Electrode("U", (0, 0)),), (Electrode("L", (0, 0)),), (Pillar("p", "L", "U"),))
    alone = replace(SENSOR, unit=Unit(layout=upright))  # its 'all' would be refused
    of_one = Samples(force_n=PAIRS.force_n, resistance_ohm=PAIRS.resistance_ohm[..., :1], design=alone)
    assert "take samples without them, or a layout that tells them" in (disturbance(of_one, fz, None) or "")
    faint = lighter(replace(PAIRS, force_n=PAIRS.force_n * [1e-6, 1e-6, 1.0]), 1.0)
    assert disturbance(faint, fz, JOINT) is None  # a scale's noise is no shear
    assert disturbance(PAIRS, ALL, JOINT) is None
    assert nothing_to_learn(PAIRS, ALL) is None
    assert nothing_to_learn(WRONG["unloaded"][0], ALL) == "every force is 0 N: nothing can be learnt"
    assert "every resistance is the same" in (nothing_to_learn(WRONG["constant"][0], ALL) or "")


def test_another_sensor_is_explained_less():
    """One whose pads pass on to their neighbours what they keep themselves here; noise is no other sensor."""
    assert explained(PAIRS, ALL, JOINT) > 0.99
    noisy = read(labelled(SENSOR, "xyz", n_samples=30, seed=1), Imperfections(noise=0.01, gain_spread=0.1))
    assert explained(noisy, ALL, JOINT) > 0.95
    faint = lighter(labelled(SENSOR, "xyz", n_samples=30, seed=1), 0.001)
    assert explained(read(faint, Imperfections(noise=0.01)), ALL, JOINT) is None
    influence = np.roll(response(SENSOR).influence_mm_per_n, 1, axis=4)
    other = SensorModel.of(
        replace(response(SENSOR), influence_mm_per_n=0.5 * influence + 0.5 * np.roll(influence, -1, 4)), ALL
    )
    assert explained(PAIRS, ALL, other) < 0.9
