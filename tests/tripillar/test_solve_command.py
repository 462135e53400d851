"""`tripillar solve`: one JSON object as the contract has it, one line for a mistake."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

import tripillar.cli.app
from tests.fem.scenes import BLOCK, PILLAR

KEYS = {"probes", "energy_mj", "residual", "dofs", "error_estimate", "seconds", "plan"}


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run a command in this process: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pillar.toml").write_text(PILLAR)
    (tmp_path / "block.toml").write_text(BLOCK)

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["tripillar", *words])
        with pytest.raises(SystemExit) as end:
            tripillar.cli.app.main()
        printed = capsys.readouterr()
        return int(end.value.code or 0), printed.out, printed.err

    return run


def test_the_answer_is_one_json_object(tmp_path):
    """As a person runs it: a process of its own, whose stdout holds nothing but the object."""
    (tmp_path / "pillar.toml").write_text(PILLAR + "[solve]\ntolerance = 0.02\n")
    command = [sys.executable, "-m", "tripillar", "solve", "pillar.toml", "--json", "--explain"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    found = json.loads(done.stdout)
    assert set(found) == KEYS
    assert set(found["seconds"]) == {"mesh", "assemble", "factor", "solve"}
    assert found["error_estimate"] <= 0.02
    ux, uy, uz = found["probes"]["top"]
    assert ux > 1  # pressed down, a pillar that leans to +x gives way along +x
    assert uz < -1
    assert abs(uy) < 1e-3
    # the load does its work on the mean displacement of the top: ½ f·u
    assert np.isclose(found["energy_mj"], 0.5 * -0.04 * uz, rtol=1e-6)
    assert any(line.startswith("mesh: structured hexahedra") for line in found["plan"])
    assert "mesh: structured hexahedra" in done.stderr


def test_tables_and_explanations_are_for_people(run):
    code, out, err = run("solve", "pillar.toml", "--explain", "--tolerance", "0.02")
    assert code == 0
    assert "mesh: structured hexahedra, the body is one box" in out
    assert "uz [mm]" in out
    assert "warning" not in err


def test_a_field_is_written_for_pictures(run, tmp_path):
    code, _, err = run("solve", "pillar.toml", "--no-skip", "hexahedra", "--tolerance", "0.05", "--vtu", "new/p.vtu")
    assert code == 0
    assert err.splitlines()[-1] == str(Path("new/p.vtu"))
    grid = pv.read(tmp_path / "new/p.vtu")
    assert np.isclose(grid.volume, 40.0, rtol=1e-6)
    assert -9 < grid.point_data["displacement_mm"][:, 2].min() < -1


def test_a_grid_is_written_for_pictures_too(run, tmp_path):
    code, _, _ = run("solve", "pillar.toml", "--tolerance", "0.02", "--vtu", "p.vtu")
    assert code == 0
    grid = pv.read(tmp_path / "p.vtu")
    assert np.isclose(grid.volume, 40.0, rtol=1e-6)
    assert -9 < grid.point_data["displacement_mm"][:, 2].min() < -1


def test_an_estimate_above_the_tolerance_is_a_warning(run, monkeypatch):
    monkeypatch.setattr("fem.methods.tetrahedral.MAX_UNKNOWNS", 1000)
    monkeypatch.setattr("fem.methods.richardson.MIN_MESHES", 1)
    monkeypatch.setattr("fem.methods.tetrahedral.estimated_errors", lambda *_: {"top": 0.3})
    code, out, err = run("solve", "pillar.toml", "--no-skip", "hexahedra", "--json")
    assert code == 0
    assert json.loads(out)["error_estimate"] == 0.3
    assert "warning: the estimated error 3.0e-01 stays above the tolerance 0.001" in err


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BLOCK.replace("size_mm = [10.0, 10.0]", "size_mm = [31.0, 10.0]"), "load 1 covers"),
        (BLOCK.replace("top_mm = [20.0", "top_mm = [29.5"), "inclusion 1 reaches from"),
        (BLOCK + BLOCK[BLOCK.index("[[inclusion]]") : BLOCK.index("[[load]]")], "inclusions 1 and 2 overlap"),
        (BLOCK.replace("position_mm = [15.0, 15.0, 5.0]", "position_mm = [15.0, 15.0, 11.0]"), "is in the air"),
        (BLOCK.replace("size_mm = [10.0, 10.0]", "size_mm = [0.0, 10.0]"), "must be above 0"),
        (BLOCK.replace("young_mpa = 6.1", "young_mpa = 'soft'"), "young_mpa='soft' must be a finite number"),
        (BLOCK.replace("tolerance = 2e-3", "tolerance = 0"), "tolerance=0 must be"),
        (BLOCK.replace("[solve]", "[solver]"), "unknown key 'solver'"),
    ],
)  # fmt: skip
def test_a_bad_scene_is_one_line_and_nothing_written(run, tmp_path, text, says):
    (tmp_path / "bad.toml").write_text(text)
    before = sorted(tmp_path.rglob("*"))
    code, out, err = run("solve", "bad.toml", "--json", "--vtu", "never.vtu")
    assert (code, out) == (2, "")
    (line,) = err.strip().splitlines()
    assert line.startswith("tripillar: bad.toml: ")
    assert says in line
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nowhere.toml"], "nowhere.toml: no such file"),
        (["."], ".: a folder, not a file"),
        (["pillar.toml", "--tolerance", "0"], "tolerance=0 must be a number above 0"),
        (["pillar.toml", "--tolerance", "nan"], "tolerance=nan must be a number above 0"),
        (["pillar.toml", "--no-skip", "lunch"], "unknown saving 'lunch'; known are zero-load"),
        (["block.toml", "--element", "Q2"], "element 'Q2' needs a grid, but 1 of 1 inclusion"),
        (["pillar.toml", "--element", "Q9"], "unknown element 'Q9'"),
        (["pillar.toml", "--solver", "abacus"], "unknown solver 'abacus'"),
        (["pillar.toml", "--vtu", "picture.png"], "--vtu picture.png must be a file that ends in .vtu"),
    ],
    ids=lambda value: value[-1] if isinstance(value, list) else None,
)
def test_a_mistake_is_one_line_and_writes_nothing(run, tmp_path, words, says):
    before = sorted(tmp_path.rglob("*"))
    code, out, err = run("solve", *words)
    assert (code, out) == (2, "")
    (line,) = err.strip().splitlines()
    assert says in line
    assert sorted(tmp_path.rglob("*")) == before
