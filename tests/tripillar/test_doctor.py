"""The doctor on a machine that is well, and on one that is not."""

import json

import numpy as np
import pytest

from fem.factor import SolverError
from tests.docs.terminal import ROOT
from tests.house import House
from tripillar.doctor import known_answers, surroundings
from tripillar.doctor.known_answers import KNOWN

DOCTOR = ("doctor", "--json", "--quiet")


def test_a_sound_machine_is_found_sound(tmp_path):
    """What runs these tests has all that is needed; every known answer comes out."""
    done = House(tmp_path).tripillar(*DOCTOR)
    told = json.loads(done.stdout)
    states = {check["name"]: check["state"] for check in told["checks"]}
    assert [name for name, state in states.items() if state == "wrong"] == []
    assert (done.returncode, told["wrong"]) == (0, 0)
    assert {known.name for known in KNOWN} <= set(states)
    assert all(check["advice"] for check in told["checks"] if check["state"] != "ok")


def test_a_broken_solver_is_a_line_and_not_the_end(monkeypatch):
    def broken(*_):
        raise SolverError("no factor")

    monkeypatch.setattr(known_answers, "solve_scene", broken)
    monkeypatch.setattr(
        known_answers, "KNOWN", [known for known in KNOWN if known.name.startswith(("col", "res"))][::2]
    )
    column, resistance = known_answers.check_answers()
    assert (column.state, column.found) == ("wrong", "SolverError: no factor")
    assert "pypardiso" in column.advice
    assert resistance.state == "ok"


def test_a_wrong_answer_is_told(monkeypatch):
    monkeypatch.setattr(known_answers, "pillar_resistances", lambda *_: [8200.0])
    (known,) = (known for known in KNOWN if "pillar" in known.name)
    assert known.error() == pytest.approx(100 / 8100)
    assert known.error() > known.limit


def test_a_cache_that_cannot_be_written_is_wrong(tmp_path, monkeypatch):
    monkeypatch.setattr(surroundings.os, "access", lambda *_: False)
    found = surroundings.cache()
    assert (found.state, "TRIPILLAR_CACHE" in found.advice) == ("wrong", True)


def test_a_port_without_permission_names_the_group(monkeypatch):
    from hardware.link import serial_ports as ports

    monkeypatch.setattr(ports, "list_ports", lambda: [ports.Port(device="/dev/null", description="", hardware_id="")])
    assert surroundings.serial_ports().state == "ok"
    monkeypatch.setattr(surroundings.os, "access", lambda *_: False)
    assert (surroundings.serial_ports().state, "dialout" in surroundings.serial_ports().advice) == ("wrong", True)


def test_a_failure_ends_with_code_1(tmp_path):
    """VTK is told to use a window system that there is not: nothing can be drawn."""
    house = House(tmp_path)
    house.environment |= {"VTK_DEFAULT_OPENGL_WINDOW": "vtkNoSuchWindow", "DISPLAY": ""}
    done = house.tripillar(*DOCTOR, "--no-compute")
    wrong = [check["name"] for check in json.loads(done.stdout)["checks"] if check["state"] == "wrong"]
    assert (wrong, done.returncode) == (["pictures"], 1)


def test_the_known_response_is_that_of_the_benchmarks():
    """18 numbers of `studies/bench/references.json`, which the product does not hold, to seven digits."""
    scenes = json.loads((ROOT / "studies/bench/references.json").read_text(encoding="utf-8"))["scenes"]
    known = [[scenes[f"response-inner-{axis}"]["probes"][f"21-{name}"] for name in ("U1", "U2")] for axis in "xyz"]
    assert np.array(known_answers.MIDDLE_MM_PER_N) == pytest.approx(np.array(known), rel=1e-6)


def test_a_package_of_others_in_the_place_of_ours_is_named(tmp_path):
    """`dataset` of PyPI first on the path: every command says so, in one line, and does nothing."""
    other = tmp_path / "dataset" / "__init__.py"
    other.parent.mkdir()
    other.touch()
    house = House(tmp_path)
    house.environment |= {"PYTHONPATH": str(tmp_path)}
    done = house.process(*DOCTOR)
    (line,) = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (2, "")
    assert line.startswith(f"tripillar: 'dataset' comes from {other}, not from TriPillar")
