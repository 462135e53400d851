"""Series over time: loads of a protocol that come and go, read through a rubber that remembers."""

from dataclasses import replace

import numpy as np
import pytest

import tripillar as tp
from dataset import DatasetSettings, Imperfections, SampleError, measured_again, read_samples, simulate
from dataset.histories import between, programme
from dataset.loads import NORMAL_MPA
from dataset.memory import decays, log_rise, relaxed_forces
from dataset.resistance import pillar_resistances
from dataset.simulation import simulate_part
from dataset.table import write_table
from geometry import DesignError
from geometry.design import Memory, Prony
from geometry.layout import pillar_volumes, rest_lengths
from tests.house import House
from tripillar.datasets.leaves import LeafJob, make_directory
from tripillar.face.inputs import samples_of

MEMORY = Memory(a=(0.4, 0.3), b_lengthen=2.0, b_shorten=9.0, tau_s=(6.0, 90.0), g1=1.0, g2=-2.0)
PRONY = Prony(share=(0.05, 0.04), tau_s=(1.0, 40.0))


def asked(**more) -> DatasetSettings:
    return DatasetSettings(
        **{"protocol": "three-axis", "samples": 3, "seed": 5, "history_s": 30.0, "rate_hz": 10.0} | more
    )


def of_rubber(response, **rubber):
    design = response.design
    return replace(response, design=replace(design, pillar_material=replace(design.pillar_material, **rubber)))


@pytest.fixture(scope="module")
def remembering(response):
    return of_rubber(response, memory=MEMORY)


@pytest.fixture(scope="module")
def series(remembering):
    return simulate(remembering, asked())


def test_readings_follow_the_law_step_by_step_from_the_lengths(series):
    """A state that is carried from moment to moment, as a board would, gives the same."""
    unit = series.design.unit
    strain = series.length_mm / rest_lengths(unit) - 1.0
    q = np.zeros((2, *strain[:, 0].shape))
    bulk = pillar_resistances(series.length_mm, pillar_volumes(unit), series.design.resistivity_ohm_mm)
    for k in range(300):
        if k:
            steps = decays(strain[:, k] - strain[:, k - 1], 0.1, MEMORY)
            q = np.stack([keep * own + gain for own, (keep, gain) in zip(q, steps, strict=True)])
        expected = bulk[:, k] * np.exp(log_rise(strain[:, k], q, MEMORY))
        assert series.resistance_ohm[:, k] == pytest.approx(expected, rel=1e-12)
    assert q.max() > 0.1


def test_a_series_begins_at_rest_presses_as_the_protocol_says_and_lets_go(series):
    pressure = -series.traction_mpa[..., 2]
    assert not pressure[:, 0].any()
    assert 0.2 * NORMAL_MPA[0] < pressure.max() <= NORMAL_MPA[1]
    is_at_rest = (pressure == 0).all(axis=(2, 3))
    assert (is_at_rest[:, 1:] & ~is_at_rest[:, :-1]).any(axis=1).all()
    assert (series.resistance_ohm[:, -1] != series.resistance_ohm[:, 0]).all()
    unit = series.design.unit
    assert np.abs(series.length_mm / rest_lengths(unit) - 1.0).max() < 0.3


def test_without_memory_moments_are_samples(response, series):
    plain = simulate(response, asked())
    for name in ("force_n", "traction_mpa", "displacement_mm", "length_mm"):
        assert np.array_equal(getattr(plain, name), getattr(series, name))
    flat = plain.at_moments()
    exact = pillar_resistances(flat.length_mm, pillar_volumes(plain.design.unit), plain.design.resistivity_ohm_mm)
    assert np.array_equal(flat.resistance_ohm, exact)
    assert (len(flat), flat.shape, flat.time_s) == (900, plain.shape, None)


