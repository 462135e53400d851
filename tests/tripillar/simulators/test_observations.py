"""What the sensor tells as an observation: the wrappers keep Gymnasium's rules, and tell what the sensor feels."""

import ctypes.util
import os
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from geometry.design import Array
from geometry.errors import ArgumentError

pytest.importorskip("mujoco")
gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402 (from here on: needs mujoco and gymnasium)

import tripillar as tp  # noqa: E402
from fem.array.closed_forms import layer_response  # noqa: E402
from tests.docs.terminal import ROOT  # noqa: E402
from tripillar.simulators import press  # noqa: E402
from tripillar.simulators.observations import TactileObservation, TactileVectorObservation  # noqa: E402
from tripillar.simulators.press_model import FINGERTIP, DrawingError, finger_on_slab, pad_stiffness, soften  # noqa: E402

DESIGN = replace(FINGERTIP, array=Array(rows=2, cols=3, pitch_mm=6.0))
DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)


@pytest.fixture(scope="module")
def response():
    return layer_response(DESIGN)


@pytest.fixture(scope="module")
def model(response):
    return tp.train(tp.dataset(response, "light", 300, seed=1, noise=1e-6), response=response)


@pytest.fixture
def made(response, model):
    """The registered environment with an exact sensor, or another one."""

    def made(**settings):
        return gymnasium.make(press.ID, **{"design": DESIGN, "response": response, "model": model} | settings)

    return made


@pytest.mark.parametrize("observe", ["newtons", "ohms"])
def test_the_registered_environment_keeps_the_rules(made, observe):
    """By Gymnasium's own checker, noise and another specimen at each reset included."""
    env = made(observe=observe, noise=0.001, gain_spread=0.05)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*different from the unwrapped version.*")  # the wrapper is on trial
        check_env(env, skip_render_check=True)
    assert env.observation_space["tactile"].shape == (2, 3, 3)
    env.close()


def test_decoded_newtons_are_those_of_mujoco(made):
    """Without noise the pads' forces sum to the net force of the contacts, within the training's error."""
    env = made()
    env.reset(seed=3)
    seen = []
    for _ in range(15):
        observation, _, over, _, info = env.step(DOWN)
        assert observation["tactile"].sum(axis=(0, 1)) == pytest.approx(info["tactile"], abs=0.02)
        seen.append(info["tactile"][2])
    assert seen[0] == 0
    assert seen[-1] > 2.0
    assert not over
    at_rest = made(observe="ohms").reset(seed=3)[0]["tactile"]
    assert at_rest[..., 0] == pytest.approx(10_000.0)  # FINGERTIP's resistivity makes it so


def test_a_press_is_rewarded_by_its_error_and_ends_beyond_what_is_allowed(made):
    """From no contact, −1, to the episode's end; on the way is the wanted force, 0."""
    env = made()
    start, _ = env.reset(seed=1)
    rewards = []
    for _ in range(100):
        observation, reward, over, _, info = env.step(DOWN)
        assert observation["target_n"] == start["target_n"]
        assert reward == pytest.approx(-abs(info["tactile"][2] / start["target_n"][0] - 1.0) - over, rel=1e-5)
        rewards.append(reward)
        if over:
            break
    assert rewards[0] == -1
    assert max(rewards) > -0.15
    assert over
    assert info["tactile"][2] > press.MAX_PRESS_N


def test_a_vector_reads_all_sensors_at_once_and_draws_those_anew_that_begin_again(response, model):
    """Equal to one alone; after an episode's end that environment has another specimen, its neighbours the same."""
    vector = gymnasium.make_vec(
        press.ID, num_envs=3, design=DESIGN, response=response, observe="ohms", gain_spread=0.1, max_episode_steps=30
    )
    assert isinstance(vector, TactileVectorObservation)
    at_rest = vector.reset(seed=[5, 6, 7])[0]["tactile"]
    assert np.array_equal(at_rest, vector.reset(seed=[5, 6, 7])[0]["tactile"])
    assert len({one.tobytes() for one in at_rest}) == 3
    actions = np.zeros((3, 3), dtype=np.float32)
    for k in range(10):
        told = vector.step(actions)[0]["tactile"]
        assert np.array_equal(told, at_rest), k
    mask = np.array([False, True, False])
    assert not np.array_equal(vector.reset(options={"reset_mask": mask})[0]["tactile"], at_rest)
    told = vector.step(actions)[0]["tactile"]
    assert (told == at_rest).all(axis=(1, 2, 3)).tolist() == [True, False, True]
    for _ in range(30):
        told = vector.step(actions)[0]["tactile"]  # 0 and 2 end and begin again
    assert not (told == at_rest).all(axis=(1, 2, 3)).any()
    assert vector.observation_space.contains(vector.step(actions)[0])

    noiseless = gymnasium.make_vec(press.ID, num_envs=2, design=DESIGN, response=response, model=model)
    noiseless.reset(seed=[8, 3])
    alone = gymnasium.make(press.ID, design=DESIGN, response=response, model=model)
    alone.reset(seed=3)
    for _ in range(15):
        both, one = noiseless.step(np.stack([0 * DOWN, DOWN])), alone.step(DOWN)
    assert both[0]["tactile"][1] == pytest.approx(one[0]["tactile"], abs=1e-4)
    assert both[4]["tactile"][1] == pytest.approx(one[4]["tactile"], rel=1e-12)
    assert one[4]["tactile"][2] > 2


