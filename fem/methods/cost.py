"""Predicted seconds of a scene of boxes by each of its two methods; the plan takes the cheaper one.

The constants are measured on one core (`docs/accuracy.md`); predictions are right to a factor of two or three.
"""

from collections.abc import Sequence

import numpy as np

from fem.discretization.graded_box import Level, box_part
from fem.discretization.mirrors import Mirror, parities
from fem.scene.scene import Region, Scene

MAX_ITERATIONS = 5000  #: `fem.discretization.kronecker.conjugate_gradients` gives up there
SHEARED, REGIONS, NARROW = (
    8,
    3,
    2,
)  #: times as many unknowns: acute edges take two levels more, regions and narrow loads one
USUAL = Level(3, 2, 1, 0.8, 0.13)  #: the level of `fem.methods.high_order` that most scenes end at


def iterations(scene: Scene, regions: Sequence[Region]) -> float:
    """Predicted steps of conjugate gradients, whose preconditioner knows neither contrast, nor ν, nor shear.

    20 at ν = 0.3, 70 at 0.49, 700 at 0.4999; 230 to 300 at contrasts of 50 to 100; 500 at a shear of 45°, 3658 with ν
    = 0.4999 besides. A slender pillar bends far more softly than the preconditioner knows.
    """
    rubbers = [scene.material, *(material for _, material in regions)]
    moduli = [material.young_mpa for material in rubbers]
    shear = np.hypot(*scene.outline.lean)
    stretch = ((shear + np.sqrt(shear**2 + 4)) / 2) ** 4  # greatest over least stiffness of the sheared coordinates
    near_half = 1 / np.sqrt(1 - 2 * max(material.poisson for material in rubbers))
    slender = np.sqrt(max(1.0, scene.height_mm / min(scene.outline.section_mm)))
    return float(10 * near_half * (max(moduli) / min(moduli)) ** 0.35 * stretch * slender)


def seconds_by_order(scene: Scene, regions: Sequence[Region], mirrors: tuple[Mirror, ...]) -> float:
    """Processor seconds of `fem.methods.high_order`; infinite where its iteration would give up."""
    steps = iterations(scene, regions)
    if steps > MAX_ITERATIONS:
        return np.inf
    unknowns = float(np.prod(box_part(scene, regions, mirrors, USUAL).shape))
    narrow = any(min(load.size_mm) < scene.height_mm / 2 for load in scene.loads)
    unknowns *= (1 if scene.outline.is_upright else SHEARED) * (REGIONS if regions else 1) * (NARROW if narrow else 1)
    each = 3e-8 * max(1.0, unknowns / 4e4) ** 0.45  # of an unknown and step; beyond the processor's cache it is dearer
    return steps * unknowns * len(parities(mirrors)) * each


def seconds_by_splitting(scene: Scene, regions: Sequence[Region]) -> float:
    """Processor seconds of `fem.methods.box_refinement`, whatever the rubbers and the shear."""
    boxes = (30 + 30 * (len(regions) + len(scene.loads))) * (1e-2 / scene.tolerance) ** 0.3
    return float(0.02 * boxes)
