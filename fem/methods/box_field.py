"""Displacement of a whole body of boxes for pictures: quadratic hexahedra, with the mirrored parts unfolded.

The few large elements of the methods give displacements to a tolerance, but their stress only at certain points:
pictures of stress come from one grid of many small ones (`picture_field`).
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from fem.boxes.boxes import Boxes
from fem.factor import Factor, checked_solve
from fem.field import Field, unfolded
from fem.methods.plan import Plan
from fem.mirrors import parities
from fem.rubber.body import RubberBody
from fem.scene.scene import Scene, regions_at
from fem.system import System
from geometry.layout import FloatArray

WIDEST = 0.35  #: boxes of a picture of stress, relative to the body's height
ACROSS = 15  #: such boxes to the greatest extent of a flat body, where that makes them wider
THIN = 0.15  #: layer on either side of an edge at which the stress is singular, relative to the smallest part


def picture_boxes(scene: Scene, plan: Plan) -> Boxes:
    """Boxes of the solved part, evenly wide but for a thin layer at every edge of the body, its regions and loads."""
    outline, height = scene.outline, scene.height_mm
    widest = height * max(WIDEST, max(outline.section_mm) / height / ACROSS)
    thin = THIN * min([widest, *outline.section_mm, *(side for load in scene.loads for side in load.size_mm)])
    prisms = [outline, *(prism for prism, _ in plan.regions)]
    planes = {mirror.axis: mirror.position_mm for mirror in plan.mirrors}
    lines = []
    for axis in (0, 1):
        ends = [prism.base_mm[axis] + side * prism.section_mm[axis] / 2 for prism in prisms for side in (-1, 1)]
        shift = outline.lean[axis] * height  # from the base, where lines are stated, to the top, where the loads are
        loads = [load.rectangle[k] - shift for load in scene.loads for k in (axis, axis + 2)]
        # inclusions are what is coloured, and layers at the loads' outlines too would take four times as long
        places = dict.fromkeys(loads, 0.0 if plan.regions else thin) | dict.fromkeys(ends, thin)
        if axis in planes:
            middle = planes[axis]
            places = {middle + abs(place - middle): layer for place, layer in places.items()} | {middle: 0.0}
        lines.append(_layered(places, widest, scene.rounding_mm))
    heights = [z for prism in prisms for z in (prism.base_mm[2], prism.top_mm[2])]
    x, y, z = *lines, _layered(dict.fromkeys(heights, thin), widest, scene.rounding_mm)
    boxes = Boxes.between((x, y, z), lean=outline.lean)
    return replace(boxes, region=regions_at((boxes.low + boxes.high) / 2, plan.regions))


def _layered(places: dict[float, float], widest: float, slack: float) -> FloatArray:
    """Lines at places and as far beside them as each asks for, evenly between; those that rounding parts are one."""
    kept: dict[float, float] = {}
    for place, layer in sorted(places.items()):
        last = next(reversed(kept), -np.inf)
        at = last if place - last <= slack else place
        kept[at] = max(kept.get(at, 0.0), layer)
    lines = [np.array([next(iter(kept))])]
    for (left, before), (right, after) in pairwise(kept.items()):
        start, end = left + min(before, (right - left) / 4), right - min(after, (right - left) / 4)
        inner = np.linspace(start, end, int(np.ceil((end - start) / widest - 1e-9)) + 1)
        lines.append(np.concatenate([inner[int(start == left) : len(inner) - int(end == right)], [right]]))
    return np.concatenate(lines)


def picture_field(scene: Scene, plan: Plan) -> Field:
    """Displacement of the whole body on boxes that are fine enough for pictures, not to the scene's tolerance."""
    boxes = picture_boxes(scene, plan)
    materials = [scene.material, *(material for _, material in plan.regions)]
    body = RubberBody.of(boxes, materials)
    system = System(body, scene.loads, plan.mirrors, parities(plan.mirrors)[0])
    blocks, parts = system.rest_tangent(), []
    for part in (system.of_parity(parity) for parity in parities(plan.mirrors)):
        factor = Factor(part.matrix(blocks), definite=True, upper=True)
        y, _ = checked_solve(factor, part.loads_on(part.rest()).reshape(-1, 1))
        parts.append((part.parity, part.displaced(y)[0]))
    return unfolded(boxes, plan.mirrors, parts, materials)
