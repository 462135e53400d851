"""What the sensor tells as an observation: the wrappers keep Gymnasium's rules, and tell what the sensor feels."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from common.errors import ArgumentError
from fem.array.closed_forms import layer_response
from geometry.design import Array, Memory

pytest.importorskip("mujoco")
gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402 (from here on: needs mujoco and gymnasium)

import tripillar as tp  # noqa: E402
from tripillar.simulators.observations import TactileObservation  # noqa: E402

DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)


@pytest.fixture(scope="module")
def settings(press_env):
    """What the registered environment is made with: an exact sensor and its decoder."""
    response = layer_response(replace(press_env.FINGERTIP, array=Array(rows=2, cols=3, pitch_mm=6.0)))
    model = tp.train(tp.dataset(response, "light", 300, seed=1, noise=1e-6), response=response)
    return {"design": response.design, "response": response, "model": model}


@pytest.mark.parametrize("observe", ["newtons", "ohms"])
def test_the_registered_environment_keeps_the_rules(settings, press_env, observe):
    """By Gymnasium's own checker, noise and another specimen at each reset included."""
    env = gymnasium.make(press_env.ID, **settings, observe=observe, noise=0.001, gain_spread=0.05)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*different from the unwrapped version.*")  # the wrapper is on trial
        check_env(env, skip_render_check=True)
    assert env.observation_space["tactile"].shape == (2, 3, 3)


def test_decoded_newtons_are_those_of_mujoco_up_to_the_episodes_end(settings, press_env):
    """The pads' forces sum to the contacts' net force within the training's error; −1 without contact, 0 as wanted."""
    env = gymnasium.make(press_env.ID, **settings)
    start, _ = env.reset(seed=3)
    rewards, over = [], False
    while not over:
        observation, reward, over, _, info = env.step(DOWN)
        pressed_n = info["tactile"][2]
        assert over or observation["tactile"].sum(axis=(0, 1)) == pytest.approx(info["tactile"], abs=0.05)
        assert reward == pytest.approx(-abs(pressed_n / start["target_n"][0] - 1.0) - over, rel=1e-5)
        rewards.append(reward)
    assert rewards[0] == -1
    assert max(rewards) > -0.15
    assert pressed_n > press_env.MAX_PRESS_N


def test_a_vector_reads_all_sensors_at_once_and_draws_those_anew_that_begin_again(settings, press_env):
    """After an episode's end that environment has another specimen, its neighbours the same."""
    given = settings | {"model": None, "gain_spread": 0.1, "max_episode_steps": 30}
    vector = gymnasium.make_vec(press_env.ID, num_envs=3, **given)
    at_rest = vector.reset(seed=[5, 6, 7])[0]["tactile"]
    assert np.array_equal(at_rest, vector.reset(seed=[5, 6, 7])[0]["tactile"])
    assert len({one.tobytes() for one in at_rest}) == 3
    still = np.zeros((3, 3), dtype=np.float32)
    for _ in range(10):
        assert np.array_equal(vector.step(still)[0]["tactile"], at_rest)
    mask = np.array([False, True, False])
    assert not np.array_equal(vector.reset(options={"reset_mask": mask})[0]["tactile"], at_rest)
    assert (vector.step(still)[0]["tactile"] == at_rest).all(axis=(1, 2, 3)).tolist() == [True, False, True]
    for _ in range(30):
        told = vector.step(still)[0]["tactile"]  # 0 and 2 end and begin again
    assert not (told == at_rest).all(axis=(1, 2, 3)).any()
    assert vector.observation_space.contains(vector.step(still)[0])


def test_one_of_a_vector_is_as_one_alone(settings, press_env):
    vector, alone = gymnasium.make_vec(press_env.ID, num_envs=2, **settings), gymnasium.make(press_env.ID, **settings)
    vector.reset(seed=[8, 3])
    alone.reset(seed=3)
    for _ in range(15):
        both, one = vector.step(np.stack([0 * DOWN, DOWN])), alone.step(DOWN)
    assert both[0]["tactile"][1] == pytest.approx(one[0]["tactile"], abs=1e-4)
    assert both[4]["tactile"][1] == pytest.approx(one[4]["tactile"], rel=1e-12)
    assert one[4]["tactile"][2] > 2


def test_rubber_that_remembers_is_told_the_time_that_passed(settings, press_env, monkeypatch):
    told = []
    touch = tp.VirtualSensor.touch

    def spied(sensor, points_mm, force_n, seconds=None):
        told.append(seconds)
        return touch(sensor, points_mm, force_n, seconds)

    monkeypatch.setattr(tp.VirtualSensor, "touch", spied)
    rubber = replace(settings["design"].pillar_material, memory=Memory(a=(0.4, 0.3), b_lengthen=2.0, b_shorten=9.0))
    design = replace(settings["design"], pillar_material=rubber)
    given = {"design": design, "response": replace(settings["response"], design=design), "model": None}
    env = gymnasium.make(press_env.ID, **given)
    timestep_s = env.unwrapped.model.opt.timestep
    at_rest = env.reset(seed=1)[0]["tactile"]
    while not env.step(DOWN)[4]["tactile"][2] > 2:
        pass
    pressed = env.step(0 * DOWN)[0]["tactile"]
    assert told[0] == timestep_s
    assert told[1:] == pytest.approx([env.unwrapped.data.time / (len(told) - 1)] * (len(told) - 1))
    assert not np.allclose(pressed, at_rest, rtol=1e-3)
    assert env.reset(seed=1)[0]["tactile"] == pytest.approx(at_rest)
    assert told[-1] == timestep_s


def test_newtons_need_a_model(settings, press_env):
    sensor = tp.VirtualSensor(settings["design"], response=settings["response"])
    env = press_env.PressEnv(settings["design"], settings["response"])
    with pytest.raises(ArgumentError, match="no model to decode with"):
        TactileObservation(env, sensor, observe="newtons", site="sensor", geom="slab")
