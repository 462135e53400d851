"""Who takes part: a name, how to solve a scene at a resolution, and what that needs."""

from collections.abc import Callable
from dataclasses import dataclass

from fem.scene.scene import Scene, Sensor
from geometry.layout import FloatArray


@dataclass(frozen=True)
class Answer:
    """What a contender hands back."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    unknowns: int
    seconds: dict[str, float]  #: by step, without imports; their sum is the run time


def is_homogeneous_block(scene: Scene) -> bool:
    """True for an upright box of one material: the scenes that every peer can be handed."""
    return is_homogeneous(scene) and scene.outline.is_upright


def fits_boxes(scene: Scene) -> bool:
    """True for what hexahedra between lines can follow: one material in any body, upright inclusions in a box."""
    if isinstance(scene.body, Sensor):
        return scene.body.design.is_homogeneous
    return all(inclusion.is_upright for inclusion in scene.inclusions)


def is_homogeneous(scene: Scene) -> bool:
    """True for one material in any body."""
    return fits_boxes(scene) and not scene.inclusions


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
    imports: tuple[str, ...] = ()  #: modules loaded before processor time is taken
