"""Net wrench and centre of pressure: closed forms, and deviations held to errors of readings."""

import numpy as np
import pytest

from dataset import measured
from dataset.measurement import ReadingError
from decoupler.touch.plates import PlateDecoder, PlateResponse
from decoupler.touch.sensing import Pillars
from geometry.design import Array, Pad, SensorDesign, Unit
from geometry.layout import LAYOUTS
from hardware.link.frames import Info, ScanMode
from hardware.readout.forces import ForceReader
from hardware.readout.wrench import MIN_NORMAL_N, SIGNS, net_wrench, pad_positions, wrench_weights
from tests.decoupler.synthetic_sensor import labelled, sensor
from tests.fem.coarse_plates import rigid_plates

AXES = ("x", "y", "z")
PLACES = pad_positions(SensorDesign())


def test_it_is_the_resultant_of_the_vectors_on_the_pads():
    """Σ f and Σ r × f, term by term with NumPy's cross product; the moment is M = r_c × f_z e_z of the centre."""
    force_n = np.random.default_rng(0).normal(10.0, 5.0, (4, 6, 6, 3))
    found = net_wrench(force_n, wrench_weights(PLACES, AXES))
    vectors = force_n * SIGNS
    assert found.vector_n == pytest.approx(vectors.sum(axis=(1, 2)), rel=1e-12)
    assert found.moment_nmm == pytest.approx(np.cross(PLACES, vectors).sum(axis=(1, 2)), abs=1e-9)
    at = np.concatenate([found.centre_mm, np.zeros((4, 1))], axis=1)
    assert np.cross(at, found.vector_n * (0, 0, 1))[:, :2] == pytest.approx(found.moment_nmm[:, :2], abs=1e-9)


@pytest.mark.parametrize("moments", [2, 3])
def test_moments_of_units_count_too(moments):
    """Forces at points of each unit, by its three sums, its pressure's moments and its torque: as term by term."""
    random = np.random.default_rng(0)
    force_n, off_mm = random.normal(10.0, 5.0, (6, 6, 9, 3)), random.uniform(-5.0, 5.0, (6, 6, 9, 2))
    vectors, (x, y), (fx, fy, fz) = force_n * SIGNS, np.moveaxis(off_mm, 3, 0), np.moveaxis(force_n, 3, 0)
    of_units = np.stack([x * fz, y * fz, x * fy - y * fx], axis=-1)[..., :moments]
    load = np.concatenate([force_n, of_units], axis=-1).sum(axis=2)
    found = net_wrench(load[None], wrench_weights(PLACES, AXES, moments)).moment_nmm[0]
    expected = np.cross(PLACES[:, :, None] + np.pad(off_mm, [(0, 0)] * 3 + [(0, 1)]), vectors).sum(axis=(0, 1, 2))
    assert found[:moments] == pytest.approx(expected[:moments], rel=1e-12)


def test_a_board_s_net_moment_has_the_torques_of_plates():
    """Six loads of one of two plates, read from counts: their wrench, to two deviations, a tenth of the torque."""
    array, pad = Array(rows=1, cols=2), Pad(kind="stiff")
    design = SensorDesign(unit=Unit(layout=LAYOUTS["six-pillar"]), array=array, pad=pad)
    of_sensor = {"errors": ReadingError(noise=1e-4, bits=16), "pillars": Pillars.designed(design)}
    decoder = PlateDecoder(design=design, library=PlateResponse(moved_mm=rigid_plates(design)), **of_sensor)
    load = np.zeros((2, 6))
    load[1] = 3.0, -2.0, 50.0, 20.0, -30.0, 200.0
    moved = load.ravel() @ decoder.library.moved_mm.reshape(12, -1)
    ohms = decoder.sensing.ohms(decoder.sensing.reading(moved)).reshape(1, 1, 2, -1)
    info = Info(rows=1, cols=2, bits=16, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, layout=design.unit.layout)
    reader = ForceReader(info, decoder)
    found = reader.forces(reader.crossbar.counts(ohms))
    half = found.moment_deviation_nmm[0]
    assert half[0] == pytest.approx(reader._decoder.touches(found.resistance_ohm)[0].half_widths[0][:, 3:])
    assert half[0, 1, 2] < 20.0
    assert found[0].moment_deviation_nmm.shape == (1, 2, 3)
    wrench = found.wrench
    expected = np.cross((7.5, 0.0, 0.0), (3.0, -2.0, -50.0)) + np.array([30.0, 20.0, 200.0])
    assert (np.abs(wrench.moment_nmm[0] - expected) < 2 * wrench.moment_deviation_nmm[0]).all()
    assert wrench.moment_deviation_nmm[0, 2] < 20.0


