"""Gymnasium wrappers: what the sensor tells, as an observation of any environment on MuJoCo. Loads gymnasium, torch."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
import torch

from common.errors import ArgumentError, needing
from dataset.imperfections import OPEN_OHM
from dataset.variables import MAX_N
from tripillar.simulators.contacts import ContactReader, stacked

with needing("the simulator", "simulators"):
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper

if TYPE_CHECKING:
    from hardware.virtual import VirtualSensor

Observed = Literal["newtons", "ohms"]
KEY = "tactile"  #: of the observation and of the net force in info


class _Touch:
    """Sensors on the slabs of e simulations, read together."""

    def __init__(self, envs: Sequence[gymnasium.Env], sensor: "VirtualSensor", observe: Observed, **slab: Any) -> None:
        if observe not in ("newtons", "ohms"):
            raise ArgumentError(f"observe={observe!r} must be newtons or ohms.")
        if sensor.environments != len(envs):
            raise ArgumentError(f"the sensor has environments={sensor.environments}, but there are {len(envs)}.")
        self.sensor, self._observe = sensor, observe
        self._worlds: list[Any] = [env.unwrapped for env in envs]
        for world in self._worlds:
            if not (hasattr(world, "model") and hasattr(world, "data")):
                raise ArgumentError(
                    f"{type(world).__name__} has no model and data: wrap an environment on MuJoCo, such as those of "
                    "gymnasium's MujocoEnv."
                )
        self._readers = [ContactReader(world.model, **slab) for world in self._worlds]
        self._read_s = np.array([world.data.time for world in self._worlds])
        self._like: dict[str, Any] = {"dtype": sensor.dtype, "device": sensor.device}
        if observe == "newtons":
            rest_ohm = sensor.resistances(torch.zeros((len(envs), *sensor.shape, 3), **self._like))
            axes = sensor.forces(rest_ohm).shape[-1]  # refuses a sensor without a model
            self._space = spaces.Box(-MAX_N, MAX_N, (*sensor.shape, axes), np.float32)
        else:
            self._space = spaces.Box(0.0, OPEN_OHM, (*sensor.shape, len(sensor.design.unit.layout.pillars)), np.float32)

    def space_with(self, space: spaces.Space) -> spaces.Dict:
        """The space of what one environment and its sensor tell."""
        held = dict(space.spaces) if isinstance(space, spaces.Dict) else {"observation": space}
        if KEY in held:
            raise ArgumentError(f"the environment has observations named {KEY} already: wrap it once.")
        return spaces.Dict(held | {KEY: self._space})

    def told(self, observation: Any, info: dict[str, Any], which: int | slice = slice(None)) -> tuple[Any, dict]:
        """Observation and info with what some of the sensors tell, and with the net forces of MuJoCo's contacts."""
        contacts = [reader.read(world.data) for reader, world in zip(self._readers, self._worlds, strict=True)]
        with torch.no_grad():
            where, how = (torch.as_tensor(values, **self._like) for values in stacked(contacts))
            reading = self.sensor.touch(where, how, self._seconds())
        told = reading.decoded_n if self._observe == "newtons" else reading.resistance_ohm
        assert told is not None
        within = told.cpu().numpy().clip(self._space.low.flat[0], self._space.high.flat[0]).astype(np.float32)
        held = dict(observation) if isinstance(observation, dict) else {"observation": observation}
        net_n = np.array([one.net_n for one in contacts])
        return held | {KEY: within[which]}, info | {KEY: net_n[which]}

    def _seconds(self) -> float:
        """Since the last reading, in simulations that step together; a time step where all were reset."""
        now_s = np.array([world.data.time for world in self._worlds])
        passed_s, self._read_s = float((now_s - self._read_s).max()), now_s
        return passed_s if passed_s > 0.0 else float(self._worlds[0].model.opt.timestep)


class TactileObservation(gymnasium.Wrapper):
    """Adds a sensor's reading to the observations of an environment on MuJoCo.

    Observations become a dict: those of the environment (under ``observation`` if they are no dict) and ``tactile``,
    shape (rows, cols, k), float32: forces on the pads along x, y, z [N], Fz positive in compression, as the sensor's
    model decodes them, or resistances of the pillars z, x, y [Ω]. ``info["tactile"]`` is the net force of MuJoCo's
    contacts on the slab's top, (3,) [N], in the sensor's frame.

    ``env.unwrapped`` has MuJoCo's ``model`` and ``data``, which stay the same objects. The `VirtualSensor` is of one
    environment; each reset draws its imperfections anew, by the seed if there is one. ``**slab`` says where it is in
    the model, as `ContactReader` takes it. What does not fit together is an `ArgumentError`.
    """

    def __init__(
        self, env: gymnasium.Env, sensor: "VirtualSensor", *, observe: Observed = "newtons", **slab: Any
    ) -> None:
        super().__init__(env)
        self._touch = _Touch([env], sensor, observe, **slab)
        self.observation_space = self._touch.space_with(env.observation_space)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and draw another specimen of the sensor."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._touch.sensor.reset(None, seed=seed)
        return self._touch.told(observation, info, 0)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, then read the sensor."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        observation, info = self._touch.told(observation, info, 0)
        return observation, reward, terminated, truncated, info


class TactileVectorObservation(VectorWrapper):
    """`TactileObservation` for a ``SyncVectorEnv``, whose environments one `VirtualSensor` of as many reads at once.

    Its autoreset mode is ``NEXT_STEP`` or ``DISABLED``. Where an environment is reset, its sensor's imperfections are
    drawn anew; a seed starts them all anew. Environments in processes of their own (`AsyncVectorEnv`) keep their
    contacts to themselves: there wrap each with `TactileObservation`. Another kind of vector or mode is an
    `ArgumentError`, too.
    """

    def __init__(self, env: VectorEnv, sensor: "VirtualSensor", *, observe: Observed = "newtons", **slab: Any) -> None:
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, SyncVectorEnv):
            raise ArgumentError(
                f"{type(inner).__name__} cannot be read at once: give a SyncVectorEnv, or wrap each environment with "
                "TactileObservation."
            )
        if inner.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP:
            raise ArgumentError("autoreset_mode SAME_STEP hides the last contacts: make the vector with NEXT_STEP.")
        self._resets_next = inner.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        self._touch = _Touch(inner.envs, sensor, observe, **slab)
        self._is_over = np.zeros(self.num_envs, dtype=bool)
        self.single_observation_space = self._touch.space_with(env.single_observation_space)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset all environments, or those of ``options["reset_mask"]``, and draw their sensors anew."""
        mask = (options or {}).get("reset_mask")  # the environment takes it out of its options
        observation, info = self.env.reset(seed=cast(Any, seed), options=options)
        known = [one for one in (seed if isinstance(seed, list) else [seed]) if one is not None]
        entropy = int(np.random.SeedSequence(known).generate_state(1)[0]) if known else None
        self._touch.sensor.reset(None if mask is None else torch.as_tensor(mask), seed=entropy)
        self._is_over = np.zeros(self.num_envs, dtype=bool) if mask is None else self._is_over & ~mask
        return self._touch.told(observation, info)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all environments, then read all sensors."""
        observation, rewards, terminations, truncations, info = self.env.step(actions)
        if self._resets_next and self._is_over.any():
            self._touch.sensor.reset(torch.as_tensor(self._is_over), seed=None)
        self._is_over = terminations | truncations
        observation, info = self._touch.told(observation, info)
        return observation, rewards, terminations, truncations, info
