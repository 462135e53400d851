"""The doctor on a machine that is well, and on one that is not."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from serial.tools import list_ports

from fem.kernel.factor import SolverError
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
    assert {name for name, *_ in KNOWN} <= set(states)
    assert all(bool(check["advice"]) == (check["state"] != "ok") for check in told["checks"])


def test_what_is_wrong_is_a_line_each_and_not_the_end(tmp_path, monkeypatch):
    """A solver that breaks, another answer, what may not be written or opened, and no way to draw: exit code 1."""

    def broken(*_):
        raise SolverError("no factor")

    monkeypatch.setattr(known_answers, "solve_response", broken)
    monkeypatch.setattr(known_answers, "KNOWN", [KNOWN[0], ("another", 0.01, "report it", lambda: 0.012)])
    known_answers._paper_response.cache_clear()
    response, other = known_answers.check_answers()
    assert (response.state, response.found, "pypardiso" in response.advice) == ("wrong", "SolverError: no factor", True)
    assert (other.state, other.found[:13], other.advice) == ("wrong", "error 1.2e-02", "report it")
    monkeypatch.setattr(list_ports, "comports", lambda: [SimpleNamespace(device="/dev/null")])
    assert surroundings.serial_ports().state == "ok"
    house = House(tmp_path)
    house.environment |= {"VTK_DEFAULT_OPENGL_WINDOW": "vtkNoSuchWindow", "DISPLAY": ""}
    monkeypatch.setattr(surroundings.os, "access", lambda *_: False)
    done = house.tripillar(*DOCTOR, "--no-compute")
    wrong = {check["name"]: check["advice"] for check in json.loads(done.stdout)["checks"] if check["state"] == "wrong"}
    assert (set(wrong), done.returncode) == ({"cache", "pictures", "serial ports"}, 1)
    assert ("TRIPILLAR_CACHE" in wrong["cache"], "dialout" in wrong["serial ports"]) == (True, True)


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
