"""The examples: the press's decoded forces are MuJoCo's, in real time and in pictures."""

import re
import runpy
import sys

import pytest

from fem.array.closed_forms import layer_response
from tests.docs.terminal import ROOT

pytest.importorskip("mujoco")


@pytest.fixture
def example(monkeypatch, press_env):  # beside which it finds the finger's model
    monkeypatch.setenv("MUJOCO_GL", "")  # the example may set it; not for the tests after this one
    return runpy.run_path(str(ROOT / "examples" / "mujoco_press.py"))


def test_pressed_and_dragged_forces_are_decoded(example):
    """Two seconds of noise, 12 bits and crosstalk: 3 % of MuJoCo's normal force, the bar, over 150 scans."""
    response = layer_response(example["FINGERTIP"])
    scans = [scan for *_, scan in example["press"](response, example["trained"](response, 400), seconds=2.5)]
    found = example["errors"](scans, response.design)
    assert max(scan.applied_n[2] for scan in scans) > 10
    assert scans[-1].applied_n[0] > 2
    assert found["normal_share"] < 0.03
    assert found["shear_n"] < 0.1
    assert found["centre_mm"] < 0.5


@pytest.mark.long
def test_the_example_runs_to_its_end_with_a_picture_and_a_film(example, shared_cache, tmp_path, capsys):
    example["main"](tmp_path / "press.png", tmp_path / "press.mp4")
    said = capsys.readouterr().out
    assert float(re.search(r"([\d.]+)% of MuJoCo's", said)[1]) < 3
    assert float(re.search(r"([\d.]+) a second", said)[1]) > 100
    assert (tmp_path / "press.png").stat().st_size > 50_000
    assert b"moov" in (tmp_path / "press.mp4").read_bytes()


def test_the_environment_presses_with_about_the_wanted_force(press_env, capsys, monkeypatch):
    """`press_env.py` as a script: twice from no contact, within 5 %; by a closed form of its response."""
    sys.modules["gymnasium"].registry.pop(press_env.ID)
    monkeypatch.setattr("tripillar.response", layer_response, raising=False)
    runpy.run_path(press_env.__file__, run_name="__main__")
    rewards = re.findall(r"reward (−?-?[\d.]+)", capsys.readouterr().out)
    assert len(rewards) == 2
    assert all(float(reward) > -0.05 for reward in rewards)
