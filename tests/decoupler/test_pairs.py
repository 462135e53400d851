"""Measured pairs, and the tables of known loads that people write."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import FileFormatError
from dataset import Samples
from dataset.samples import SampleError
from decoupler.data.load_table import keep_pair, read_loads, read_pairs
from decoupler.data.pairs import Pairs
from tests.decoupler.synthetic_sensor import sensor

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
        (
            ["x,0,0,2.5,9"],
            "load,row,col,fz_n,r_0_0_z2",
            "readings of a pillar z2, the design has 2 × 3 with pillars z, x, y",
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
