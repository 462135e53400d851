"""Known loads from tables and typed weights, and the calibrations that follow from them or are refused."""

import numpy as np
import pytest

from dataset.imperfections import Imperfections
from decoupler.data.columns import component_named, force_columns
from decoupler.inverse.forward_model import ForwardModel
from geometry import Array, SensorDesign
from geometry.errors import FileFormatError
from hardware.readout.averaging import averaged
from hardware.readout.calibration import Electronics
from hardware.readout.crossbar import Crossbar
from hardware.readout.known_loads import MeasuredLoads, calibrated, read_loads, weight
from tests.dataset.conftest import made_up_response

RESPONSE = made_up_response(SensorDesign(array=Array(rows=2, cols=3)))
NOTHING, KILOS = "0 0 0", "0 1 5000"


def measured(told, acting=None, times=1.0, noise=3e-4, seed=0):
    """Pairs of what was told and what a sensor as made shows under what acts, averaged over 150 scans of 12 bits."""
    generator, everything = np.random.default_rng(seed), component_named("all")
    crossbar = Crossbar(rows=2, cols=3, bits=12, noise=noise)
    gain, offset_ohm = Imperfections(gain_spread=0.2, offset_ohm=200.0, specimen=seed).gain_and_offset(2, 3)
    acting_n = np.stack([weight(text, 2, 3).force_n for text in acting or told])
    designed = ForwardModel.of(RESPONSE, everything).resistances(force_columns(acting_n, everything))
    ohms = gain * designed.reshape(-1, 2, 3, 3) + offset_ohm
    means, noises = zip(
        *(averaged(crossbar.counts(np.repeat(state[None], 150, axis=0), generator), crossbar) for state in ohms),
        strict=True,
    )
    return MeasuredLoads(
        names=told,
        force_n=np.stack([weight(text, 2, 3).force_n for text in told]),
        measured_ohm=times * np.stack(means),
        noise=float(np.median(noises)),
        serial=0,
    )


def fitted(pairs, **options):
    return calibrated(pairs, RESPONSE, Electronics(), None, **options)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_weights_as_told_are_taken(noise):
    for seed in range(20):
        found, residual = fitted(measured([NOTHING, KILOS, "1 2 5000"], noise=noise, seed=seed))
        assert residual < 1e-3
        assert 0.7 < found.gain.min() < found.gain.max() < 1.3


def test_weights_without_a_rest_are_taken():
    fitted(measured([KILOS, "1 2 5000"]))


@pytest.mark.parametrize(
    ("told", "acting", "times", "says"),
    [
        ([NOTHING], None, 1.0, "1 measured, all of the same forces, .* at least two loads that differ"),
        ([NOTHING, NOTHING], None, 1.0, "2 measured, all of the same forces"),
        (
            [NOTHING, KILOS],
            [NOTHING, NOTHING],
            1.0,
            f"load '{KILOS}' changed the resistances by [0-9]+ % of what it should",
        ),
        ([NOTHING, "1 2 5000", KILOS], [NOTHING, "1 2 5000", NOTHING], 1.0, f"load '{KILOS}' changed the resistances"),
        ([NOTHING, KILOS], [NOTHING, "1 0 5000"], 1.0, f"load '{KILOS}' changed the resistances by [0-9]+ % of"),
        ([NOTHING, KILOS, "1 2 5000"], [NOTHING, "1 2 5000", KILOS], 1.0, "changed the resistances by [0-9]+ % of"),
        ([NOTHING, "0 1 50000"], [NOTHING, "0 1 50"], 1.0, "load '0 1 50000' changed the resistances by [0-9]+ % of"),
        (
            [NOTHING, "0 1 500"],
            [NOTHING, "0 1 50000"],
            1.0,
            r"load '0 1 500' changed the resistances by [0-9]{4,} % of",
        ),
        ([NOTHING, "0 1 5"], [NOTHING, "0 1 5000"], 1.0, r"no load is large enough .* newtons, weights in grams"),
        ([KILOS, "1 2 5000"], [NOTHING, NOTHING], 1.0, "changed the resistances by [0-9]+ % of"),
        ([NOTHING, KILOS], None, 1e-3, "resistances are 0.001.* times those of the design: .* 1000 is kΩ for Ω"),
        ([NOTHING, KILOS], None, 1e3, "times those of the design: .* 1000 is kΩ for Ω"),
        ([NOTHING, KILOS], None, 3.0, r"resistances are 3\.?\d* times those of the design: check .*resistivity\. Or"),
    ],
)
def test_what_cannot_be_is_refused_unless_forced(told, acting, times, says):
    pairs = measured(told, acting, times)
    with pytest.raises(FileFormatError, match=says) as refused:
        fitted(pairs)
    assert str(refused.value).endswith("Or write it as it is with --force.")
    assert "\n" not in str(refused.value)
    fitted(pairs, force=True)


