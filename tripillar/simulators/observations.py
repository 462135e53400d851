"""Gymnasium wrappers: what the sensor tells, as an observation of any environment on MuJoCo. Loads gymnasium, torch."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
import torch

from dataset.imperfections import OPEN_OHM
from dataset.variables import MAX_N
from geometry.errors import ArgumentError, needing
from geometry.layout import FloatArray
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
        self._sensor, self._observe = sensor, observe
        self._worlds: list[Any] = [env.unwrapped for env in envs]
        for world in self._worlds:
            if not (hasattr(world, "model") and hasattr(world, "data")):
                raise ArgumentError(
                    f"{type(world).__name__} has no model and data: wrap an environment on MuJoCo, such as those of "
                    "gymnasium's MujocoEnv."
                )
        self._readers = [ContactReader(world.model, **slab) for world in self._worlds]
        force_n = torch.zeros((len(envs), *sensor.shape, 3), dtype=sensor.dtype, device=sensor.device)
        if observe == "newtons":
            axes = sensor.forces(sensor.resistances(force_n)).shape[-1]  # refuses a sensor without a model
            self.space = spaces.Box(-MAX_N, MAX_N, (*sensor.shape, axes), np.float32)
        else:
            self.space = spaces.Box(0.0, OPEN_OHM, (*sensor.shape, 3), np.float32)

    def reset(self, which: Any, seed: int | None) -> None:
        self._sensor.reset(which, seed=seed)

    def read(self) -> tuple[FloatArray, FloatArray]:
        """What is observed, (e, *space.shape), and the net forces of MuJoCo's contacts, (e, 3) [N]."""
        contacts = [reader.read(world.data) for reader, world in zip(self._readers, self._worlds, strict=True)]
        points, forces = (
            torch.as_tensor(values, dtype=self._sensor.dtype, device=self._sensor.device)
            for values in stacked(contacts)
        )
        with torch.no_grad():
            reading = self._sensor.touch(points, forces)
        told = reading.decoded_n if self._observe == "newtons" else reading.resistance_ohm
        assert told is not None
        within = np.clip(told.cpu().numpy(), self.space.low.flat[0], self.space.high.flat[0])
        return within.astype(np.float32), np.array([one.net_n for one in contacts])


class TactileObservation(gymnasium.Wrapper):
    """Adds a sensor's reading to the observations of an environment on MuJoCo.

    Observations become a dict: those of the environment (under ``observation`` if they are no dict) and ``tactile``,
    shape (rows, cols, k), float32: forces on the pads along x, y, z [N], Fz positive in compression, as the sensor's
    model decodes them, or resistances of the pillars z, x, y [Ω]. ``info["tactile"]`` is the net force of MuJoCo's
    contacts on the slab's top, (3,) [N], in the sensor's frame.

    Parameters
    ----------
    env : gymnasium.Env
        ``env.unwrapped`` has MuJoCo's ``model`` and ``data``, which stay the same objects.
    sensor : VirtualSensor
        Of one environment; each reset draws its imperfections anew, by the seed if there is one.
    observe : {"newtons", "ohms"}
    **slab
        Where it is in the model, as `ContactReader` takes it: site, geom or body, mm_per_length.

    Raises
    ------
    ArgumentError
        If the environment has no model, the model no such names, the sensor no decoder for newtons or another number
        of environments.
    """

    def __init__(
        self, env: gymnasium.Env, sensor: "VirtualSensor", *, observe: Observed = "newtons", **slab: Any
    ) -> None:
        super().__init__(env)
        self._touch = _Touch([env], sensor, observe, **slab)
        self.observation_space = _space_with(env.observation_space, self._touch.space)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and draw another specimen of the sensor."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._touch.reset(None, seed)
        return self._with_touch(observation, info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, then read the sensor."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        observation, info = self._with_touch(observation, info)
        return observation, reward, terminated, truncated, info

    def _with_touch(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        told, net_n = self._touch.read()
        return _with(observation, told[0]), info | {KEY: net_n[0]}


class TactileVectorObservation(VectorWrapper):
    """`TactileObservation` for vectors of environments, which one `VirtualSensor` reads at once.

    Parameters
    ----------
    env : gymnasium.vector.SyncVectorEnv
        With autoreset mode ``NEXT_STEP`` or ``DISABLED``. Environments in processes of their own (`AsyncVectorEnv`)
        keep their contacts to themselves: there wrap each with `TactileObservation`.
    sensor : VirtualSensor
        Of as many environments; where one is reset, its imperfections are drawn anew. A seed starts them all anew.
    observe, **slab
        As of `TactileObservation`.

    Raises
    ------
    ArgumentError
        As `TactileObservation` does, and of another kind of vector or autoreset mode.
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
        self.single_observation_space = _space_with(env.single_observation_space, self._touch.space)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset all environments, or those of ``options["reset_mask"]``, and draw their sensors anew."""
        mask = (options or {}).get("reset_mask")  # the environment takes it out of its options
        observation, info = self.env.reset(seed=cast(Any, seed), options=options)
        known = [one for one in (seed if isinstance(seed, list) else [seed]) if one is not None]
        entropy = int(np.random.SeedSequence(known).generate_state(1)[0]) if known else None
        self._touch.reset(None if mask is None else torch.as_tensor(mask), entropy)
        self._is_over = np.zeros(self.num_envs, dtype=bool) if mask is None else self._is_over & ~mask
        return self._with_touch(observation, info)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all environments, then read all sensors."""
        observation, rewards, terminations, truncations, info = self.env.step(actions)
        if self._resets_next and self._is_over.any():
            self._touch.reset(torch.as_tensor(self._is_over), None)
        self._is_over = terminations | truncations
        observation, info = self._with_touch(observation, info)
        return observation, rewards, terminations, truncations, info

    def _with_touch(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        told, net_n = self._touch.read()
        return _with(observation, told), info | {KEY: net_n}


def _space_with(space: spaces.Space, tactile: spaces.Box) -> spaces.Dict:
    held = dict(space.spaces) if isinstance(space, spaces.Dict) else {"observation": space}
    if KEY in held:
        raise ArgumentError(f"the environment has observations named {KEY} already: wrap it once.")
    return spaces.Dict(held | {KEY: tactile})


def _with(observation: Any, told: FloatArray) -> dict[str, Any]:
    return (dict(observation) if isinstance(observation, dict) else {"observation": observation}) | {KEY: told}