def test_a_series_is_the_same_at_another_rate_and_in_another_number(remembering, series):
    """At 50 Hz the way of a strain between two moments, of a load at a constant rate, is followed better: 2e-4."""
    fine = simulate(remembering, asked(rate_hz=50.0))
    assert np.allclose(fine.time_s[::5], series.time_s, atol=1e-12)
    np.testing.assert_allclose(fine.force_n[:, ::5], series.force_n, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fine.resistance_ohm[:, ::5], series.resistance_ohm, rtol=5e-4)
    later = simulate_part(remembering, asked(samples=9), range(2, 4))
    assert np.array_equal(later.resistance_ohm[0], series.resistance_ohm[2])
    assert not np.array_equal(later.force_n[1], series.force_n[2])


def test_forces_relax_and_strains_do_not(remembering, series):
    soft = of_rubber(remembering, prony=PRONY)
    relaxing = simulate(soft, asked())
    assert np.array_equal(relaxing.resistance_ohm, series.resistance_ohm)
    expected = np.stack([relaxed_forces(one, 0.1, PRONY) for one in series.force_n])
    np.testing.assert_allclose(relaxing.force_n, expected, rtol=0, atol=1e-9)
    assert np.abs(relaxing.force_n - series.force_n).max() > 1.0


def test_learning_takes_series_moment_by_moment_and_says_so(response, series, tmp_path):
    with pytest.warns(UserWarning, match="as if the rubber remembered nothing"):
        flat = samples_of(series)
    assert np.array_equal(flat.resistance_ohm, series.resistance_ohm.reshape(-1, 2, 3, 3))
    plain = simulate(response, asked())
    plain.write(tmp_path / "plain.zarr")
    assert np.array_equal(samples_of(tmp_path / "plain.zarr").force_n, plain.force_n.reshape(-1, 2, 3, 3))


def test_a_drift_stays_over_a_series_and_noise_does_not(remembering, series):
    drifted = simulate(remembering, asked(drift=0.01, drift_pillar=0.01, drift_offset_ohm=0.0))
    ratio = drifted.resistance_ohm / series.resistance_ohm
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[:, :1], ratio.shape), rtol=1e-12)
    assert ratio[:, 0].std() > 3e-3
    noisy = simulate(remembering, asked(noise=0.01)).resistance_ohm / series.resistance_ohm - 1.0
    assert noisy.std(axis=1).mean() == pytest.approx(0.01, rel=0.05)


def test_each_pillar_of_a_specimen_remembers_in_its_own_way(remembering, series):
    spread, wider = (simulate(remembering, asked(memory_spread=size)) for size in (0.1, 0.2))
    assert np.array_equal(spread.resistance_ohm[:, 0], series.resistance_ohm[:, 0])
    first, second = (np.log(one.resistance_ohm / series.resistance_ohm)[:, -1] for one in (spread, wider))
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.98  # one specimen, of larger deviations
    own = Imperfections(memory_spread=0.15).memory_of(MEMORY, 60, 60)
    for found, meant in zip((*own.a, own.b_lengthen, own.b_shorten, *own.tau_s), (0.4, 0.3, 2, 9, 6, 90), strict=True):
        assert found.mean() == pytest.approx(meant, rel=0.01)
        assert found.std() == pytest.approx(0.15 * meant, rel=0.05)
    other = Imperfections(memory_spread=0.15, specimen=1).memory_of(MEMORY, 60, 60)
    assert np.abs(np.corrcoef(own.tau_s[0].ravel(), other.tau_s[0].ravel())[0, 1]) < 0.05
    assert Imperfections().memory_of(MEMORY, 60, 60) is MEMORY


def test_the_same_series_measured_again(remembering, series):
    real = {"noise": 1e-3, "bits": 12, "gain_spread": 0.1, "memory_spread": 0.1, "drift": 0.01}
    expected = simulate(remembering, asked(**real))
    again = measured_again(series, Imperfections(**real), 5)
    assert np.array_equal(again.resistance_ohm, expected.resistance_ohm)


