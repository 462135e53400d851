"""Rubbers from bench series, which come back, are mended or refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from common.errors import DesignError, FileFormatError
from decoupler.rubber.belief import SensorFilter
from decoupler.rubber.check import checked, doubted, of_range, resistance_from_strain
from decoupler.rubber.fit import fit_elastic, identified
from decoupler.rubber.law import NAMES, numbers_of, settled_stress
from decoupler.rubber.rubber_file import extended, read_rubber, write_rubber
from decoupler.rubber.series import read_series
from geometry.design import Material, Memory, SensorDesign
from geometry.design_file import read_design
from geometry.law import LAWS
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
    return bench(rate_hz=1.0)


@pytest.fixture(scope="module")
def found(series):
    return identified(series, section_mm2=40.0, electrodes_mm=20.0)


def test_a_rubber_without_noise_comes_back():
    exact = bench(noise=0.0, rate_hz=1.0)
    found = identified(exact)
    off = np.abs(found.numbers - numbers_of(MEMORY))
    assert (off < 3 * np.sqrt(found.covariance.diagonal()) + 1e-6).all()
    assert off.max() < 1e-3
    assert found.elastic.model == "yeoh"
    assert found.elastic.stiffness_n == pytest.approx(5.0, rel=1e-2)
    assert found.elastic.prony.share == pytest.approx((0.06, 0.08), rel=0.1)


def is_found(rubber):
    """Whether its numbers are those of the bench, within four deviations."""
    return (np.abs(rubber.numbers - numbers_of(MEMORY)) < 4 * np.sqrt(rubber.covariance.diagonal())).all()


def test_a_noisy_one_comes_back_within_its_deviations(found):
    assert is_found(found)
    assert found.noise == pytest.approx(NOISE, rel=0.3)
    assert found.young_mpa == pytest.approx(3 * 5.0 / 40.0, rel=0.05)
    assert found.resistivity_ohm_mm == pytest.approx(1200.0 * 40.0 / 20.0, rel=0.03)
    fresh = bench(seed=1, rate_hz=1.0)
    assert of_range(resistance_from_strain(found, fresh), fresh.resistance_ohm) < 2.0


def a_memory(generator):
    """One that a silicone may have: what was published, and half as much again around it."""
    b, ratio, first, second = generator.uniform([0.8, 3.0, 4.0, 60.0], [2.5, 9.0, 14.0, 250.0])
    a, g1, g2 = generator.uniform(0.12, 0.5, 2), generator.uniform(0.5, 3.0), generator.uniform(-7.0, -3.0)
    return Memory(a=a, b_lengthen=b, b_shorten=ratio * b, tau_s=(first, second), g1=g1, g2=g2)


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
    times_s = np.array([0.0, 60, 60.2, 300, 300.2, 600, 600.2, 800, 800.2, 1200])
    one_level = np.array([0, 0, 1, 1, 0, 0, 1, 1, 0, 0]) * 0.3
    said = dict(identified(bench(programme=(times_s, one_level), noise=0.02, rate_hz=1.0)).unknown)
    assert any("g1" in what and "g2" in what for what in said)
    assert said["compression"].startswith("the same test pressed")
    stretched = identified(bench(programme=(times_s[:4], one_level[:4]), rate_hz=1.0))
    assert any("b_shorten" in what for what, _ in stretched.unknown)
    assert stretched.parameters["b_shorten"][1] == pytest.approx(stretched.parameters["b_shorten"][0] * 1.43, rel=0.2)
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
        ("\ng1 = [1.0000, ", "\ng1 = [2.0000, ", "lacks deviations above 0, and correlations alike across"),
        ("\ng1 = [1.0000, ", "\ng1 = [1.0, 1.0, ", "or it is no number"),
        ("\ng1 = 0.", "\ng1 = -0.", "lacks deviations above 0"),
        ("\ng2 = 0.", "\ng2 = inf # ", "lacks deviations above 0"),
        ("\ng2 = 0.", "\ng2 = nan # ", "lacks deviations above 0"),
        ("wires = 4", "wires = 7", "wires=7 must be 2 or 4"),
        ("wires = 4", "wires = 3", "wires=3 must be 2 or 4"),
        ("section_mm2 = 40.0", "section_mm2 = 0", "section_mm2=0 must be above 0"),
        ("\nnoise = ", "\nnoise = -1 # ", "noise=-1 must be from 0"),
        ("[rubber.unknown]", "[rubber.unsaid]", "unknown key 'unsaid'"),
        ("rest_ohm = ", "rest_ohm = nan # ", "rest_ohm=nan must be a finite number"),
        ("stiffness_n", "stiffness", r"unknown key 'stiffness' in .*cut.toml: \[rubber.elastic\]"),
        ("model = 'yeoh'", "model = 'ogden'", "model='ogden' must be one of linear"),
    ):
        (tmp_path / "cut.toml").write_text(text.replace(there, instead))
        with pytest.raises(DesignError, match=said):
            read_rubber(tmp_path / "cut.toml")
    contrary = np.eye(8)
    contrary[[0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]] = 0.9, 0.9, 0.9, -0.9, 0.9, -0.9
    rows = "\n".join(f"{name} = {row.tolist()}" for name, row in zip(NAMES, contrary, strict=True))
    head = text.partition("[rubber.correlations]")[0]
    (tmp_path / "cut.toml").write_text(f"{head}[rubber.correlations]\n{rows}\n")
    with pytest.raises(DesignError, match="lacks correlations that do not contradict each other"):
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
    found = identified(read.averaged(8), electrodes_mm=20.0, length_mm=40.0)
    assert found.contact_ohm == pytest.approx(15e3)
    assert found.contact_spread == pytest.approx(0.0, abs=1e-9)
    assert identified(read.averaged(8)).contact_ohm is None


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
    strain[[250, 600, 601]] = 0.0, -0.4, -0.4
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
    np.testing.assert_allclose(mended.resistance_ohm, same, rtol=0.02)
    np.testing.assert_allclose(mended.strain, np.interp(mended.time_s, series.time_s, series.strain), rtol=0, atol=1e-3)
    assert mended.force_n.mean() == pytest.approx(series.force_n.mean(), rel=1e-3)


def test_jitter_of_the_strain_adds_no_way(tmp_path):
    """A noise of 0.03 % alone would break contacts at rest as fast as they heal; the numbers come back without it."""
    series = bench(rate_hz=2.0)
    jittered = series.strain + 3e-4 * np.random.default_rng(0).standard_normal(len(series))
    mended = read_series(written(tmp_path / "s.csv", series, strain=jittered))
    assert "strain jitters by 0.0002" in mended.notes[0]
    way, raw, true = (np.abs(np.diff(strain)).sum() for strain in (mended.strain, jittered, series.strain))
    assert raw > 1.1 * true
    assert way == pytest.approx(true, rel=0.1)
    np.testing.assert_allclose(mended.strain, series.strain, rtol=0, atol=9 * 3e-4)  # slack where it turns, and noise


def test_of_few_rows_that_alternate_half_are_left(series, tmp_path):
    """Fewer than a part that may be at rest: the jitter of strain is that of them all."""
    few = series.part(slice(220, 370))
    assert len(read_series(written(tmp_path / "s.csv", few, resistance_ohm=swung(few)))) == 75


def moving(rate_hz):
    """Of a strip that moves all the time, by up to 0.3 Hz; without errors but rounded ones."""
    time_s = np.arange(0.0, 400.0, 1 / 20)
    waves = np.sin(2 * np.pi * np.outer(time_s, (0.023, 0.041, 0.083, 0.149, 0.293)) + np.arange(5)).sum(axis=1)
    strain = 0.3 * (waves - waves.min()) / np.ptp(waves) * np.clip((time_s - 10) / 5, 0, 1)
    return bench(noise=1e-3, programme=(time_s, strain), rate_hz=20.0).part(slice(None, None, round(20 / rate_hz)))


def jittered():
    """A wave and rests, of which jitter adds 3 % to the way, and breaks what heals at rest."""
    time_s = np.arange(0.0, 500.0, 0.1)
    wave = 0.15 * (1 - np.cos(0.6 * time_s)) * np.clip((time_s - 20) / 2, 0, 1) * np.clip((350 - time_s) / 2, 0, 1)
    true = bench(noise=3e-3, programme=(time_s, wave), rate_hz=10.0)
    return replace(true, strain=true.strain + 3e-4 * np.random.default_rng(0).standard_normal(len(true)))


def runs(series, *between_s):
    """Runs of a series, each from a time to another [s] on a clock that starts again."""
    rows = [np.flatnonzero((series.time_s >= begin_s) & (series.time_s < end_s)) for begin_s, end_s in between_s]
    time_s = np.concatenate([series.time_s[own] - series.time_s[own[0]] for own in rows])
    return replace(series.part(np.concatenate(rows)), time_s=time_s)


#: series, the first rows of their runs that do not begin at rest, what is said of them, and the parts of each step.
#: Of runs nothing is known in between; between few rows of a strip that moves all the time a curve is followed
GIVEN = {
    "gap at rest": (lambda s: s.part((s.time_s < 120) | (s.time_s > 180)), [120], "first from 119 s to 181 s", 1),
    "gap in motion": (lambda s: s.part((s.time_s < 238) | (s.time_s > 300)), [238], "first from 237 s to 301 s", 1),
    "clock again": (lambda s: runs(s, (0, 900), (900, 3000)), [900], " s to 0 s", 1),
    "all twice": (lambda s: runs(s, (0, 3000), (0, 3000)), [3000], " s to 0 s", 1),
    "last first": (lambda s: runs(s, (900, 1700), (0, 900)), [0, 800], " s to 0 s", 1),
    "jitter at rest": (lambda _: jittered(), [], "strain jitters by 0.0003", 1),
    "1 Hz": (lambda _: moving(1), [], "", 8),
    "4 Hz": (lambda _: moving(4), [], "", 8),
    "10 Hz": (lambda _: moving(10), [], "", 1),
}


@pytest.mark.parametrize("name", GIVEN)
def test_gaps_runs_few_rows_and_jitter_leave_the_rubber_what_it_is(series, name, tmp_path):
    """All rows are used, in their order; what a run remembers when it begins is found with it."""
    change, unsettled, said, parts = GIVEN[name]
    given = change(series)
    read = read_series(written(tmp_path / "s.csv", given))
    assert (read.unsettled, read.parts) == (unsettled, parts)
    assert [said in note for note in read.notes[:1]] == [True] * bool(said)
    assert not unsettled or f"2 runs of {len(read)} rows used" in read.notes[0]
    np.testing.assert_allclose(read.strain, given.strain, rtol=0, atol=9 * 3e-4 if name == "jitter at rest" else 1e-7)
    found = identified(read)
    assert is_found(found)
    assert checked(found, read).force_from_strain_nrmse_pct < 2


@pytest.mark.parametrize("stamp", [np.floor, lambda t: np.floor(t + 0.37), lambda t: 0.5 * np.floor(2 * t)])
def test_rows_that_share_the_time_of_a_coarse_clock_are_spread(stamp, tmp_path):
    """Their times are those between its ticks, but for a constant."""
    true = moving(10.0)
    read = read_series(written(tmp_path / "s.csv", true, time_s=stamp(true.time_s)))
    assert len(read) == len(true)
    assert np.ptp(read.time_s - true.time_s) < 0.011
    assert "rows share each time: spread over" in read.notes[0]


def test_a_mechanical_test_gives_the_law_of_the_force(series, tmp_path):
    path = written(tmp_path / "s.csv", series, resistance_ohm=None)
    read = read_series(path)
    found, whole = identified(read, section_mm2=40.0), identified(series, section_mm2=40.0)
    assert (found.elastic.model, found.memory) == (whole.elastic.model, Memory())
    assert found.young_mpa == pytest.approx(whole.young_mpa, rel=1e-6)  # digits of the table
    assert found.elastic.prony.share == pytest.approx(whole.elastic.prony.share, rel=1e-6)
    assert [what for what, _ in found.unknown] == ["all of the resistance", "compression"]
    assert checked(found, read).resistance_nrmse_pct is None
    write_rubber(found, tmp_path / "rubber.toml")
    design = read_design(tmp_path / "rubber.toml")
    assert design.pillar_material.prony.share == pytest.approx(found.elastic.prony.share, rel=1e-5)
    assert (read_rubber(tmp_path / "rubber.toml").rest_ohm, design.resistivity_ohm_mm) == (None, 4000.0)


def swapped_marks(text):
    return text.translate(str.maketrans(",.", ".,"))


#: how instruments and spreadsheets write a table of these cells
WRITTEN = {
    "semicolons": lambda rows: "\n".join(";".join(row).replace(".", ",") for row in rows),
    "tabs": lambda rows: "\n".join("\t".join(row).replace(".", ",") for row in rows),
    "quoted commas": lambda rows: "\n".join(",".join(f'"{cell.replace(".", ",")}"' for cell in row) for row in rows),
    "thousands": lambda rows: "\n".join(",".join(f'"{grouped(cell)}"' for cell in row) for row in rows),
    "european": lambda rows: "\n".join(";".join(swapped_marks(grouped(cell)) for cell in row) for row in rows),
    "spaces": lambda rows: "\n".join(";".join(grouped(cell).replace(",", "\xa0") for cell in row) for row in rows),
    "dates": lambda rows: "\n".join(";".join(["12.03.2024", *row]).replace(".", ",", 9) for row in rows),
    "units": lambda rows: "\n".join(map(",".join, [rows[0], ["(s)", "[mm/mm]", "N", "(Ω)"], *rows[1:]])),
    "blank lines": lambda rows: "\n\n,,,\n" + "\n,,,\n\n".join(map(",".join, rows)),
    "above": lambda rows: "sep=,\nProbe 7;alt\n# 1,2\n" + "\n".join(map(",".join, rows)),
    "trailing": lambda rows: "\n".join(",".join([*row, "", ""]) for row in rows),
    "carriage returns": lambda rows: "\r".join(map(",".join, rows)),
    "utf-16": lambda rows: "\n".join(map(",".join, rows)).encode("utf-16"),
    "gb2312": lambda rows: ("试验名称\n" + "\n".join(map(",".join, rows))).encode("gb2312"),
    "latin-1": lambda rows: ("Prüfung\n" + "\n".join(map(",".join, rows))).encode("latin-1"),
    "minus": lambda rows: "\n".join(map(",".join, rows)).replace("-", "\u2212"),
}


def grouped(cell):
    return f"{float(cell):,.7f}" if cell[-1].isdigit() else cell


@pytest.mark.parametrize("name", WRITTEN)
def test_tables_are_read_however_they_are_written(series, name, tmp_path, caplog):
    few = series.part(slice(220, 370))
    plain = written(tmp_path / "plain.csv", replace(few, resistance_ohm=1000 * few.resistance_ohm))
    rows = [line.split(",") for line in plain.read_text().splitlines()]
    content = WRITTEN[name](rows)
    (tmp_path / "s.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    read, true = read_series(tmp_path / "s.csv"), read_series(plain)
    for quantity, values in true.arrays.items():
        np.testing.assert_allclose(read.arrays[quantity], values, rtol=5e-7, atol=5e-7)
    assert read.notes == true.notes
    assert [f"read as {name}" in said for said in caplog.messages] == [True] * (name in ("gb2312", "latin-1"))


def test_rows_that_are_only_out_of_order_are_sorted(series, tmp_path):
    """Halves pasted the wrong way round, and rows that were logged a little late."""
    half, n = len(series) // 2, len(series) // 2 * 2
    for order in (np.r_[half:n, :half], np.arange(n) ^ 1):
        found = read_series(written(tmp_path / "s.csv", series.part(order)))
        assert found.notes == ("rows put in the order of time",)
        np.testing.assert_allclose(found.strain, series.strain[:n], rtol=0, atol=1e-7)
    time_s = series.time_s - series.time_s[0]
    time_s[1] = 1e-308  # nearer to the first than any clock tells
    found = read_series(written(tmp_path / "s.csv", replace(series, time_s=time_s)))
    assert found.notes == ("1 rows of the same time left out",)


REFUSED = {
    "ms for s": (lambda s: {"time_s": 1e3 * s.time_s}, "name the column time_ms"),
    "µs for s": (lambda s: {"time_s": 1e6 * s.time_s}, "name the column time_us"),
    "ns for s": (lambda s: {"time_s": 1e9 * s.time_s}, "name the column time_ns"),
    "hours for s": (lambda s: {"time_s": s.time_s / 3600}, "name the column time_h"),
    "ms for min": (lambda s: {"time_s": None, "time_min": 1e3 * s.time_s}, "name the column time_ms"),
    "days for s": (lambda s: {"time_s": 0.5 * s.time_s / 86400}, "name the column time_d"),
    "a second": (lambda s: {"time_s": s.time_s / 1e9}, "as no bench reads"),
    "two wires": (
        lambda s: {"two_wire_ohm": 0.6 * s.resistance_ohm},
        "two_wire_ohm is below the reading by four wires",
    ),
    "two alone": (lambda s: {"resistance_ohm": None, "two_wire_ohm": s.resistance_ohm}, "two_wire_ohm stands beside"),
    "kΩ": (lambda s: {"resistance_ohm": s.resistance_ohm / 1e3}, "name the column resistance_kohm"),
    "percent": (lambda s: {"strain": 100 * s.strain}, "name it strain_pct"),
    "no strain": (lambda s: {"strain": 0.0 * s.strain}, "a specimen that is not stretched"),
    "column": (lambda s: {"force_n": None}, "the column force_n is missing"),
    "length": (lambda s: {"strain": None, "displacement_mm": 40 * s.strain}, "needs the specimen's length"),
    "meter": (lambda s: {"resistance_ohm": 0 * s.time_s + 900.0}, "was its meter connected"),
    "load cell": (lambda s: {"force_n": 0 * s.time_s}, "force_n stays 0: was its meter connected"),
    "no position": (lambda s: {"strain": s.strain[np.random.default_rng(0).permutation(len(s))]}, "of the specimen"),
    "gaps": (lambda s: s.part(s.time_s % 60 < 30).arrays, "record it again in one go, without gaps"),
    "short runs": (lambda s: runs(s, *((t, t + 40) for t in range(200, 500, 40))).arrays, "too few runs have 100 rows"),
    "few": (lambda s: {"resistance_ohm": np.where(s.time_s < 20, s.resistance_ohm, np.nan)}, "has 20 rows"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(series, name, tmp_path):
    change, says = REFUSED[name]
    with pytest.raises(FileFormatError, match=says) as refused:
        read_series(written(tmp_path / "s.csv", series, **change(series)))
    assert "\n" not in str(refused.value)


DOUBTED = {
    "minutes": (lambda s: {"time_s": s.time_s / 60}, "contacts heal in 0.[12][0-9]* s, in silicone in 6 to 12"),
    "grams": (lambda s: {"force_n": s.force_n * 102}, "E is 3[0-9.]* MPa, silicone's 0.01 to 10"),
    "MN": (lambda s: {"force_n": s.force_n * 1e-6}, "E is 3[0-9.]*e-07 MPa"),
    "GΩ": (lambda s: {"resistance_ohm": s.resistance_ohm * 1e8}, "ρ is .* Ω mm, no filled silicone's"),
    "no force": (
        lambda s: {"force_n": np.random.default_rng(0).standard_normal(len(s))},
        "misses 1[0-9] % .* of force",
    ),
    "no strip": (lambda s: {"resistance_ohm": 900 + np.random.default_rng(0).uniform(size=len(s))}, "of resistance"),
    "conductance": (lambda s: {"resistance_ohm": 1e6 / s.resistance_ohm}, "is it a conductance"),
    "contacts": (lambda s: {"two_wire_ohm": 1.5 * s.resistance_ohm}, "two wires read less than four do"),
    "none": (lambda s: {}, "^$"),
}


@pytest.mark.parametrize("name", DOUBTED)
def test_a_rubber_that_no_silicone_is_is_doubted(series, name):
    change, says = DOUBTED[name]
    few = series.part(slice(0, 2000))
    few = replace(few, **change(few))
    found = identified(few, section_mm2=40.0, electrodes_mm=20.0, length_mm=40.0)
    assert re.search(says, doubted(found, few, checked(found, few), True))
