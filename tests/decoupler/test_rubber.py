"""Rubbers from bench series: simulated ones come back, bad ones are mended or refused in one line."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import DesignError, FileFormatError
from decoupler.rubber.belief import SensorFilter
from decoupler.rubber.check import checked, of_range, resistance_from_strain
from decoupler.rubber.fit import fit_elastic, identified
from decoupler.rubber.law import numbers_of, settled_stress
from decoupler.rubber.rubber_file import extended, read_rubber, write_rubber
from decoupler.rubber.series import read_series
from fem.kernel.law import LAWS
from geometry.design import Material, Memory, SensorDesign
from geometry.design_file import read_design
from studies.pictures.rubber import ELASTIC, MEMORY, NOISE, bench


def written(path, series, **changes):
    """A table of a series, with some columns changed."""
    columns = {name: getattr(series, name) for name in ("time_s", "strain", "force_n", "resistance_ohm")} | changes
    kept = {name: values for name, values in columns.items() if values is not None}
    rows = np.stack(list(kept.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(kept), comments="", fmt="%.8g")
    return path


@pytest.fixture(scope="module")
def series():
    return bench(rate_hz=2.0)


@pytest.fixture(scope="module")
def found(series):
    return identified(series, section_mm2=40.0, electrodes_mm=20.0)


def test_a_rubber_without_noise_comes_back():
    exact = bench(noise=0.0, rate_hz=2.0)
    found = identified(exact)
    off = np.abs(found.numbers - numbers_of(MEMORY))
    assert (off < 3 * np.sqrt(found.covariance.diagonal()) + 1e-6).all()
    assert off.max() < 1e-3
    assert found.elastic.model == "yeoh"
    assert found.elastic.stiffness_n == pytest.approx(5.0, rel=1e-2)
    assert found.elastic.prony.share == pytest.approx((0.06, 0.08), rel=0.1)


def test_a_noisy_one_comes_back_within_its_deviations(found):
    deviations = np.sqrt(found.covariance.diagonal())
    assert (np.abs(found.numbers - numbers_of(MEMORY)) < 4 * deviations).all()
    assert found.noise == pytest.approx(NOISE, rel=0.3)
    assert found.young_mpa == pytest.approx(3 * 5.0 / 40.0, rel=0.05)
    assert found.resistivity_ohm_mm == pytest.approx(1200.0 * 40.0 / 20.0, rel=0.03)
    fresh = bench(seed=1, rate_hz=2.0)
    assert of_range(resistance_from_strain(found, fresh), fresh.resistance_ohm) < 2.0


def a_memory(generator):
    """One that a silicone may have: what was published, and half as much again around it."""
    b_lengthen, ratio, first, second = generator.uniform([0.8, 3.0, 4.0, 60.0], [2.5, 9.0, 14.0, 250.0])
    return Memory(
        a=generator.uniform(0.12, 0.5, 2),
        b_lengthen=b_lengthen,
        b_shorten=ratio * b_lengthen,
        tau_s=(first, second),
        g1=generator.uniform(0.5, 3.0),
        g2=generator.uniform(-7.0, -3.0),
    )


@pytest.mark.parametrize("seeds", [3, pytest.param(20, marks=pytest.mark.long)])
def test_deviations_hold_what_they_say(seeds):
    """Of 8 numbers of each rubber 68 and 95 % lie within one and two; binomial errors of some 40 independent ones."""
    off = []
    for seed in range(seeds):
        memory = a_memory(np.random.default_rng(100 + seed))
        found = identified(bench(seed=seed, noise=0.02, memory=memory, rate_hz=1.0))
        off.append((found.numbers - numbers_of(memory)) / np.sqrt(found.covariance.diagonal()))
    size = np.abs(off)
    assert np.mean(size < 1) > 0.68 - 3 * np.sqrt(0.68 * 0.32 / (2 * seeds))
    assert np.mean(size < 2) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / (2 * seeds))


ELASTICS = pytest.mark.parametrize(
    ("law", "stiffening", "second"), [("neo-hookean", 0.0, 0.0), ("mooney-rivlin", 0.0, 0.2), ("yeoh", 0.2, 0.0)]
)


@ELASTICS
def test_the_law_of_the_force_is_the_one_that_made_it(law, stiffening, second):
    elastic = replace(ELASTIC, model=law, stiffening=stiffening, second=second)
    told, _ = fit_elastic(bench(noise=0.003, elastic=elastic, rate_hz=1.0))
    assert told.model == law
    assert told.stiffness_n == pytest.approx(5.0, rel=0.05)


def test_what_a_series_does_not_tell_is_said_by_name():
    """Holds at one level leave g1 and g2 together; no test in tension tells of compression."""
    one_level = (
        np.array([0.0, 60, 60.2, 300, 300.2, 600, 600.2, 800, 800.2, 1200]),
        np.array([0, 0, 1, 1, 0, 0, 1, 1, 0, 0]) * 0.3,
    )
    said = dict(identified(bench(programme=one_level, noise=0.02, rate_hz=1.0)).unknown)
    assert any("g1" in what and "g2" in what for what in said)
    assert said["compression"].startswith("the same test pressed")
    whole = dict(identified(bench(noise=0.003, rate_hz=1.0)).unknown)
    assert list(whole) == ["compression"]


def test_a_file_holds_a_rubber_and_designs_extend_it(found, tmp_path):
    write_rubber(found, tmp_path / "rubber.toml")
    again = read_rubber(tmp_path / "rubber.toml")
    assert again.numbers == pytest.approx(found.numbers, rel=1e-5, abs=1e-5)  # logarithms of six digits
    assert again.covariance == pytest.approx(found.covariance, rel=0.01, abs=1e-4 * found.covariance.max())
    assert (again.elastic.model, again.unknown, again.wires) == (found.elastic.model, found.unknown, 4)
    design = read_design(tmp_path / "rubber.toml")
    assert design == extended(SensorDesign(), found)
    assert design.pillar_material.memory.b_shorten == pytest.approx(found.memory.b_shorten, rel=1e-5)
    assert design.pillar_material.young_mpa == pytest.approx(found.young_mpa, rel=1e-5)
    loading = replace(found, memory=replace(found.memory, direction="loading"))
    write_rubber(loading, tmp_path / "loading.toml")
    assert SensorFilter.of_rubber(read_rubber(tmp_path / "loading.toml")).memory.direction == "loading"
    text = (tmp_path / "rubber.toml").read_text()
    for there, instead, said in (
        ("tau2_s = [", "tau3_s = [", "lacks 'tau2_s'"),
        ("rest_ohm = ", "rest_ohm = nan # ", "rest_ohm=nan must be a finite number"),
        ("stiffness_n", "stiffness", r"unknown key 'stiffness' in .*cut.toml: \[rubber.elastic\]"),
        ("model = 'yeoh'", "model = 'ogden'", "model='ogden' must be one of linear"),
    ):
        (tmp_path / "cut.toml").write_text(text.replace(there, instead))
        with pytest.raises(DesignError, match=said):
            read_rubber(tmp_path / "cut.toml")


def test_a_check_judges_resistance_and_force_from_strain_with_offsets_free(found, series):
    """Forces 3 N off all along are right, as are resistances times 2; noise of 1 % of the force's range is 1 %."""
    true = replace(series, force_n=found.elastic.force(series.strain, series.seconds))
    off = 0.01 * np.ptp(true.force_n) * np.random.default_rng(0).standard_normal(len(series))
    judged = checked(found, replace(true, force_n=true.force_n + 3.0 + off, resistance_ohm=2 * series.resistance_ohm))
    assert judged.force_from_strain_nrmse_pct == pytest.approx(1.0, abs=0.1)
    assert judged.resistance_nrmse_pct == pytest.approx(checked(found, series).resistance_nrmse_pct, rel=1e-9)


