"""Measured pairs, tables of known loads that people write, and files that go wrong in the usual ways."""

import re
from dataclasses import replace

import numpy as np
import pytest

from common.errors import FileFormatError
from dataset import DatasetSettings, Imperfections, SampleError, Samples, simulate
from decoupler.data.columns import COMPONENTS, component_named
from decoupler.data.load_table import keep_pair, read_loads, read_pairs
from decoupler.data.pairs import Pairs
from decoupler.evaluation.plausibility import disturbance, doubt, nothing_to_learn, suspicion
from decoupler.inverse.sensor_model import SensorModel
from fem.array.closed_forms import layer_response
from geometry.design import Array, SensorDesign, Unit
from geometry.layout import LAYOUTS, Electrode, Layout, Pillar
from geometry.tolerances import with_values
from tests.decoupler.synthetic_sensor import ALL, labelled, response, sensor

PAD_MM2 = 144.0
DESIGN, LONE = sensor(2, 3), sensor(1, 1)
TIMED = "load,row,col,fx_n,fy_n,fz_n,from_s,to_s"
KINDS = "load,kind,row,col,fx_n,fy_n,fz_n,kpa,error,tilt,share"


def table(tmp_path, *lines, header=TIMED):
    path = tmp_path / "loads.csv"
    path.write_text("\n".join([header, *lines]))
    return path


def one(tmp_path, line, header=KINDS):
    (load,) = read_loads(table(tmp_path, f"a,{line}", header=header), DESIGN)
    return load


def test_lines_of_one_load_act_together(tmp_path):
    path = table(tmp_path, "nothing,0,0,0,0,0,0,1", "a,1,2,0,0,5,2,3", "a,0,1,1.5,,-2,2,3", "b, 1, 1, , , 9.81, ,")
    nothing, a, b = read_loads(path, DESIGN)
    assert (nothing.name, nothing.force_n.any(), nothing.from_s, nothing.to_s) == ("nothing", False, 0.0, 1.0)
    assert len(nothing.unknown_n) == 0
    assert (a.force_n[1, 2].tolist(), a.force_n[0, 1].tolist(), (a.force_n != 0).sum()) == ([0, 0, 5], [1.5, 0, -2], 3)
    assert (b.force_n[1, 1, 2], b.from_s, b.to_s) == (9.81, None, None)
    assert one(tmp_path, "0,0,2.5", header="load,row,col,fz_n").force_n[0, 0].tolist() == [0, 0, 2.5]


def test_tables_of_spreadsheets_are_read_as_they_are(tmp_path):
    """Columns without a name and empty lines are dropped; between semicolons decimals have commas."""
    path, plain = tmp_path / "loads.csv", ["load,row,col,fz_n,error", "a,0,1,2.5,2 %", "b,1,2,1.5 kg,", "rest,0,0,0,"]
    written = {
        "trailing": [f"{line},,," for line in plain],
        "blank": [plain[0], ",,,,", *plain[1:], ",,,,", ""],
        "semicolons": [line.replace(",", ";").replace(".", ",") for line in plain],
        "latin": ["Prüfung;;", *plain],
    }
    for lines in (plain, *written.values()):
        path.write_bytes("\n".join(lines).encode("latin-1"))
        assert [load.force_n.sum() for load in read_loads(path, DESIGN)] == [2.5, 1.5 * 9.80665, 0.0]
    path.write_text("\n".join([*plain, "c,0,0,1,,7"]))
    with pytest.raises(FileFormatError, match="line 5: has more values than the header"):
        read_loads(path, DESIGN)