def test_what_cannot_be_wrapped_is_refused(response, model):
    slab = {"site": "sensor", "geom": "slab"}
    env, sensor = press.PressEnv(DESIGN, response), tp.VirtualSensor(DESIGN, response=response)
    with pytest.raises(ArgumentError, match="no model to decode with"):
        TactileObservation(env, sensor, **slab)
    with pytest.raises(ArgumentError, match="must be newtons or ohms"):
        TactileObservation(env, sensor, observe="volts", **slab)
    with pytest.raises(ArgumentError, match="no model and data"):
        TactileObservation(gymnasium.make("CartPole-v1"), sensor, observe="ohms", **slab)
    once = TactileObservation(env, sensor, observe="ohms", **slab)
    with pytest.raises(ArgumentError, match="wrap it once"):
        TactileObservation(once, sensor, observe="ohms", **slab)
    two = gymnasium.vector.SyncVectorEnv([lambda: env] * 2)
    with pytest.raises(ArgumentError, match=r"environments=1, but there are 2"):
        TactileVectorObservation(two, sensor, observe="ohms", **slab)
    same_step = gymnasium.vector.SyncVectorEnv([lambda: env], autoreset_mode="SameStep")
    with pytest.raises(ArgumentError, match="NEXT_STEP"):
        TactileVectorObservation(same_step, sensor, observe="ohms", **slab)
    with pytest.raises(ArgumentError, match="render_mode='human'"):
        press.PressEnv(DESIGN, response, render_mode="human")


@pytest.mark.parametrize("times", [1.0, 30.0])
def test_contact_is_as_stiff_as_the_slab(response, times):
    """At rest each of the capsule's two contacts is a spring of the pads' stiffness, or of more: F = K · depth."""
    import mujoco

    stiffness = times * pad_stiffness(response)
    world = finger_on_slab(DESIGN, stiffness)
    data = mujoco.MjData(world)
    data.ctrl[2] = -0.006
    mujoco.mj_step(world, data, nstep=2000)
    reader = press.ContactReader(world, site="sensor", geom="slab")
    assert len(data.contact.dist) == 2
    assert reader.read(data).net_n[2] == pytest.approx(2 * stiffness * -1000 * data.contact.dist[0], rel=1e-3)
    assert data.qvel == pytest.approx(np.zeros(3), abs=1e-6)  # nothing chatters
    world.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    with pytest.raises(ArgumentError, match="elliptic"):
        soften(world, "slab", "finger", stiffness)


def test_a_picture_shows_the_scene_or_says_why_not(response):
    env = press.PressEnv(DESIGN, response, render_mode="rgb_array")
    env.reset(seed=0)
    said = ""
    try:
        picture = env.render()
    except DrawingError as error:
        said = str(error)
    assert "(no display): without a display set MUJOCO_GL=egl" in said or picture.std() > 10
    env.close()


@pytest.mark.skipif(not ctypes.util.find_library("EGL"), reason="EGL is not installed")
def test_a_picture_needs_no_display_where_egl_is():
    code = (
        "import mujoco\nfrom tripillar.simulators.press_model import FINGERTIP, finger_on_slab, renderer\n"
        "model = finger_on_slab(FINGERTIP, 8.0)\ndata = mujoco.MjData(model)\nmujoco.mj_forward(model, data)\n"
        "with renderer(model, 64, 48) as drawn:\n    drawn.update_scene(data)\n    print(drawn.render().std())\n"
    )
    environment = os.environ | {"MUJOCO_GL": "egl"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=ROOT)
    assert float(done.stdout) > 10, done.stderr


def test_a_seed_starts_all_that_is_drawn_anew(response):
    sensor = tp.VirtualSensor(DESIGN, noise=0.01, gain_spread=0.1, response=response)
    load = torch.zeros((1, 2, 3, 3), dtype=torch.float64)
    told = []
    for seed in (4, 4, None):
        sensor.reset(seed=seed)
        told.append(sensor.read(sensor.resistances(load)))
    assert torch.equal(told[0], told[1])
    assert not torch.equal(told[0], told[2])