def test_two_ways_of_reading_tell_contacts(series):
    """Two wires read the strip between its clamps, twice as long, and a contact of 15 kΩ at each end."""
    read = replace(series, two_wire_ohm=2 * series.resistance_ohm + 30e3)
    found = identified(read.averaged(16), electrodes_mm=20.0, length_mm=40.0)
    assert found.contact_ohm == pytest.approx(15e3)
    assert found.contact_spread == pytest.approx(0.0, abs=1e-9)
    assert identified(read.averaged(16)).contact_ohm is None


@ELASTICS
def test_forces_are_those_of_the_laws_of_solids(law, stiffening, second):
    """Stress of a strip that keeps its volume, from the energy: dW/dλ where λ₁ = λ, λ₂ = λ₃ = λ^-1/2."""
    strain, step, rubber = np.array([-0.4, 0.2, 0.9]), 1e-5, Material(model=law, stiffening=stiffening)
    solid = LAWS[law].of([rubber], np.ones((1, 1)))

    def energy(strain):
        across = (1 + strain) ** -0.5 - 1
        return solid.energy(solid.strain(np.einsum("in,ij->ijn", [strain, across, across], np.eye(3))))

    slope = (energy(strain + step) - energy(strain - step)) / (2 * step)
    assert settled_stress(strain, stiffening, second) * rubber.lame_mpa[1] == pytest.approx(slope, rel=1e-8)