def test_readings_of_one_pillar_a_unit_need_not_name_it(tmp_path):
    """As in a CSV table of samples; with more pillars r_0_0 is no column."""
    lines = ["a,0,1,2.5,100,200", "rest,0,0,0,101,201"]
    mat = SensorDesign(array=Array(rows=1, cols=2), unit=Unit(layout=LAYOUTS["single"]))
    for names in ("r_0_0,r_0_1", "r_0_0_z,r_0_1_z"):
        path = table(tmp_path, *lines, header=f"load,row,col,fz_n,{names}")
        assert read_pairs(path, mat).resistance_ohm[..., 0].tolist() == [[[100, 200]], [[101, 201]]]
    with pytest.raises(FileFormatError, match="not 'r_0_0'"):
        read_loads(table(tmp_path, *lines, header="load,row,col,fz_n,r_0_0,r_0_1"), replace(mat, unit=Unit()))


def test_a_pads_force_is_known_as_well_as_stated(tmp_path):
    """Standard deviation along the force is its error, across it its tilt; neither by default above 1 %."""
    exact = one(tmp_path, "pad,1,2,,,500 g,,2 %,1 %,")
    assert exact.force_n[1, 2, 2] == pytest.approx(0.5 * 9.80665)
    deviation = np.sqrt((exact.unknown_n**2).sum(axis=0))
    assert deviation[1, 2] == pytest.approx(4.903 * np.array([0.01, 0.01, 0.02]), rel=1e-3)
    assert np.count_nonzero(deviation) == 3
    assert np.abs(one(tmp_path, "pad,1,2,,,500 g,,0.3,0,").unknown_n).sum() == pytest.approx(0.3)
    assert np.abs(one(tmp_path, "pad,1,2,,,500 g,,,,").unknown_n).sum() == pytest.approx(3 * 0.01 * 4.903, rel=1e-3)


def test_of_a_plate_only_the_sum_is_known_and_air_presses_every_pad_alike(tmp_path):
    """The sum scatters by its error alone, each pad by its share, and all directions of the shares sum to 0."""
    plate = one(tmp_path, "plate,0-1,1-2,20,,400,,1 %,0,25 %")
    assert plate.force_n.sum(axis=(0, 1)).tolist() == [20, 0, 400]
    assert not plate.force_n[:, 0].any()
    sums = plate.unknown_n.sum(axis=(1, 2))
    assert np.sqrt((sums**2).sum(axis=0)) == pytest.approx([0.2, 0, 4])
    shares = plate.unknown_n[np.abs(sums).max(axis=1) < 1e-9]
    # of 4 pads: the stated deviation times sqrt(3/4), as of anything whose sum is known
    deviation = np.sqrt((shares**2).sum(axis=0))
    assert deviation[1, 1] == pytest.approx(np.sqrt(3 / 4) * np.array([np.hypot(10, 1.25), 10, 25]))
    air = one(tmp_path, "air,,,,,,50,2 kPa,,1 %")
    assert air.force_n[..., 2] == pytest.approx(np.full((2, 3), 50e-3 * PAD_MM2))
    assert air.unknown_n[0][..., 2] == pytest.approx(np.full((2, 3), 2e-3 * PAD_MM2))
    assert np.linalg.norm(air.unknown_n[1:, 0, 1, 2]) == pytest.approx(0.01 * 50e-3 * PAD_MM2)


def test_pairs_that_are_kept_come_back(tmp_path):
    """One after another, with all that is known of their forces; a table of another array is left alone."""
    header = "load,kind,row,col,fz_n,noise,r_0_0_z,r_0_0_x,r_0_0_y"
    path = table(tmp_path, "rest,nothing,,,,0.1 %,10000,14000,", "w,pad,0,0,1 kg,0.001,9900,13990,13990", header=header)
    pairs = read_pairs(path, LONE)
    assert (len(pairs), pairs.noise, pairs.names) == (2, 0.001, ("rest", "w"))
    assert np.isnan(pairs.resistance_ohm[0, 0, 0]).tolist() == [False, False, True]
    path, ohms = tmp_path / "pairs.csv", np.array([[[9900.0, np.nan, 13990.0]]])
    lines = "a,,0,0,,1 kg,2 %,", "b,,0,0,5,,,0", "b,,0,0,,1,,"
    loads = read_loads(table(tmp_path, *lines, header="load,kind,row,col,fx_n,fz_n,error,tilt"), LONE)
    for load in loads:
        keep_pair(path, replace(load, resistance_ohm=ohms, noise=2e-4), LONE.unit.layout)
    back = read_pairs(path, LONE)
    assert (back.names, back.noise) == (("a", "b"), 2e-4)
    assert np.array_equal(back.resistance_ohm[1], ohms, equal_nan=True)
    for k, load in enumerate(loads):
        assert np.array_equal(back.force_n[k], load.force_n)
        assert np.array_equal(back.unknown_n[k], load.unknown_n)
    with pytest.raises(FileFormatError, match="has other columns"):
        keep_pair(path, replace(loads[0], resistance_ohm=np.ones((1, 2, 3))), LONE.unit.layout)


