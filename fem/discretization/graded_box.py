"""Functions of high order on a graded grid of boxes: the solved part of a body, its loads and its probes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fem.discretization.grid import Grid, geometric_line
from fem.discretization.kronecker import Held, along_axes
from fem.discretization.lagrange import line_integral, line_nodes, line_values
from fem.discretization.mirrors import Mirror, Parity, folded_integrals, folded_point, held_components
from fem.scene.scene import Probe, Rectangle, Region, Scene, regions_at
from geometry.layout import FloatArray

RATIO = 0.15  #: of the distances of neighbouring layers; Schwab, *p- and hp-finite element methods*, 1998


class Level(NamedTuple):
    """Fineness of a graded grid."""

    order: int  #: of the functions along each axis
    layers: int  #: of elements on either side of the body's and regions' edges
    at_loads: int  #: of those on either side of the loads' outlines, where the stress is less singular
    widest: float  #: width of an element far from all edges, relative to the body's height
    fall: float  #: of the error, from the level before; measured on blocks, slabs, pillars and stiff inclusions


@dataclass(frozen=True, eq=False)
class BoxPart:
    """Functions of one order on the grid of the solved part; displacements have shape (3, nx, ny, nz)."""

    grid: Grid
    order: int
    mirrors: tuple[Mirror, ...]  #: planes in which the rest of the body mirrors the part

    @property
    def shape(self) -> tuple[int, int, int, int]:
        nx, ny, nz = (self.order * count + 1 for count in self.grid.shape)
        return 3, nx, ny, nz

    @property
    def share(self) -> float:
        """The part's share of the whole body."""
        return 0.5 ** len(self.mirrors)

    def held(self, parity: Parity) -> Held:
        """Components that vanish on the first plane of each axis; the base holds all."""
        at_x, at_y = (held_components(axis, parity).tolist() for axis in range(2))
        return Held(tuple((x, y, True) for x, y in zip(at_x, at_y, strict=True)))

    def integrals(self, rectangle: Rectangle, parity: Parity) -> FloatArray:
        """∫ of the top's functions over a rectangle, its mirror images folded in, shape (nx, ny, 3)."""
        shift = np.tile(np.array(self.grid.lean) * self.grid.height_mm, 2)

        def integral(part: FloatArray) -> FloatArray:
            x0, y0, x1, y1 = part - shift
            along = (
                line_integral(self.grid.x, self.order, x0, x1),
                line_integral(self.grid.y, self.order, y0, y1),
            )
            return np.multiply.outer(*along)

        return folded_integrals(integral, np.array(rectangle), self.mirrors, parity)

    def seen(self, probe: Probe, u: FloatArray, parity: Parity) -> FloatArray:
        """A probe's displacement, shape (3,) [mm]."""
        if probe.kind == "mean":
            x0, y0, x1, y1 = probe.rectangle
            return np.einsum("xya,axy->a", self.integrals(probe.rectangle, parity), u[..., -1]) / (
                (x1 - x0) * (y1 - y0)
            )
        place = np.array(probe.position_mm)
        place[:2] -= np.array(self.grid.lean) * place[2]
        place, signs = folded_point(place, self.mirrors, parity)
        return signs * self.at([place[d : d + 1] for d in range(3)], u)[:, 0, 0, 0]

    def at(self, positions: Sequence[FloatArray], u: FloatArray) -> FloatArray:
        """A displacement at all crossings of positions along x, y and z, shape (3, kx, ky, kz)."""
        rows = [line_values(line, self.order, at) for line, at in zip(self.grid.lines, positions, strict=True)]
        return np.stack([along_axes(rows, component) for component in u])

    def taken_from(self, coarser: "BoxPart", u: FloatArray) -> FloatArray:
        """A coarser level's displacement at this one's nodes."""
        return coarser.at([line_nodes(line, self.order) for line in self.grid.lines], u)


def box_part(scene: Scene, regions: Sequence[Region], mirrors: tuple[Mirror, ...], level: Level) -> BoxPart:
    """The grid of a level: lines at the edges of body, loads and regions, in layers there."""
    outline, height = scene.outline, scene.height_mm
    reach = min([height, *outline.section_mm, *(side for load in scene.loads for side in load.size_mm)])
    mirrored = {mirror.axis: mirror.position_mm for mirror in mirrors}

    def line(edges: list[tuple[float, int]]) -> FloatArray:
        return geometric_line(_layers(edges, scene.rounding_mm), RATIO, level.widest * height, reach)

    lines = []
    for axis in (0, 1):
        shift = outline.lean[axis] * height  # from the base, where lines are stated, to the top, where the loads are
        prisms = (outline, *(prism for prism, _ in regions))
        edges = [
            (prism.base_mm[axis] + side * prism.section_mm[axis] / 2, level.layers)
            for prism in prisms
            for side in (-1, 1)
        ]
        edges += [(load.rectangle[side] - shift, level.at_loads) for load in scene.loads for side in (axis, axis + 2)]
        if axis in mirrored:
            middle = mirrored[axis]
            edges = [(middle + abs(place - middle), layers) for place, layers in edges] + [(middle, 0)]
        lines.append(line(edges))
    levels = [z for prism, _ in regions for z in (prism.base_mm[2], prism.top_mm[2])]
    x, y, z = *lines, line([(height, level.at_loads)] + [(z, level.layers) for z in (0.0, *levels)])
    centres = [(ends[1:] + ends[:-1]) / 2 for ends in (x, y, z)]
    points = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    region = regions_at(points.reshape(-1, 3), regions).reshape(points.shape[:3])
    return BoxPart(Grid(x=x, y=y, z=z, lean=outline.lean, region=region), level.order, mirrors)


def _layers(edges: list[tuple[float, int]], slack: float) -> dict[float, int]:
    """Most layers asked for at each position; positions that only rounding tells apart are one."""
    layers: dict[float, int] = {}
    for place, count in sorted(edges):
        last = next(reversed(layers), -np.inf)
        at = last if place - last <= slack else place
        layers[at] = max(layers.get(at, 0), count)
    return layers
