"""Who takes part: a name, how to solve a scene at a resolution, and what that needs."""

from collections.abc import Callable
from dataclasses import dataclass

from fem.scene import Scene, Sensor
from geometry.layout import FloatArray


@dataclass(frozen=True)
class Answer:
    """What a contender hands back."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    unknowns: int
    seconds: dict[str, float]  #: by step, without imports; their sum is the run time


def is_homogeneous_block(scene: Scene) -> bool:
    """True for an upright box of one material: the scenes that every peer can be handed."""
    if isinstance(scene.body, Sensor):
        return scene.body.design.is_homogeneous
    return scene.outline.is_upright and not scene.inclusions


def any_scene(scene: Scene) -> bool:
    """True: for contenders that can solve whatever a scene says."""
    return True


def nothing_missing() -> str:
    """Nothing that the environment lacks."""
    return ""


@dataclass(frozen=True, kw_only=True)
class Contender:
    """One method, at several resolutions."""

    name: str
    family: str  #: ours, contrast or the peer's program: contenders of a family share a colour
    solve: Callable[[Scene, float], Answer]
    resolutions: tuple[float, ...]  #: coarse to fine: elements along half a patch, an order or a tolerance
    covers: Callable[[Scene], bool] = is_homogeneous_block
    missing: Callable[[], str] = nothing_missing  #: what the environment lacks to run this, in a word