@pytest.mark.parametrize(
    ("lines", "header", "says"),
    [
        (["a,9,0,0,0,1,0,1"], TIMED, "no unit in row 9; rows are 0 to 1, columns 0 to 2"),
        (["a,0,0,0,0,much,0,1"], TIMED, "line 2: fz_n is 'much', must be a number of newtons, or with a unit: N, kN"),
        (["a,0,0,0,0,5000,0,1"], TIMED, "5000 N on a pad is 34.7 MPa, more than 20: forces are in newtons; write"),
        (["a,0,0,0,0,1,5,2"], TIMED, "acts from 5.0 s to 2.0 s"),
        (["a,0,0,0,0,1,0,1", "a,0,1,0,0,1,0,2"], TIMED, "lines with different times"),
        (["a,string,0,0,,,1,,,,"], KINDS, "kind is 'string', must be one of pad, plate, air, nothing"),
        (["a,air,,,,,400,,,,"], KINDS, "fz_n is no part of kind air; it takes kpa"),
        (["a,plate,,,,,400,,-1 %,,"], KINDS, "error is '-1 %', must be a number from 0 on, or a percentage"),
        (["a,pad,0,0,,,400,,1 %,,20 %"], KINDS, "share is '20 %', but one pad takes all"),
        (["1"], "spam", "needs a header"),
        (["x,0,0,2.5,9,9"], "load,row,col,fz_n,r_0_0_z,r_2_0_z", "readings of 3 × 1 units, the design has 2 × 3"),
        (["x,0,0,2.5,9"], "load,row,col,fz_n,r_0_0_z2", "readings of a pillar z2, the design has 2 × 3 with pillars z"),
        (["x,0,0,2.5,9"], f"load,row,col,fz_n,r_{'9' * 5000}_0_z", "of 1000000000 × 1 units"),
        ([f"x,{'9' * 5000},0,2.5"], "load,row,col,fz_n", "line 2: row is '99999999999999999999', must be a whole"),
        (
            ["x,,,0"],
            "load,row,col,fz_n",
            "row is '', must be a whole number; of a line without a load write kind nothing",
        ),
        (
            ["x,0,0,2.5,9"],
            "load,row,col,fz_n,r_0_0_z_kohm",
            "'r_0_0_z_kohm': readings are in Ω, in columns such as r_0_",
        ),
        (["x,0,0,2.5"], "load,row,col,fz_n", "load 'x' has no readings: give columns r_0_0_z"),
    ],
)
def test_a_line_that_makes_no_sense_is_named(tmp_path, lines, header, says):
    path = table(tmp_path, *lines, header=header)
    with pytest.raises(FileFormatError) as refused:
        (read_pairs if "no readings" in says else read_loads)(path, DESIGN)
    assert says in str(refused.value)


