"""`tripillar identify`: from a table of pairs, or a data set, to a model; what to measure next; what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import DesignError
from dataset import DatasetSettings, Samples, read_samples, simulate
from decoupler.data.columns import component_named, force_columns
from decoupler.data.load_table import keep_pair, read_loads, read_pairs
from decoupler.evaluation.assessment import assess
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model_file import read_model, write_model
from decoupler.twin import write_twin
from geometry.design_file import design_to_toml
from tests.decoupler.synthetic_sensor import response, sensor, softness
from tests.decoupler.test_finite_strain import identified
from tests.house import House
from tripillar.face import stages, twins
from tripillar.face.caller import Caller, called_by
from tripillar.face.checks import warn_of_deviations
from tripillar.face.identifying import identify, plan_loads
from tripillar.face.learning import train

DESIGN = sensor(3, 3)
RESPONSE = response(DESIGN)
SENSITIVITIES = softness(DESIGN)
LOADS = """load,kind,row,col,fx_n,fz_n,error,tilt,share
rest,nothing,,,,,,,
all,plate,,,,3600,0,0,0
one,pad,1,1,40,400,0.1 %,0,
two,pad,0,2,,60 kg,0.1 %,0,
"""
IDENTIFY = ("identify", "--design", "sensor.toml", "-q")
TO_MODEL = ("-o", "m.safetensors")


def shown(force_n):
    """Resistances of the sensor under forces (n, 3, 3, 3)."""
    everything = component_named("all")
    return SensorModel.of(RESPONSE, everything).resistances(force_columns(force_n, everything)).reshape(-1, 3, 3, 3)


def forces(n):
    return np.random.default_rng(0).uniform(0.0, 1.0, (n, 3, 3, 3)) * [50.0, 50.0, 500.0]


def _derivatives(design, tolerances=None):
    return RESPONSE, SENSITIVITIES if tolerances is None else SENSITIVITIES.with_tolerances(tolerances)


@pytest.fixture
def house(tmp_path, monkeypatch):
    """A folder with a table of exact pairs and a design whose response is made up."""
    monkeypatch.setattr(twins, "with_derivatives", _derivatives)
    (tmp_path / "loads.csv").write_text(LOADS)
    (tmp_path / "sensor.toml").write_text(design_to_toml(DESIGN))
    for load in read_loads(tmp_path / "loads.csv", DESIGN):
        pair = replace(load, resistance_ohm=shown(load.force_n[None])[0], noise=1e-4)
        keep_pair(tmp_path / "pairs.csv", pair, DESIGN.unit.layout)
    return House(tmp_path)


def test_a_table_of_pairs_gives_a_model_and_what_to_measure_next(house):
    """The model reads loads that were not measured; the loads proposed make the expected error smaller and smaller."""
    told = house.result(*IDENTIFY, "--data", "pairs.csv", *TO_MODEL, "--next", "3")
    assert (told["pairs"], told["usual"], told["dead"]) == (4, "contact", [])
    assert told["parameters"]["rubber.young_mpa"][0] == pytest.approx(6.1, rel=0.05)
    force_n = np.zeros((1, 3, 3, 3))
    force_n[0, 2, 0] = [20.0, 0.0, 300.0]
    assert read_model(house.folder / "m.safetensors").forces(shown(force_n)) == pytest.approx(force_n, abs=10.0)
    errors = [told["next"][0]["error_before"], *(each["error"] for each in told["next"])]
    assert errors == sorted(errors, reverse=True)
    begin = house.result(*IDENTIFY, "--next", "9", "--have", "loads.csv")["next"]  # without pairs: of the table's only
    assert (len(begin), {each["load"] for each in begin}) == (4, {"rest", "all", "one", "two"})


def test_a_stuck_pillar_counts_as_dead(house):
    """Its gain would be nearly 0, and whatever it reads a wild force."""
    force_n = forces(30)
    stuck_ohm = shown(force_n)
    stuck_ohm[:, 1, 2, 0] = 9000.0
    Samples(force_n=force_n, resistance_ohm=stuck_ohm, design=DESIGN).write(house.folder / "stuck.nc")
    words = ("identify", "--data", "stuck.nc", *TO_MODEL, "-q")
    assert house.result(*words)["dead"] == ["z row 1 col 2"]
    assert "\npillars that are not read or stuck count as dead: z row 1 col 2\n" in house.tripillar(*words).stdout
    model = read_model(house.folder / "m.safetensors")
    assert (np.argwhere(model.dead).tolist(), model.is_identified) == ([[1, 2, 0]], True)


def test_a_pillar_without_a_column_is_named_as_dead(house):
    lines = [line.split(",") for line in (house.folder / "pairs.csv").read_text().splitlines()]
    lost = lines[0].index("r_1_1_z")
    (house.folder / "lost.csv").write_text("\n".join(",".join(line[:lost] + line[lost + 1 :]) for line in lines))
    assert house.result(*IDENTIFY, "--data", "lost.csv", *TO_MODEL)["dead"] == ["z row 1 col 1"]


def test_deviations_hold_for_usual_loads_which_are_said(house):
    """A data set of a protocol has loads of its own, one of a few chosen loads is a table: contacts are usual."""
    data = simulate(RESPONSE, DatasetSettings(protocol="three-axis", samples=9))
    chosen = replace(data, made_from=data.made_from | {"protocol": "table"})
    for name, samples in (("own.nc", data), ("chosen.nc", chosen)):
        samples.write(house.folder / name)
    for words, usual in (
        (("own.nc",), "three-axis"),
        (("chosen.nc",), "contact"),
        (("chosen.nc", "--usual", "three-axis"), "three-axis"),
    ):
        command = ("identify", "-q", *TO_MODEL, "--data", *words)
        assert house.result(*command)["usual"] == usual
        model = read_model(house.folder / "m.safetensors")
        assert model.made_from["protocol"] == usual
        assert model.inverse.centre_n.mean() == pytest.approx(twins._usual_loads(DESIGN, usual).mean())
    said = house.tripillar("identify", "-q", *TO_MODEL, "--data", "own.nc").stdout
    assert "deviations hold for three-axis loads alone; for others give --usual" in said


@pytest.mark.parametrize(
    ("protocol", "softer", "narrow", "says"),
    [
        ("contact", 1.0, (), None),
        (
            "three-axis",
            1.0,
            ("fx", "fy"),
            "own is made for contact loads, these are three-axis: 'tripillar identify --usu",
        ),
        ("contact", 1.2, ("fz",), "own seems to be of another sensor or other ranges of loads: 'tripillar identify"),
    ],
)
def test_deviations_that_hold_too_few_errors_are_warned_of(protocol, softer, narrow, says):
    designed = response(sensor(2, 3))
    tested = replace(designed, influence_mm_per_n=softer * designed.influence_mm_per_n)
    learned = simulate(designed, DatasetSettings(protocol="contact", samples=400, noise=1e-3))
    own = train(learned, hidden=2, max_iterations=3, response=designed)
    others = simulate(tested, DatasetSettings(protocol=protocol, samples=100, seed=2, noise=1e-3))
    assessed, said = assess(own, others, None), []
    with called_by(Caller(say=said.append)):
        warn_of_deviations(own, "own", others, "others", assessed)
    assert len(said) == (says is not None)
    for force in narrow:
        assert f"{force} {assessed[force].coverage[1]:.0%}" in said[0]
    assert says is None or says in said[0]


def test_doubtful_pairs_are_refused_unless_forced(house, monkeypatch):
    """Forces of contacts are no tractions on pads; and 60 kg are stated whose readings are those of nothing."""
    for words, says in (
        (("--data", "loads.csv"), "load 'rest' has no readings"),
        (("--next", "1", "--have", "pad:5lb"), "'pad:5lb' is no load that one can have: write kind:size"),
        (("--next", "1", "--have", "string:3kg"), "a string pulls on a weight: add pad:15kg"),
    ):
        assert says in house.refusal(*IDENTIFY, *words, *(TO_MODEL if "--data" in words else ()))
    force_n = forces(6)
    Samples(force_n=force_n, resistance_ohm=shown(force_n)).write(house.folder / "stateless.nc")
    without = house.refusal("identify", "--data", "stateless.nc", *TO_MODEL)
    assert "no design is stated" in without
    assert "give --design, or train on these pairs" in without
    pairs = Samples(force_n=force_n, resistance_ohm=shown(force_n), design=DESIGN, made_from={"protocol": "indent"})
    pairs.write(house.folder / "indent.nc")
    table = (house.folder / "pairs.csv").read_text().splitlines()
    rest, stated = table[1].split(","), table[4].split(",")
    (house.folder / "wrong.csv").write_text("\n".join([*table[:4], ",".join(stated[:13] + rest[13:])]))
    nothing = [*stated[:6], "1e-308", *stated[7:13], *rest[13:]]
    (house.folder / "tiny.csv").write_text("\n".join([*table[:2], ",".join(nothing)]))
    assert "no load is large enough to be told from" in house.refusal(*IDENTIFY, "--data", "tiny.csv", *TO_MODEL)
    for words, said in (
        (("identify", "--data", "indent.nc", "-q"), "presses shapes"),
        ((*IDENTIFY, "--data", "wrong.csv"), "load 'two' changed the resistances by 0 % of what it should"),
    ):
        assert said in house.refusal(*words, *TO_MODEL)
        house.result(*words, *TO_MODEL, "--force")
        assert said in read_model(house.folder / "m.safetensors").made_from["forced"]
        (house.folder / "m.safetensors").unlink()
    monkeypatch.setattr(twins, "design_of", lambda design: DESIGN)
    assumed = house.refusal("identify", "--data", "wrong.csv", *TO_MODEL)
    assert "wrong.csv (no design was given, the paper's was assumed: give --design): load 'two' changed" in assumed


def test_python_takes_what_the_command_takes(house, coarse, monkeypatch):
    """Tolerances of a design file, what you have, and any number of samples: of very many a draw."""
    text = (house.folder / "sensor.toml").read_text()
    (house.folder / "exact.toml").write_text(f'{text}\n[tolerance]\n"rubber.young_mpa" = 0\n')
    pairs = read_pairs(house.folder / "pairs.csv", DESIGN)
    twin = identify(pairs, house.folder / "exact.toml")
    proposed = plan_loads(twin, 2, have="plate:20kg,string:3kg")
    assert (twin.parameters, len(proposed)) == ({}, 2)
    assert all("20kg on a plate" in each.load or each.load == "nothing" for each in proposed)
    words = ("identify", "--design", "exact.toml", "-q", "--data", "pairs.csv", *TO_MODEL)
    by_command = house.result(*words, "--next", "2", "--have", "plate:20kg,string:3kg")
    assert [each["load"] for each in by_command["next"]] == [each.load for each in proposed]
    assert by_command["excess"] == twin.posterior.excess
    many, said = simulate(RESPONSE, DatasetSettings(protocol="contact", samples=9)).labels(), []
    other = Samples(force_n=np.ones((5, 1, 1, 3)), resistance_ohm=np.ones((5, 1, 1, 3)))
    with pytest.raises(DesignError, match="finite strain is of 1 × 1 units, the design of 3 × 3"):
        identify(many, DESIGN, finite=other)
    monkeypatch.setattr("tripillar.face.checks.drawn", lambda data, seed: data[:7])
    with called_by(Caller(say=said.append)):
        assert identify(many, DESIGN).n_pairs == 7
    assert "samples: 7 of 9 samples, drawn at random, identify the sensor" in said


def test_a_twin_at_finite_strain_makes_samples_of_its_rubber(house, monkeypatch):
    """As a file and as a directory, under the same loads; of a sensor of another rubber there are none."""
    twin, *_ = identified()
    write_model(twin.decoder, house.folder / "own.safetensors")
    write_twin(twin, house.folder / "twin.toml", house.folder / "own.safetensors")
    known = response(twin.design)
    monkeypatch.setattr(stages, "respond", lambda design, bars: (None, replace(known, design=design)))
    words = ("dataset", "--design", "twin.toml", "--protocol", "three-axis", "--samples", "9", "-q", "-o")
    for out in ("own.nc", "own.zarr"):
        house.result(*words, out)
    samples, again = (read_samples(house.folder / name)[:] for name in ("own.nc", "own.zarr"))
    assert samples.is_finite.all()
    assert samples.made_from["strain"] == "finite"
    assert np.array_equal(again.resistance_ohm, samples.resistance_ohm)
    said = house.refusal(*words, "linear.nc", "--strain", "linear")
    assert "a twin's samples are of the rubber that it was identified with: leave it out" in said
