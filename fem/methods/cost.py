"""How long a scene of boxes takes by each of its methods, foreseen from its numbers alone: what the plan chooses by.

The constants are measured on one core (`docs/accuracy.md`); predictions are right to a factor of two or three.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fem.discretization.mirrors import Mirror, parities
from fem.scene.scene import Prism, Scene
from geometry.design import Material

MAX_ITERATIONS = 5000  #: `fem.discretization.kronecker.conjugate_gradients` gives up there
SHEARED, HARDER = 8, 3  #: times as many unknowns: acute edges take two levels more, regions and narrow loads one
ORDER, LAYERS, AT_LOADS, WIDEST = 3, 2, 1, 0.8  #: of the level of `fem.methods.high_order` that most scenes end at


def iterations(scene: Scene, regions: Sequence[tuple[Prism, Material]]) -> float:
    """Of conjugate gradients preconditioned by fast diagonalisation: it knows neither contrast, nor ν, nor shear.

    20 at ν = 0.3, 70 at 0.49, 700 at 0.4999; 230 to 300 at contrasts of 50 to 100; 500 at a shear of 45°, 3658 with ν
    = 0.4999 besides. A slender pillar bends far more softly than the preconditioner knows.
    """
    rubbers = [scene.material, *(material for _, material in regions)]
    moduli = [material.young_mpa for material in rubbers]
    shear = np.hypot(*(np.array(scene.outline.top_mm[:2]) - scene.outline.base_mm[:2])) / scene.height_mm
    stretch = ((shear + np.sqrt(shear**2 + 4)) / 2) ** 4  # greatest over least stiffness of the sheared coordinates
    near_half = 1 / np.sqrt(1 - 2 * max(material.poisson for material in rubbers))
    slender = max(1.0, scene.height_mm / min(scene.outline.section_mm))
    return float(10 * near_half * (max(moduli) / min(moduli)) ** 0.35 * stretch * slender)


def seconds_by_order(scene: Scene, regions: Sequence[tuple[Prism, Material]], mirrors: tuple[Mirror, ...]) -> float:
    """Processor seconds of `fem.methods.high_order`; infinite where its iteration would give up."""
    steps = iterations(scene, regions)
    if steps > MAX_ITERATIONS:
        return np.inf
    outline = scene.outline
    widest = WIDEST * outline.height_mm
    nodes = []
    for axis in (0, 1):
        ends = outline.base_mm[axis] + np.array([-1, 1]) * outline.section_mm[axis] / 2
        shift = outline.top_mm[axis] - outline.base_mm[axis]
        edges = dict.fromkeys(
            [prism.base_mm[axis] + side * prism.section_mm[axis] / 2 for prism, _ in regions for side in (-1, 1)],
            LAYERS,
        )
        loads = [load.rectangle[side] - shift for load in scene.loads for side in (axis, axis + 2)]
        edges = dict.fromkeys(loads, AT_LOADS) | edges | dict.fromkeys(map(float, ends), LAYERS)
        for mirror in mirrors:
            if mirror.axis == axis:  # what lies on the other side has its lines on this one too
                middle = mirror.position_mm
                edges = {middle + abs(place - middle): layers for place, layers in edges.items()} | {middle: 0}
        nodes.append(ORDER * _elements(edges, widest, scene.rounding_mm) + 1)
    levels = dict.fromkeys([z for prism, _ in regions for z in (prism.base_mm[2], prism.top_mm[2])], LAYERS)
    upright = levels | {outline.height_mm: AT_LOADS, 0.0: LAYERS}
    nodes.append(ORDER * _elements(upright, widest, scene.rounding_mm) + 1)
    unknowns = 3 * float(np.prod(nodes))
    narrow = any(min(load.size_mm) < outline.height_mm / 2 for load in scene.loads)
    unknowns *= (1 if outline.is_upright else SHEARED) * (HARDER if regions else 1) * (HARDER if narrow else 1)
    each = 6e-8 * max(1.0, unknowns / 4e4) ** 0.45  # of an unknown and step; beyond the processor's cache it is dearer
    return steps * unknowns * len(parities(mirrors)) * each


def _elements(edges: dict[float, int], widest: float, slack: float) -> int:
    """Elements of a line through edges with so many layers on either side."""
    places = [place for place, after in pairwise([*sorted(edges), np.inf]) if after - place > slack]
    return sum(
        edges[low] + edges[high] + max(1, int(np.ceil((high - low) / widest)) - 1) for low, high in pairwise(places)
    )


def seconds_by_splitting(scene: Scene, regions: Sequence[tuple[Prism, Material]]) -> float:
    """Processor seconds of `fem.methods.box_refinement`, whatever the rubbers and the shear."""
    boxes = (30 + 30 * (len(regions) + len(scene.loads))) * (1e-2 / scene.tolerance) ** 0.3
    return float(0.02 * boxes)
