"""Numbers of the page as text, colours and places."""

import numpy as np

from tripillar.viewer.page import numbers


def test_maps_lie_as_the_array_does():
    """The upper left cell is the last row's first unit: y up, x to the right."""
    values = np.array([[0.0, 1.0], [2.0, -4.0]])
    shown = numbers.as_map("Fz", "N", values, least=1.0)
    assert [cell["unit"] for cell in shown["cells"]] == [2, 3, 0, 1]
    assert [cell["text"] for cell in shown["cells"]] == ["2.0", "−4.0", "0.0", "1.0"]
    assert shown["most"] == "4.0"
    assert shown["cells"][1]["colour"] == numbers.colour(-1.0)


def test_noise_at_rest_stays_pale():
    shown = numbers.as_map("Fz", "N", np.array([[0.1]]), least=10.0)
    assert shown["cells"][0]["colour"].endswith("0.010)")


def test_pads_show_pressure_and_the_direction_of_shear():
    traction = np.array([[0.0, 0.3, -2.0], [0.0, 0.0, 0.001]])
    pressed, rest = numbers.pad_cells(traction, cols=2, most_mpa=5.0)
    assert (pressed["text"], pressed["arrow"]) == ("2.0", "↑")
    assert (rest["text"], rest["arrow"]) == ("", "")


def test_texts_of_odd_numbers():
    assert numbers.text(-0.004, 2) == "0.00"
    assert numbers.text(np.nan, 1) == "–"
    assert numbers.text(np.inf, 1) == "∞"
    assert numbers.colour(np.nan) == "transparent"


def test_tables_pair_what_acts_with_what_is_found():
    ohms, force = np.full((1, 2, 3), 10e3), np.arange(6.0).reshape(1, 2, 3)
    first, second = numbers.table_rows(ohms, force, force + 0.5, cols=2)
    assert first == ["0, 0", "10.000", "10.000", "10.000", "0.0", "0.5", "1.0", "1.5", "2.0", "2.5"]
    assert second[0] == "0, 1"


def test_a_sample_has_six_numbers_a_unit_and_none_for_what_is_unknown():
    change, force = np.full((1, 2, 3), 0.01), np.array([[[1.0, 2.0, np.nan], [4.0, 5.0, 6.0]]])
    assert numbers.sample(change, force) == [[1.0, 2.0, None, 1.0, 1.0, 1.0], [4.0, 5.0, 6.0, 1.0, 1.0, 1.0]]
