"""A Gymnasium environment: press a finger on the sensor with a given force.

Importing this module registers ``tripillar/Press-v0``; ``python examples/press_env.py`` presses twice,
slower the nearer it comes to the wanted force.
"""

from typing import Any

import gymnasium
import mujoco
import numpy as np
from finger_on_slab import CLEARANCE_MM, FINGERTIP, finger_on_slab, pad_stiffness, renderer
from gymnasium import spaces
from gymnasium.vector import SyncVectorEnv

import tripillar as tp
from fem.array.response import ArrayResponse
from tripillar.simulators.contacts import ContactReader
from tripillar.simulators.observations import TactileObservation, TactileVectorObservation

ID = "tripillar/Press-v0"
CONTROL_S = 0.02  #: time of a step
SPEED_MM_S = 20.0  #: of the finger's target at the largest action
DEEPEST_MM = 4.0  #: that the finger's target goes below the slab's top
TARGET_N = (2.0, 8.0)  #: range of the wanted normal force
MAX_PRESS_N = 12.0  #: normal force at which an episode ends
SIZE_PX = (480, 480)


class PressEnv(gymnasium.Env):
    """A finger that is to press a slab with a wanted force; without a sensor, which a wrapper adds.

    Actions, (3,) from −1 to 1, move the finger's target along x, y, z by at most 0.4 mm a step of 20 ms. Observations
    are the finger's place ``finger_mm`` and the wanted force ``target_n``. The reward is 0 at the wanted normal force
    and −1 without contact; beyond 12 N the episode ends, with −1 more.

    Parameters
    ----------
    design : SensorDesign
    response : ArrayResponse, optional
        Of the design, for the stiffness of the contact; default: solved, or from the cache.
    render_mode : {None, "rgb_array"}
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(1 / CONTROL_S)}  # noqa: RUF012 (gymnasium's own way)

    def __init__(
        self, design: tp.SensorDesign = FINGERTIP, response: ArrayResponse | None = None, render_mode: str | None = None
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode={render_mode!r} must be rgb_array, or left out.")
        response = tp.response(design) if response is None else response
        self.render_mode = render_mode
        self.model = finger_on_slab(design, pad_stiffness(response))  #: mujoco.MjModel
        self.data = mujoco.MjData(self.model)  #: mujoco.MjData
        self._contacts = ContactReader(self.model, site="sensor", geom="slab")
        self._renderer: Any = None
        self._goal_mm, self._target_n = np.zeros(3), 0.0
        x, y, _ = np.array(design.slab_mm) / 2.0 - design.array.pitch_mm / 2.0
        self._reach_mm = np.array([[-x, -y, -CLEARANCE_MM - DEEPEST_MM], [x, y, 0.0]])
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.observation_space = spaces.Dict(
            {
                "finger_mm": spaces.Box(-1e3, 1e3, (3,), np.float32),
                "target_n": spaces.Box(*TARGET_N, (1,), np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Put the finger above a random place, with a random force to reach."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self._goal_mm = self.np_random.uniform(*self._reach_mm) * (1.0, 1.0, 0.0)
        self._target_n = self.np_random.uniform(*TARGET_N)
        self.data.qpos[:] = self.data.ctrl[:] = self._goal_mm / 1000.0
        mujoco.mj_forward(self.model, self.data)
        return self._observation(), {}

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Move the finger's target for 20 ms."""
        action = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        self._goal_mm = np.clip(self._goal_mm + action * SPEED_MM_S * CONTROL_S, *self._reach_mm)
        self.data.ctrl[:] = self._goal_mm / 1000.0
        mujoco.mj_step(self.model, self.data, nstep=round(CONTROL_S / self.model.opt.timestep))
        pressed_n = self._contacts.read(self.data).net_n[2]
        is_over = bool(pressed_n > MAX_PRESS_N)
        reward = -float(abs(pressed_n - self._target_n) / self._target_n) - is_over
        return self._observation(), reward, is_over, False, {}

    def render(self) -> Any:
        """The scene, (480, 480, 3) of 0 to 255; None without a render mode."""
        if self.render_mode is None:
            return None
        if self._renderer is None:
            self._renderer = renderer(self.model, *SIZE_PX)
        self._renderer.update_scene(self.data)
        return self._renderer.render()

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _observation(self) -> dict[str, np.ndarray]:
        return {
            "finger_mm": (1000.0 * self.data.qpos).astype(np.float32),
            "target_n": np.array([self._target_n], dtype=np.float32),
        }


def press_env(
    *,
    design: tp.SensorDesign = FINGERTIP,
    model: Any = None,
    observe: str | None = None,
    response: ArrayResponse | None = None,
    render_mode: str | None = None,
    **sensor: Any,
) -> gymnasium.Env:
    """`PressEnv` with a sensor: what ``gymnasium.make("tripillar/Press-v0", ...)`` gives.

    Parameters
    ----------
    design : SensorDesign
    model : Decoupler or path, optional
        Decoder of the design's readings.
    observe : {"newtons", "ohms"}, optional
        Default: newtons with a model, else ohms.
    response : ArrayResponse, optional
    render_mode : {None, "rgb_array"}
    **sensor
        Further arguments of `VirtualSensor`, such as noise, bits, crossbar, gain_spread.
    """
    response = tp.response(design) if response is None else response
    env = PressEnv(design, response, render_mode)
    return TactileObservation(
        env, tp.VirtualSensor(design, model, response=response, **sensor), **_observed(model, observe)
    )


def press_vector_env(
    num_envs: int = 1,
    *,
    max_episode_steps: int | None = None,
    design: tp.SensorDesign = FINGERTIP,
    model: Any = None,
    observe: str | None = None,
    response: ArrayResponse | None = None,
    **sensor: Any,
) -> gymnasium.vector.VectorEnv:
    """Many of `press_env` with one `VirtualSensor`: ``gymnasium.make_vec("tripillar/Press-v0", num_envs=64, ...)``."""
    response = tp.response(design) if response is None else response

    def one() -> gymnasium.Env:
        env = PressEnv(design, response)
        return env if max_episode_steps is None else gymnasium.wrappers.TimeLimit(env, max_episode_steps)

    envs = SyncVectorEnv([one] * num_envs)
    reading = tp.VirtualSensor(design, model, response=response, environments=num_envs, **sensor)
    return TactileVectorObservation(envs, reading, **_observed(model, observe))


def _observed(model: Any, observe: str | None) -> dict[str, Any]:
    return {"observe": observe or ("ohms" if model is None else "newtons"), "site": "sensor", "geom": "slab"}


gymnasium.register(
    ID,
    entry_point=press_env,
    vector_entry_point=press_vector_env,
    max_episode_steps=250,
    disable_env_checker=True,
)

if __name__ == "__main__":
    env = gymnasium.make(ID, noise=0.001, bits=12)
    for _ in range(2):
        observation, info = env.reset()
        is_over = False
        while not is_over:
            missing = 1.0 - info["tactile"][2] / observation["target_n"][0]
            observation, reward, terminated, truncated, info = env.step(
                np.array([0.0, 0.0, -0.3 * missing], np.float32)
            )
            is_over = terminated or truncated
        print(f"pressed with {info['tactile'][2]:.1f} N, wanted {observation['target_n'][0]:.1f}: reward {reward:.2f}")