def swung(series):
    return series.resistance_ohm * (1 + 0.05 * (-1.0) ** np.arange(len(series)))


def hit(series):
    strain = series.strain.copy()
    strain[[500, 1200, 1201]] = 0.0, -0.4, -0.4
    return strain


MENDED = {
    "alternate": (lambda s: {"resistance_ohm": swung(s)}, "readings alternate"),
    "signs": (lambda s: {"resistance_ohm": -s.resistance_ohm}, "its sign was dropped"),
    "pulls": (lambda s: {"force_n": -s.force_n}, "force_n's sign was turned"),
    "away": (lambda s: {"strain": -s.strain}, "strain's sign was turned"),
    "glitch": (lambda s: {"strain": hit(s)}, "position jumps away and back in"),
    "milliseconds": (lambda s: {"time_s": None, "time_ms": 1e3 * s.time_s}, ""),
    "percent": (lambda s: {"strain": None, "strain_pct": 100 * s.strain}, ""),
    "length": (lambda s: {"strain": None, "displacement_mm": 40 * s.strain}, ""),
    "kiloohm": (lambda s: {"resistance_ohm": None, "resistance_kohm": s.resistance_ohm / 1e3}, ""),
}


@pytest.mark.parametrize("name", MENDED)
def test_what_can_be_mended_is_mended_and_said(series, name, tmp_path):
    change, says = MENDED[name]
    mended = read_series(written(tmp_path / "s.csv", series, **change(series)), length_mm=40.0)
    assert [says in note for note in mended.notes] == [True] * bool(says)
    same = np.interp(mended.time_s, series.time_s, series.resistance_ohm)
    assert mended.resistance_ohm == pytest.approx(same, rel=0.02)
    assert mended.strain == pytest.approx(np.interp(mended.time_s, series.time_s, series.strain), abs=1e-3)
    assert mended.force_n.mean() == pytest.approx(series.force_n.mean(), rel=1e-3)


def test_jitter_of_the_strain_adds_no_way(series, tmp_path):
    """A noise of 0.03 % alone would break contacts at rest as fast as they heal; the numbers come back without it."""
    jittered = series.strain + 3e-4 * np.random.default_rng(0).standard_normal(len(series))
    mended = read_series(written(tmp_path / "s.csv", series, strain=jittered))
    assert "strain jitters by 0.0002" in mended.notes[0]
    way, raw, true = (np.abs(np.diff(strain)).sum() for strain in (mended.strain, jittered, series.strain))
    assert raw > 1.1 * true
    assert way == pytest.approx(true, rel=0.1)
    assert mended.strain == pytest.approx(series.strain, abs=9 * 3e-4)  # slack where it turns, and noise


def test_of_few_rows_that_alternate_half_are_left(series, tmp_path):
    """Fewer than a part that may be at rest: the jitter of strain is that of them all."""
    few = series.part(slice(440, 590))
    assert len(read_series(written(tmp_path / "s.csv", few, resistance_ohm=swung(few)))) == 75


