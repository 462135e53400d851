"""Scenes that mirror themselves: the loads of the part above their mirror planes, and the whole from that part."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fem.discretization.grid import Grid
from fem.discretization.mirrors import Mirror
from fem.scene.loads import Load, StiffLoad, rectangle_of
from fem.scene.scene import Scene
from geometry.layout import FloatArray


def loads_above(scene: Scene, mirrors: Sequence[Mirror]) -> list[Load]:
    """The loads above all planes, with the halves there of those that a plane cuts."""
    loads = list(scene.loads)
    for mirror in mirrors:
        loads = [part for load in loads if (part := _above(load, mirror, scene.rounding_mm)) is not None]
    return loads


def _above(load: Load, mirror: Mirror, slack_mm: float) -> Load | None:
    axis, plane = mirror.axis, mirror.position_mm
    low, high = rectangle_of(load.center_mm, load.size_mm)[axis::2]
    if low >= plane - slack_mm:
        return load
    if high <= plane + slack_mm:
        return None
    center, size = list(load.center_mm), list(load.size_mm)
    center[axis], size[axis] = (plane + high) / 2, high - plane
    part = replace(load, center_mm=(center[0], center[1]), size_mm=(size[0], size[1]))
    if isinstance(part, StiffLoad):  # its own mirror image: what it turns about is not moved by its arms' halves
        return replace(part, force_n=tuple(np.array(part.force_n) / 2), moment_nmm=tuple(np.array(part.moment_nmm) / 2))
    return part


def unfolded(grid: Grid, u: FloatArray, mirrors: Sequence[Mirror]) -> tuple[Grid, FloatArray]:
    """The grid of the whole body and its displacements (n_nodes, 3), from those of the part above the planes."""
    lattice = u.reshape(*[2 * n + 1 for n in grid.shape], 3)
    lines, region = list(grid.lines), np.broadcast_to(grid.region, grid.shape)
    for mirror in mirrors:
        axis = mirror.axis
        lines[axis] = np.concatenate([2 * mirror.position_mm - lines[axis][:0:-1], lines[axis]])
        below = np.flip(lattice, axis).take(np.arange(lattice.shape[axis] - 1), axis)
        lattice = np.concatenate([below * np.where(np.arange(3) == axis, -1.0, 1.0), lattice], axis)
        region = np.concatenate([np.flip(region, axis), region], axis)
    whole = Grid(x=lines[0], y=lines[1], z=lines[2], lean=grid.lean, region=region)
    return whole, np.ascontiguousarray(lattice.reshape(-1, 3))
