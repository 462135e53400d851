"""The robustness study on a small array: its nets are near their limits, and what it writes."""

import json

import pytest

from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, SensorDesign
from studies.robustness.nets import study_nets, write
from tests.studies.one_process import one_after_another


@pytest.fixture(scope="module")
def found():
    """2 × 2 units, their response in closed form."""
    response = solve_response(SensorDesign(array=Array(rows=2, cols=2)), ResponseSettings(method="layer"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("studies.robustness.nets.in_parallel", one_after_another)
        return study_nets(response, 300, tests=100)


def test_nets_are_near_the_limit(found):
    """300 samples leave 12 inputs of a linear layer 2 % above it, and 100 test samples know an error to 4 %."""
    ratios = [row["ratio"] for row in found if (row["part"], row["net"]) == ("noise", "inverse")]
    assert min(ratios) > 0.8
    assert max(ratios) < 1.15


def test_table_json_and_pictures_are_written(found, tmp_path):
    write(found, tmp_path)
    stored = json.loads((tmp_path / "robustness.json").read_text(encoding="utf-8"))
    assert len(stored["rows"]) == len(found)
    assert stored["rows"][0]["ratio"] == pytest.approx(found[0]["ratio"])
    assert [path.name for path in tmp_path.glob("*.png")] == ["robustness-readings.png"]
