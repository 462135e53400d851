"""Eq. 17, RMSE and % of full scale by hand, the marks to beat, the limits of readings, and an assessment of all."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import tripillar as tp
from common.errors import FileFormatError
from dataset import SampleError, pillar_lengths, pillar_resistances
from dataset.measurement import ReadingError
from decoupler import LeastSquares, assess, hooke_forces
from decoupler.data.columns import Columns, component_named, force_columns
from decoupler.evaluation.assessment import as_plain
from decoupler.evaluation.metrics import component_errors, evaluate, force_errors, pca_floor
from decoupler.inverse.limits import bayes, cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from geometry import SensorDesign
from geometry.layout import pillar_volumes
from tests.decoupler.synthetic_sensor import ALL, RESPONSE, SMALL, labelled, response, sensor, split
from tests.decoupler.test_contract import made

PAPER = SensorDesign()
FZ = component_named("fz")
FORWARD = SensorModel.of(RESPONSE, ALL)
FORCES = force_columns(labelled(SMALL, "xyz", n_samples=150, seed=0).force_n, ALL)


def test_errors_by_hand_and_what_means_nothing_is_none():
    """Below a thousandth of full scale eq. 17 says nothing; no force at all has no full scale."""
    errors = force_errors(np.array([[11.0, -17.0]]), np.array([[10.0, -20.0]]))
    assert errors.rel_err == pytest.approx((0.1 + 0.15) / 2, rel=1e-14)
    assert errors.rmse_n == pytest.approx(np.sqrt((1 + 9) / 2), rel=1e-14)
    assert errors.full_scale_pct == pytest.approx(100 * np.sqrt(5) / 20, rel=1e-14)
    for smallest in (0.0, 0.05, -0.1):
        assert force_errors(np.array([1.0, 101.0]), np.array([smallest, 100.0])).rel_err is None
    errors = force_errors(np.ones(3), np.zeros(3))
    assert (errors.rel_err, errors.rmse_n, errors.full_scale_pct) == (None, 1.0, None)
    with pytest.raises(SampleError, match="give both alike"):
        force_errors(np.ones(3), np.ones((3, 1)))
    data = labelled(SMALL, "xyz", n_samples=4, seed=0)
    apart = component_errors(data.force_n + np.array([0.0, 2.0, 0.0]), data, ALL)
    assert {name: value.rmse_n for name, value in apart.items()} == pytest.approx({"fx": 0, "fy": 2, "fz": 0})


def test_a_projection_leaves_what_a_narrow_net_cannot_pass():
    """36 uniform forces through 17 nodes leave 0.157, half of the variance of 1/3; those of three patterns nothing."""
    assert pca_floor(labelled(sensor(), "z", 2000, 0).force_n, FZ, 17).scaled_mse == pytest.approx(0.157, abs=0.001)
    generator = np.random.default_rng(0)
    force_n = np.zeros((50, 2, 3, 3))
    force_n[..., 2] = 100 + (generator.standard_normal((50, 3)) @ generator.standard_normal((3, 6))).reshape(50, 2, 3)
    assert pca_floor(force_n, FZ, 3).projection["fz"].rmse_n < 1e-12
    discarded = np.linalg.svd((force_n - force_n.mean(axis=0)).reshape(50, -1), compute_uv=False)[2]
    assert pca_floor(force_n, FZ, 2).projection["fz"].rmse_n == pytest.approx(discarded / np.sqrt(300), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "displacement_mm", "newtons"),
    [
        ("fz", [0, 0, -1.0], 6.1 * 4 * 0.1),  # E S / 10 of a pillar shortened by 1 of 10 mm
        ("fx", [0.5, 0, 0], None),  # a force that moves along its axis is positive
        ("fy", [0, 0.5, 0], None),
        ("fz", [0.1, 0.2, -0.3], None),
    ],
)
def test_a_pillar_alone_follows_hooke(name, displacement_mm, newtons):
    lengths = pillar_lengths(np.broadcast_to(np.array(displacement_mm, dtype=float), (1, 1, 1, 2, 3)), PAPER.unit)
    ohms = pillar_resistances(lengths, pillar_volumes(PAPER.unit), PAPER.resistivity_ohm_mm)
    found, jointly = hooke_forces(ohms, PAPER, component_named(name)), hooke_forces(ohms, PAPER, ALL)
    assert found.item() > 0 if newtons is None else found.item() == pytest.approx(newtons, rel=1e-12)
    assert jointly[..., "xyz".index(name[1])].item() == found.item()


def test_least_squares_is_exact_where_force_is_linear_in_root_resistance():
    """Also of fewer samples than unknowns."""
    data = labelled(SMALL, "z", n_samples=60, seed=0)
    root = np.sqrt(data.resistance_ohm[..., 0]).reshape(60, 6)
    force_n = np.zeros_like(data.force_n)
    force_n[..., 2] = (root @ np.random.default_rng(1).standard_normal((6, 6)) + 7.0).reshape(60, 2, 3)
    learned, test = split(replace(data, force_n=force_n), 40)
    for few, asked, rtol in ((learned, test, 1e-8), (learned[:3], learned[:3], 1e-9)):  # of a matrix of condition 1e4
        forces = LeastSquares.fitted(Columns.of(few, FZ)).forces(asked.resistance_ohm)
        np.testing.assert_allclose(forces[..., 0], asked.force_n[..., 2], rtol=rtol)


def test_knowing_the_usual_loads_helps_and_most_where_noise_is_large():
    """Bayes' bound lies below the other, meets it without noise and the forces' own spread with endless noise."""
    read = [(ReadingError(noise=noise), (2, 3)) for noise in (1e-5, 0.05, 1e3)]
    small, some, large = (bayes(FORWARD, FORCES, *each) for each in read)
    np.testing.assert_allclose(small, cramer_rao(FORWARD, FORCES, *read[0]), rtol=0.01)
    assert (some < cramer_rao(FORWARD, FORCES, *read[1])).all()
    np.testing.assert_allclose(large, np.broadcast_to(FORCES.std(axis=0), large.shape), rtol=0.01)
    assert not cramer_rao(FORWARD, FORCES[:3], ReadingError(), (2, 3)).any()


def test_fewer_pillars_than_forces_determine_nothing_without_the_usual_loads():
    known, readable = (ReadingError(noise=2e-3), (2, 3)), np.ones(FORWARD.n_pillars, dtype=bool)
    readable[0] = False
    assert np.isinf(cramer_rao(FORWARD, FORCES, *known, readable)).all()
    healthy, hurt = bayes(FORWARD, FORCES, *known), bayes(FORWARD, FORCES, *known, readable)
    assert (hurt >= healthy * (1 - 1e-9)).all()
    assert (hurt < 1.001 * FORCES.std(axis=0).max()).all()
    assert hurt[:, :3].max() > 10 * healthy[:, :3].max()  # the unit whose z pillar is gone


def test_an_assessment_holds_what_its_parts_say():
    """Errors within 15 % of the limit are what the project promises; where other forces act there is no limit."""
    model, test = made("noisy").model, made("noisy").test
    found, as_read = assess(model, test, RESPONSE), (model.errors, test.shape)
    least = component_errors(model.least_squares.forces(test.resistance_ohm), test, ALL)
    hooke = component_errors(hooke_forces(test.resistance_ohm, SMALL, ALL), test, ALL)
    bound = cramer_rao(FORWARD, force_columns(test.force_n, ALL), *as_read).reshape(test.force_n.shape)
    missed = np.abs(model.forces(test.resistance_ohm) - test.force_n)
    within = [(missed <= width).mean(axis=(0, 1, 2)) for width in model.half_widths(test.resistance_ohm)]
    for axis, name in enumerate(("fx", "fy", "fz")):
        one, limit = found[name], np.sqrt(np.mean(bound[..., axis] ** 2))
        assert one.coverage == pytest.approx([share[axis] for share in within])
        assert one.errors == evaluate(model, test)[name]
        assert one.baselines == {"eq. 8, each pillar alone": hooke[name], "least squares on √R": least[name]}
        assert one.limits.cramer_rao_n == pytest.approx(limit, rel=1e-12)
        assert one.ratio == pytest.approx(one.errors.rmse_n / limit)
        assert one.ratio < 1.15
        assert one.limits.bayes_n < limit
    assert list(as_plain(assess(model, test, None))["fz"])[:3] == ["rel_err", "rmse_n", "full_scale_pct"]
    assert assess(made("fz-inverse").model, test, RESPONSE)["fz"].limits is None


def test_another_programs_forces_are_judged_by_the_same_measures_and_limits(tmp_path):
    data, solved = labelled(sensor(1, 2), "xyz", 60, seed=1), response(sensor(1, 2))
    model = tp.train(data[:30], "all", hidden=2, max_iterations=3, response=solved)
    data = data[30:]
    own = tp.evaluate(model, data, response=solved)
    dims = ("sample", "row", "col", "axis")
    xr.Dataset({"force_n": (dims, model.forces(data.resistance_ohm))}).to_netcdf(tmp_path / "own.nc")
    found = tp.evaluate(predictions=tmp_path / "own.nc", data=data, response=solved)
    turned = xr.load_dataset(tmp_path / "own.nc").isel(axis=[2, 0, 1]).assign_coords(axis=["z", "x", "y"])
    turned.to_netcdf(tmp_path / "turned.nc")
    turned.rename(force_n="force").to_netcdf(tmp_path / "force.nc")
    wanted = r"no variable 'force_n', only \['force'\]: .*force_n=\(\('sample', 'row', 'col', 'axis'\), F\)"
    with pytest.raises(FileFormatError, match=wanted):
        tp.evaluate(predictions=tmp_path / "force.nc", data=data, limits=False)
    assert tp.evaluate(predictions=tmp_path / "turned.nc", data=data, response=solved) == found
    for name, one in found.items():
        assert (one.errors, one.limits, one.ratio) == (own[name].errors, own[name].limits, own[name].ratio)
        assert one.coverage == ()
    fz_alone = np.where([False, False, True], data.force_n, np.nan)
    (one,) = tp.evaluate(predictions=fz_alone, data=data, limits=False).values()
    assert one.errors.rmse_n == 0
    pressed = replace(labelled(sensor(1, 2), "z", 60, seed=2), noise=1e-3)
    of_fz = tp.train(pressed[:30], "fz", hidden=2, max_iterations=3, response=solved)
    own_n = np.where([False, False, True], of_fz.forces(pressed.resistance_ohm), np.nan)
    one = tp.evaluate(predictions=own_n, data=pressed, response=solved)["fz"]
    assert (one.limits, one.ratio) == ((own := tp.evaluate(of_fz, pressed, response=solved)["fz"]).limits, own.ratio)
    for wrong_n, said in (
        (data.force_n * [1, 1, -1], "predictions: forces along z seem to have the other sign"),
        (
            np.where([0, 0, 1], 1e-3 * data.force_n, np.nan),
            "predictions: forces along z are 0.001 of what the readings",
        ),
        (1e6 * data.force_n, "predictions: "),
        (data.force_n[::-1], "predictions: the readings fit the forces worse than if nothing linked them"),
    ):
        with pytest.warns(UserWarning, match=said):
            tp.evaluate(predictions=wrong_n, data=data, response=solved)
    for wrong, said in (
        (fz_alone[:-1], "one for each sample"),
        (data.force_n * [1, 1, np.nan], "all three, or one alone"),
        (data.force_n * [1, 1, np.inf], "all three, or one alone"),
    ):
        with pytest.raises(SampleError, match=said):
            tp.evaluate(predictions=wrong, data=data, limits=False)