def test_there_is_no_centre_of_what_hardly_presses():
    force_n = np.zeros((3, 6, 6, 3))
    force_n[:, 2, 3, 2] = 0.9 * MIN_NORMAL_N, 1.1 * MIN_NORMAL_N, 5.0
    weights = wrench_weights(PLACES, AXES)
    assert np.isnan(net_wrench(force_n, weights).centre_mm[:, 0]).tolist() == [True, False, False]
    unsure = net_wrench(force_n, weights, np.eye(6)[None] * 4.0)  # ± 2 N: 5 N are less than three deviations
    assert np.isnan(unsure.centre_mm).all()
    assert np.isnan(unsure.centre_deviation_mm).all()
    assert net_wrench(force_n, weights).centre_mm[2] == pytest.approx(PLACES[2, 3, :2])
    found = net_wrench(np.ones((1, 6, 6, 1)), wrench_weights(PLACES, ("z",)))  # of a model of one axis
    assert np.isnan(found.force_n[0]).tolist() == [True, True, False]
    assert np.isnan(found.moment_nmm[0]).tolist() == [False, False, True]


def test_the_centres_deviation_is_that_of_drawn_errors():
    """Errors drawn from a covariance of the six sums move the centre as far as is said, to first order: 3 %."""
    random = np.random.default_rng(1)
    covariance = np.cov(random.normal(size=(6, 20))) * np.outer(scale := [1, 1, 1, 20, 20, 20], scale)
    force_n = np.zeros((1, 6, 6, 3))
    force_n[0, 1:3, 4, 2] = 40.0, 60.0
    weights = wrench_weights(PLACES, AXES)
    found = net_wrench(force_n, weights, covariance[None])
    sums = force_n.reshape(1, -1) @ weights + random.multivariate_normal(np.zeros(6), covariance, 20_000)
    drawn = np.stack([sums[:, 4], -sums[:, 3]], axis=1) / sums[:, 2:3]
    assert found.centre_deviation_mm[0] == pytest.approx(drawn.std(axis=0), rel=0.03)


def test_deviations_hold_the_errors_of_net_forces(pressed):
    """Of the six sums of new samples 68 % lie within; as if forces erred alone, far fewer of the sums of Fz would."""
    new, model = labelled(sensor(2, 3), "xyz", n_samples=500, seed=1), pressed.model
    noisy_ohm = measured(new.resistance_ohm, 1e-3, None, np.random.default_rng(1))
    weights = wrench_weights(pad_positions(model.design), AXES)
    half_n, covariance = model.deviations(noisy_ohm, weights)
    assert np.array_equal(half_n, model.half_widths(noisy_ohm)[0])
    error = (model.forces(noisy_ohm) - new.force_n).reshape(500, -1) @ weights
    stated = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert (np.abs(error) <= stated).mean(axis=0) == pytest.approx(0.68, abs=0.1)
    alone = np.sqrt((half_n.reshape(500, -1) ** 2) @ weights**2)
    assert ((np.abs(error) <= alone).mean(axis=0)[:3] < 0.5).all()
