"""`tripillar rubber` as it is typed: a series in, a rubber out, which designs extend and other series check."""

import csv
import re

import pytest

from decoupler.rubber.unknown import next_test
from geometry.design_file import read_design
from studies.pictures.rubber import MEMORY, bench
from tests.decoupler.test_rubber import written
from tests.house import House

SHORT = next_test()[0][:8], next_test()[1][:8]  #: rest and a hold


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    house = House(tmp_path_factory.mktemp("rubber"))
    for seed, name in enumerate(("series.csv", "other.csv")):
        written(house.folder / name, bench(seed=seed, programme=SHORT, rate_hz=1.0))
    return house


def test_a_series_becomes_a_rubber_that_is_checked_and_extended(house):
    folder = house.folder
    files = ("--out", "rubber.toml", "--picture", "rubber.png", "--next", "next.csv")
    found = house.result("rubber", "--data", "series.csv", "--section-mm2", "40", *files)
    assert found["parameters"]["b_shorten"][0] == pytest.approx(MEMORY.b_shorten, rel=0.5)
    assert found["young_mpa"] == pytest.approx(3 * 5.0 / 40, rel=0.1)
    assert {"what": "compression"}.items() <= found["unknown"][-1].items()
    assert found["resistance_nrmse_pct"] < 5
    assert (folder / "rubber.png").read_bytes()[:4] == b"\x89PNG"
    with (folder / "next.csv").open(newline="") as opened:
        rows = [(float(row["time_s"]), float(row["strain"])) for row in csv.DictReader(opened)]
    assert (rows[0], rows[-1][1]) == ((0.0, 0.0), 0.0)
    assert max(strain for _, strain in rows) == pytest.approx(0.2, rel=1e-3)  # as far as the series went
    judged = house.result("rubber", "--check", "rubber.toml", "--data", "other.csv")
    assert {*judged} == {"resistance_nrmse_pct", "force_from_strain_nrmse_pct"}
    assert judged["resistance_nrmse_pct"] < 8
    assert judged["force_from_strain_nrmse_pct"] < 2  # its noise is 1 % of the range
    house.result("design", "--extend", "rubber.toml,elastosil-m4601", "--rows", "2", "--out", "sensor.toml")
    design = read_design(folder / "sensor.toml")
    assert design.pillar_material.memory == read_design(folder / "rubber.toml").pillar_material.memory
    assert (design.array.rows, design.matrix_material.young_mpa) == (2, 0.72)


def test_people_read_numbers_with_deviations_and_what_is_not_told(house):
    done = house.tripillar("rubber", "--data", "series.csv", "--section-mm2", "40")
    assert done.returncode == 0
    assert "b_shorten = " in done.stdout
    assert re.search(r"^E = 0\.3\d+ MPa$", done.stdout, re.MULTILINE)  # 3 × 5 N / 40 mm²
    assert "unknown: compression: take the same test pressed" in done.stdout
