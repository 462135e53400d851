"""Designs to cast, `design --for`: of silicones on sale, castable, readable, and as their own files say."""

import tomllib
from typing import get_args

import pytest

import tripillar as tp
from geometry.castability import castability
from geometry.silicones import SILICONES
from geometry.wiring import wires
from hardware.boards.sensor_header import fastest_hz
from tests.docs.terminal import ROOT
from tests.house import House
from tripillar.face.bodies import READY, Purpose, design
from tripillar.sweeps.judge import made_of
from tripillar.sweeps.sweep_file import read_sweep

PURPOSES = get_args(Purpose)


@pytest.mark.parametrize("purpose", PURPOSES)
def test_it_is_within_the_bounds_of_its_search_and_says_how_it_casts(purpose):
    """What closed forms tell; the response's range and errors are measured once, as the file says."""
    sensor, search = design(purpose=purpose), read_sweep(ROOT / "examples" / f"{purpose}.toml")
    made = made_of(sensor)
    excess = {name: bound.excess(made[name]) for name, bound in search.bounds.items() if name in made}
    assert len(excess) >= 4
    assert not any(excess.values()), excess
    text = (READY / f"{purpose}.toml").read_text()
    assert tomllib.loads(text)["matrix_material"] in SILICONES
    assert f"tripillar sweep examples/{purpose}.toml --optimize" in text
    cast, channels = castability(sensor), sensor.n_units * len(sensor.unit.layout.pillars)
    said = f"walls of {cast.wall_mm:.2f} mm, heels of {cast.undercut_mm:.2f} mm, faces {cast.demould_deg:.0f}° from"
    assert said in text
    rows, cols = wires(sensor.array.rows, sensor.array.cols, sensor.unit.layout)
    assert f"{channels} channels on {rows} + {cols} wires, {fastest_hz(channels):.0f} scans a second" in text


def test_what_is_known_of_it_is_written_and_told_unless_it_is_changed(tmp_path):
    """Its comments stand for that very design alone."""
    house = House(tmp_path)
    told = house.tripillar("design", "--for", "finger", "--out", "finger.toml").stdout
    about = (READY / "finger.toml").read_text().split("\n\n")[0]
    assert (house.folder / "finger.toml").read_text().startswith(f"{about}\n\n# A TriPillar")
    assert tp.read_design(house.folder / "finger.toml") == design(purpose="finger")
    assert told.splitlines()[0] == about.splitlines()[0].removeprefix("# ")
    house.tripillar("design", "--for", "finger", "--rows", "2", "--cols", "2", "--out", "small.toml")
    small = tp.read_design(house.folder / "small.toml")
    assert (small.array.rows, small.unit) == (2, design(purpose="finger").unit)
    assert "sweep" not in (house.folder / "small.toml").read_text()
    assert "--for hand must be one of finger, foot, seat" in house.refusal("design", "--for", "hand")
    with pytest.raises(tp.TriPillarError, match="purpose='hand' must be one of finger, foot, seat"):
        design(purpose="hand")