def test_pairs_are_exact_if_of_samples_and_refused_if_they_are_none():
    dead = np.zeros((2, 3, 3), dtype=bool)
    dead[1, 2, 0] = True
    samples = Samples(force_n=np.ones((4, 2, 3, 3)), resistance_ohm=np.full((4, 2, 3, 3), 1e4), noise=0.01, dead=dead)
    pairs = Pairs.of(samples)
    assert np.isnan(pairs.resistance_ohm).sum() == 4
    assert (pairs.noise, len(pairs[1:]), sum(map(len, pairs.unknown_n))) == (0.01, 3, 0)
    ohms, newtons = np.full((2, 1, 1, 3), 1e4), np.zeros((2, 1, 1, 3))
    for given, says in (
        ({"resistance_ohm": ohms[:1]}, r"resistance_ohm has shape \(1, 1, 1, 3\), expected \(2, 1, 1, 3\)"),
        ({"resistance_ohm": -ohms}, "'pair 0': resistance_ohm is -10000.0 at sample 0, row 0, col 0, pillar z"),
        ({"resistance_ohm": ohms, "unknown_n": (np.zeros((0, 1, 1, 3)),)}, "1 unknown_n and 2 names"),
    ):
        with pytest.raises(SampleError, match=says):
            Pairs(force_n=newtons, **given)


SENSOR = sensor(3, 3)
JOINT = SensorModel.of(response(SENSOR), ALL)
SPECIMEN = Imperfections(gain_spread=0.1, offset_ohm=100.0, noise=1e-3, bits=12)


def read(data, specimen=SPECIMEN, seed=0):
    """What a specimen shows of exact readings."""
    generator = np.random.default_rng([seed, 1])
    ohm = specimen.apply(data.resistance_ohm, generator)
    dead = specimen.dead_mask(3, 3)
    stated = {"noise": specimen.noise, "bits": specimen.bits, "dead": dead if dead.any() else None}
    return replace(data, resistance_ohm=ohm, **stated)


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


def at(force_n, pad, times):
    """Forces of which one pad's are multiplied."""
    factor = np.ones((*force_n.shape[1:3], 1))
    factor[pad] = times
    return factor * force_n