@pytest.mark.parametrize("form", ["nc", "zarr"])
def test_files_hold_series_and_their_times(series, tmp_path, form):
    path = tmp_path / f"series.{form}"
    series.write(path)
    found = read_samples(path)
    assert found.to_xarray()["resistance_ohm"].dims == ("series", "time", "row", "col", "pillar")
    assert found.to_xarray().time_s.values == pytest.approx(np.arange(300) / 10)
    assert (len(found), found.shape, found.design) == (3, (2, 3), series.design)
    assert found.made_from["history_s"] == 30.0
    for name, values in series.arrays().items():
        assert np.array_equal(getattr(found[1:], name), values[1:])
    if form == "nc":
        assert found.content_hash == series.content_hash
    write_table(found, tmp_path / "series.csv")
    rows = np.genfromtxt(tmp_path / "series.csv", delimiter=",", names=True)
    assert (len(rows), rows["series"][-1], rows["time_s"][-1]) == (900, 2, 29.9)
    np.testing.assert_allclose(rows["force_0_1_z_n"], series.force_n[:, :, 0, 1, 2].ravel(), rtol=1e-6)
    lone = series.to_xarray().drop_vars("time_s").drop_attrs()
    lone.to_netcdf(tmp_path / "lone.nc")
    with pytest.raises(ValueError, match=r"lone.nc: series need a coordinate 'time_s'"):
        read_samples(tmp_path / "lone.nc")


def test_a_directory_of_series_is_taken_up_again_and_is_the_same(remembering, tmp_path):
    """20 s at 50 Hz: 8 series a leaf."""
    job = LeafJob(
        response=remembering, settings=asked(samples=19, history_s=20.0, rate_hz=50.0), only=(), dtype="float32"
    )
    out = tmp_path / "series.zarr"

    def stop(samples: int) -> None:
        if samples:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_directory(job, out, count=1, progress=stop)
    made = make_directory(job, out, count=1)
    found = read_samples(out)
    assert (made["kept"], found.leaf_size, found.dtype, len(list(found.blocks()))) == (8, 8, np.float32, 3)
    expected = job.whole(lambda _: None)
    assert np.array_equal(found[:].resistance_ohm, expected.resistance_ohm.astype(np.float32))
    assert make_directory(job, out, count=1)["kept"] == 19
    chunk = out / "force_n/1.0.0.0.0"
    chunk.write_bytes(chunk.read_bytes()[:-1])
    assert make_directory(job, out, count=1)["kept"] == 0


def test_an_hour_of_programme_lies_between_its_corners():
    corner_s, level, load = programme(np.random.default_rng(2), 3600.0)
    assert corner_s[0] == level[0] == 0.0
    assert corner_s[-2] < 3600.0 + 200.0
    assert corner_s[-1] >= 3600.0
    ticks = np.diff(corner_s) / 0.1
    np.testing.assert_allclose(ticks, np.rint(ticks), rtol=0, atol=1e-6)
    assert ticks.min() > 0.99
    assert (level.min(), load.max() > 50) == (0.0, True)
    np.testing.assert_allclose(between(corner_s, corner_s, level), level, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        between((corner_s[1:] + corner_s[:-1]) / 2, corner_s, level), (level[1:] + level[:-1]) / 2, rtol=1e-6
    )


def test_what_makes_no_series_is_refused(series, remembering, tmp_path):
    for more, said in (
        ({"history_s": 0.1}, "1 moments: 2 to"),
        ({"history_s": 1e6, "rate_hz": 100.0}, "100000000 moments"),
        ({"protocol": "indent"}, "'indent' has none"),
        ({"rate_hz": 0.0}, "rate_hz"),
    ):
        with pytest.raises(DesignError, match=said):
            asked(**more)
    with pytest.raises(SampleError, match=r"series over time.*at_moments\(\)"):
        tp.identify(series)
    with pytest.raises(SampleError, match=r"expected \(n_series, 300, rows, cols, 3\)"):
        replace(series, force_n=series.force_n[:, 1:])
    house = House(tmp_path)
    for words, said in (
        (("--rate", "50"), "--rate 50 is of series over time: give --history"),
        (("--history", "5", "--strain", "finite"), "and twins out"),
    ):
        words = ("dataset", "--design", "small.toml", "--protocol", "three-axis", "--samples", "2", *words)
        done = house.tripillar(*words, "--out", "no.nc")
        assert (done.returncode, said in done.stderr) == (2, True)