def table(tmp_path, *lines, header="load,row,col,fx_n,fy_n,fz_n,from_s,to_s"):
    path = tmp_path / "loads.csv"
    path.write_text("\n".join([header, *lines]))
    return path


def test_lines_of_one_load_act_together(tmp_path):
    path = table(tmp_path, "nothing,0,0,0,0,0,0,1", "a,1,2,0,0,5,2,3", "a,0,1,1.5,,-2,2,3", "b, 1, 1, , , 9.81, ,")
    nothing, a, b = read_loads(path, 2, 3)
    assert (nothing.name, nothing.force_n.any(), nothing.from_s, nothing.to_s) == ("nothing", False, 0.0, 1.0)
    assert a.force_n[1, 2].tolist() == [0, 0, 5]
    assert a.force_n[0, 1].tolist() == [1.5, 0, -2]
    assert (a.force_n != 0).sum() == 3
    assert (b.force_n[1, 1, 2], b.from_s, b.to_s) == (9.81, None, None)


def test_a_table_of_weights_needs_few_columns(tmp_path):
    (load,) = read_loads(table(tmp_path, "x,0,0,2.5", header="load,row,col,fz_n"), 1, 1)
    assert load.force_n.tolist() == [[[0, 0, 2.5]]]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("a,9,0,0,0,1,0,1", "no unit in row 9, col 0; rows are 0 to 1, columns 0 to 2"),
        ("a,0,-1,0,0,1,0,1", "no unit in row 0, col -1"),
        ("a,0,0,0,0,much,0,1", "line 2: fz_n is 'much', must be a number"),
        ("a,0,0,0,0,nan,0,1", "fz_n is 'nan'"),
        ("a,0.5,0,0,0,1,0,1", "row is '0.5', must be a whole number"),
        ("a,0,0,0,0,1,5,", "acts from 5.0 s to None s"),
        ("a,0,0,0,0,1,5,2", "acts from 5.0 s to 2.0 s"),
        ("a,0,0,0,0,1,0,1\na,0,1,0,0,1,0,2", "lines with different times"),
        ("a,0", "col is '', must be"),
    ],
)
def test_a_line_that_makes_no_sense_is_named(tmp_path, line, says):
    with pytest.raises(FileFormatError) as refused:
        read_loads(table(tmp_path, line), 2, 3)
    assert says in str(refused.value)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(FileFormatError, match=r"needs a header .* it has spam"):
        read_loads(table(tmp_path, "1", header="spam"), 2, 3)
    with pytest.raises(FileFormatError, match="no lines"):
        read_loads(table(tmp_path), 2, 3)
    with pytest.raises(FileFormatError, match="no such file"):
        read_loads(tmp_path / "nowhere.csv", 2, 3)


def test_a_weight_is_a_force_by_gravity():
    assert weight("1 2 1000", 2, 3).force_n[1, 2].tolist() == [0, 0, 9.80665]
    assert weight("1, 2, 1000", 2, 3).force_n.sum() == 9.80665


@pytest.mark.parametrize("text", ["", "1 2", "a b c", "1 2 3 4", "1 2 nan"])
def test_what_is_no_weight_is_refused(text):
    with pytest.raises(FileFormatError, match="is no weight: type row, column and grams"):
        weight(text, 2, 3)