OTHERS = read(labelled(SENSOR, "xyz", n_samples=30, seed=9))
SHUFFLED = np.random.default_rng(0).permutation(30)
NOT_LINKED = "if nothing linked them: give readings of this sensor, each with its load"
WRONG = {
    "kΩ": (turned(ohm=lambda R: R / 1000), r"0\.00\d+ times the design's: give them in Ω"),
    "kN": (
        turned(force=lambda F: F / 1000),
        r"all forces are 0\.00[01]\S* of what the readings say: kN\? multiply by 1000,",
    ),
    "mN": (turned(force=lambda F: F * 1000), r"mN\? multiply by 0\.001"),
    "kgf": (
        turned(force=lambda F: F / 9.80665),
        r"all forces are 0\.10\d of what the readings say: kgf\? multiply by 9\.807",
    ),
    "taken for kgf": (turned(force=lambda F: F * 9.80665), r"taken for kgf\? multiply by 0\.102"),
    "lbf": (turned(force=lambda F: F / 4.44822), r"lbf\? multiply by 4\.448"),
    "MPa": (turned(force=lambda F: F / 144), r"MPa\? multiply by 144"),
    "halved": (
        turned(force=lambda F: F / 2),
        r"halved\? multiply by 2, or give the design rubber 0\.\d+ times as stiff",
    ),
    "shear": (turned(force=lambda F: F * [0.5, 1, 1]), r"forces along x are 0\.\d+ of what .* halved\? multiply by 2"),
    "one pad": (turned(force=lambda F: at(F, (1, 2), 1.3)), r"forces of pad 1/2 \(row/col\) are 1\.\d+ of what the"),
    "some samples": (
        turned(force=lambda F: np.concatenate([F[:9] / 9.80665, F[9:]])),
        r"forces of 30% of the samples are 0\.1\S* of what the readings say: kgf",
    ),
    "two pads": (
        turned(force=lambda F: F.reshape(-1, 9, 3)[:, [3, 1, 2, 0, *range(4, 9)]].reshape(F.shape)),
        "order 1/0, 0/0",
    ),
    "signs": (turned(force=lambda F: -F), "all forces seem to have the other sign"),
    "sign of z": (turned(force=lambda F: F * [1, 1, -1]), "forces along z seem to have the other sign"),
    "axes": (turned(force=lambda F: F[..., [1, 0, 2]]), "axes seem to stand in the order y, x, z"),
    "transposed": (turned(force=lambda F: F.swapaxes(1, 2)), "rows and columns of the forces seem to be exchanged"),
    "columns": (turned(ohm=lambda R: R[:, :, ::-1]), "columns of the forces seem to stand in reverse order"),
    "order": (turned(ohm=lambda R: R[SHUFFLED]), NOT_LINKED),
    "of others": (turned(ohm=lambda R: OTHERS.resistance_ohm), NOT_LINKED),
    "constant": (turned(ohm=lambda R: np.repeat(R[:1], 30, axis=0)), NOT_LINKED),
    "contacts": (replace(PAIRS, made_from={"protocol": "indent"}), "no loads on pads: 'tripillar train --touch'"),
    "unloaded": (turned(force=lambda F: 0 * F), "every force is 0 N, though the resistances differ by more"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(name):
    """Thirty pairs and ten of a poor specimen: whatever it is, one line says it; of tables of loads, too."""
    data, said = WRONG[name]
    assert re.search(said, doubt(data, ALL, JOINT) or ""), doubt(data, ALL, JOINT)
    assert doubt(data[:10], ALL, JOINT) is not None
    if name not in ("contacts", "unloaded"):
        own = {"kΩ": "times those of the design", "MPa": "multiply by 144"}  # of pairs, which know no pads
        of_table = own.get(name, "load 'pair|nothing linked" if said == NOT_LINKED else said)
        by_table = doubt(Pairs.of(data), ALL, JOINT) or ""
        assert re.search(of_table, by_table), by_table


def test_loads_that_are_not_well_known_are_not_doubted_by_what_pads_share():
    """Of plates, under which pads' shares are known to 30 %, the sum alone is known."""
    force_n = np.ones((8, 3, 3, 1)) * [0.0, 0.0, 50.0] * np.arange(8.0)[:, None, None, None]
    acting = force_n * (1.0 + 0.3 * np.random.default_rng(3).standard_normal((8, 3, 3, 1)))
    ohms = JOINT.resistances(acting.reshape(8, -1)).reshape(8, 3, 3, 3)
    pairs = Pairs(resistance_ohm=ohms, force_n=force_n, unknown_n=tuple(0.3 * force_n[:, None]), noise=1e-3)
    assert (doubt(pairs, ALL, JOINT), suspicion(pairs, ALL, JOINT)) == (None, None)


def test_half_of_the_pads_that_differ_are_named():
    small = sensor(2, 2)
    data = simulate(layer_response(small), DatasetSettings(protocol="three-axis", samples=60, noise=1e-3))
    data = replace(data, force_n=data.force_n * [[[1.0], [1.3]]])
    said = doubt(data, ALL, SensorModel.of(layer_response(small), ALL)) or ""
    assert re.search(r"forces of pad 0/\d .* forces of pad 1/\d", said), said


@pytest.mark.parametrize("pillar", range(3))
def test_a_broken_pillar_is_no_mistake_in_the_forces_of_its_pad(pillar):
    """A wrong unit of that pad's forces is seen beside it."""
    small = sensor(2, 2)
    data = simulate(layer_response(small), DatasetSettings(protocol="three-axis", samples=100, noise=1e-3))
    stuck_ohm = 9e3 * (1.0 + 1e-3 * np.random.default_rng(5).standard_normal(100))
    data = replace(data, resistance_ohm=data.resistance_ohm.copy())
    data.resistance_ohm[:, 1, 1, pillar] = stuck_ohm
    judge = SensorModel.of(layer_response(small), ALL)
    assert doubt(data, ALL, judge) is None
    for times in (1 / 9.80665, 1.5):
        wrong = replace(data, force_n=at(data.force_n, (1, 1), times))
        assert "forces of pad 1/1" in (doubt(wrong, ALL, judge) or "")


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


AS_MADE = {
    "gains": {},
    "height": {"unit.height_mm": 10.2},
    "pads": {"pad.size_mm": 11.04},
    "off centre": {"pad.offset_x_mm": 0.5, "pad.offset_y_mm": -0.4},
    "softer": {"rubber.young_mpa": 4.6},
    "stretched": {"unit.span_mm": 10.3, "rubber.poisson": 0.48},
    "resistivity": {"resistivity_ohm_mm": 5200.0},
}


@pytest.mark.parametrize("layout", ["song2018", "six-pillar"])
@pytest.mark.parametrize("name", AS_MADE)
def test_sensors_as_made_are_neither_doubted_nor_suspected(layout, name):
    """Gains ± 10 %, offsets and another body; both kinds of loads. What is said of the design's would be of it."""
    design = sensor(3, 3, layout)
    joint, made = SensorModel.of(layer_response(design), ALL), layer_response(with_values(design, AS_MADE[name]))
    for protocol in ("three-axis", "contact"):
        settings = DatasetSettings(
            protocol=protocol, samples=60, noise=1e-3, bits=12, gain_spread=0.1, offset_ohm=100.0
        )
        data = replace(simulate(made, settings), design=design)
        assert (doubt(data, ALL, joint), suspicion(data, ALL, joint)) == (None, None)


def test_what_a_sensor_might_read_as_well_is_suspected():
    """Larger Fz, a load cell tared under load where gains hide no more, and one that pulls pads; a sensor of others."""
    joint = SensorModel.of(layer_response(SENSOR), ALL)
    data = simulate(layer_response(SENSOR), DatasetSettings(protocol="three-axis", samples=60, noise=1e-3))
    for force_n, said in (
        (data.force_n, None),
        (data.force_n * [1, 1, 1.45], r"forces along z are 1\.4\d of what the readings say: multiply by 0\.6"),
        (data.force_n - [0, 0, 100], r"-(9\d\.\d|10\d) N seem to be added to all Fz, .* tared under load\?"),
        (data.force_n - [0, 0, 250], r"Fz falls to -\d+ N on most pads, which pulls them"),
    ):
        given = replace(data, force_n=force_n)
        assert doubt(given, ALL, joint) is None
        assert re.search(said or "^None$", str(suspicion(given, ALL, joint))), suspicion(given, ALL, joint)
    poor = simulate(
        layer_response(SENSOR), DatasetSettings(protocol="contact", samples=99, noise=1e-3, gain_spread=0.1)
    )
    for added in (-100.0, -50.0, 50.0, 100.0):  # N; gains change no curvature of a reading over its load
        said = suspicion(replace(poor, force_n=poor.force_n + np.array([0.0, 0.0, added])), ALL, joint) or ""
        assert float(said.split(" N seem")[0]) == pytest.approx(added, abs=5.0)
    mirrored = replace(data, force_n=data.force_n[:, ::-1], resistance_ohm=data.resistance_ohm[:, ::-1])
    assert "rows of the readings and forces seem to stand in reverse order" in (doubt(mirrored, ALL, joint) or "")
    assert suspicion(PAIRS, ALL, JOINT) is None
    influence = response(SENSOR).influence_mm_per_n
    passing_on = replace(response(SENSOR), influence_mm_per_n=0.5 * np.roll(influence, 1, axis=4) + 0.5 * influence)
    assert "are they of another?" in (suspicion(PAIRS, ALL, SensorModel.of(passing_on, ALL)) or "")
    faint = read(lighter(labelled(SENSOR, "xyz", n_samples=30, seed=1), 0.001), Imperfections(noise=0.01))
    assert suspicion(faint, ALL, JOINT) is None
