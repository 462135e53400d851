"""The hand-over of everyone who solves a scene, and the kinds of scenes that peers can be handed."""

from dataclasses import dataclass

from fem.scene.scene import Scene, Sensor
from geometry.layout import FloatArray


@dataclass(frozen=True)
class Solved:
    """A scene's probes, and what they took."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    unknowns: int
    seconds: dict[str, float]  #: by step, without imports; their sum is the run time


def fits_boxes(scene: Scene) -> bool:
    """True for what hexahedra between lines can follow: one material in any body, upright inclusions in a box."""
    if isinstance(scene.body, Sensor):
        return scene.body.design.is_homogeneous
    return all(inclusion.is_upright for inclusion in scene.inclusions)


def is_homogeneous(scene: Scene) -> bool:
    """True for one material in any body."""
    return fits_boxes(scene) and not scene.inclusions


def is_homogeneous_block(scene: Scene) -> bool:
    """True for an upright box of one material: the scenes that every peer can be handed."""
    return is_homogeneous(scene) and scene.outline.is_upright
