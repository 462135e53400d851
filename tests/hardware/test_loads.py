"""Known loads from tables and from typed weights."""

import pytest

from geometry.errors import FileFormatError
from hardware.readout.known_loads import read_loads, weight


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