def test_a_gap_is_bridged_at_rest_and_ends_a_part_in_motion(series, tmp_path):
    rest = series.part((series.time_s < 20) | (series.time_s > 60))
    assert "in which strain stayed: bridged" in read_series(written(tmp_path / "a.csv", rest)).notes[0]
    moving = series.part((series.time_s < 238) | (series.time_s > 300))
    kept = read_series(written(tmp_path / "b.csv", moving))
    assert (kept.time_s[0], kept.settled) == (300.5, False)
    assert "only the longest part" in kept.notes[0]
    assert "begins at a strain of 0.1" in kept.notes[1]


def logged(path, series, *runs):
    """A table of runs of a series, each from a time to another [s] on a clock that starts again."""
    rows = [np.flatnonzero((series.time_s >= begin_s) & (series.time_s < end_s)) for begin_s, end_s in runs]
    time_s = np.concatenate([series.time_s[own] - series.time_s[own[0]] for own in rows])
    return written(path, series.part(np.concatenate(rows)), time_s=time_s)


@pytest.mark.parametrize(("runs", "kept"), [([(0, 900), (900, 3000)], 1), ([(0, 1600), (1600, 3000)], 0)])
def test_of_a_clock_that_started_again_the_longest_run_is_used(series, runs, kept, tmp_path):
    """Sorted by time both would mingle. Of one after another what it remembers is found with the rest."""
    found = read_series(logged(tmp_path / "s.csv", series, *runs))
    begin_s, end_s = runs[kept]
    rows = (series.time_s >= begin_s) & (series.time_s < end_s)
    assert found.time_s == pytest.approx(series.time_s[rows] - begin_s)
    assert found.strain == pytest.approx(series.strain[rows], abs=1e-7)  # digits of the table
    assert found.notes[0] == "its clock steps back 1 time, first to 0 s: only the longest run is used"
    assert (found.settled, len(found.notes)) == (kept == 0, 1 + kept)


def test_rows_that_are_only_out_of_order_are_sorted(series, tmp_path):
    """Halves pasted the wrong way round, and rows that were logged a little late."""
    half, n = len(series) // 2, len(series) // 2 * 2
    for order in (np.r_[half:n, :half], np.arange(n) ^ 1):
        found = read_series(written(tmp_path / "s.csv", series.part(order)))
        assert found.notes == ("rows put in the order of time",)
        assert found.strain == pytest.approx(series.strain[:n], abs=1e-7)


REFUSED = {
    "ms for s": (lambda s: {"time_s": 1e3 * s.time_s}, "name the column time_ms"),
    "kΩ": (lambda s: {"resistance_ohm": s.resistance_ohm / 1e3}, "name the column resistance_kohm"),
    "percent": (lambda s: {"strain": 100 * s.strain}, "name it strain_pct"),
    "no strain": (lambda s: {"strain": 0.0 * s.strain}, "a specimen that is not stretched"),
    "column": (lambda s: {"force_n": None}, "the column force_n is missing"),
    "length": (lambda s: {"strain": None, "displacement_mm": 40 * s.strain}, "needs the specimen's length"),
    "meter": (lambda s: {"resistance_ohm": 0 * s.time_s + 900.0}, "was its meter connected"),
    "load cell": (lambda s: {"force_n": 0 * s.time_s}, "force_n stays 0: was its meter connected"),
    "no position": (lambda s: {"strain": s.strain[np.random.default_rng(0).permutation(len(s))]}, "of the specimen"),
    "few": (lambda s: {"resistance_ohm": np.where(s.time_s < 10, s.resistance_ohm, np.nan)}, "has 20 rows"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(series, name, tmp_path):
    change, says = REFUSED[name]
    with pytest.raises(FileFormatError, match=says) as refused:
        read_series(written(tmp_path / "s.csv", series, **change(series)))
    assert "\n" not in str(refused.value)


def test_gaps_in_motion_throughout_and_short_runs_alone_are_refused(series, tmp_path):
    holes = written(tmp_path / "s.csv", series.part(series.time_s % 60 < 30))
    short = logged(tmp_path / "t.csv", series, *((t, t + 40) for t in range(200, 500, 40)))
    for path, said in ((holes, "without gaps"), (short, "no run has 100 rows: record it again in one go")):
        with pytest.raises(FileFormatError, match=said):
            read_series(path)
