"""Solve a scene by graded hexahedra of high order: the reference that the default path is held against.

Covers boxes and oblique pillars of one material, and upright inclusions in a box. Where the body mirrors onto itself,
only half of it (or a quarter) is solved; loads need not be symmetric: they are split into even and odd parts, each of
which is one solve with other components held on the mirror planes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from fem.grid import geometric_line
from fem.kronecker import (
    FastDiagonal,
    Held,
    Lines,
    Term,
    elastic_tensors,
    line_integral,
    line_values,
)
from fem.scene import Inclusion, Rectangle, Scene, Sensor
from geometry.layout import FloatArray


@dataclass(frozen=True, kw_only=True)
class Grading:
    """How fine to solve."""

    order: int  #: of the functions along each axis
    load_layers: int  #: of elements toward the outlines of loads and toward the top face
    body_layers: int  #: toward the body's own edges, its base and its inclusions
    ratio: float  #: of the distances of neighbouring layers
    widest_mm: float  #: of any element
    reduced: bool = True  #: the volumetric part by `order` Gauss points along each axis, not order + 1


@dataclass(frozen=True)
class HpSolution:
    """What a solve found."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    energy_mj: float  #: ½ f·u
    unknowns: int  #: of the part that was solved
    solves: int  #: parts with a load
    iterations: int  #: of conjugate gradients, over all solves
    residual: float  #: largest, relative, in the norm of the preconditioner


@dataclass(frozen=True)
class _Part:
    """What is solved of a body: its grid, from 0 along each axis, and how the rest of the body mirrors it."""

    lines: Lines
    order: int
    start_mm: FloatArray  #: of the grid in the scene's coordinates, x and y on the base
    shear: tuple[float, float]  #: shift along x and y per height
    mirrored: tuple[bool, bool]

    @property
    def shape(self) -> tuple[int, int, int, int]:
        nx, ny, nz = (self.order * (len(line) - 1) + 1 for line in self.lines)
        return 3, nx, ny, nz

    @property
    def share(self) -> float:
        """Of the whole body."""
        return 0.5 ** sum(self.mirrored)

    def parities(self) -> list[tuple[int, int]]:
        """Even (1) and odd (-1) parts along x and y that make up any displacement."""
        x, y = ((1, -1) if mirrored else (1,) for mirrored in self.mirrored)
        return list(product(x, y))

    def held(self, parity: tuple[int, int]) -> Held:
        """Even parts hold the normal component on a mirror plane, odd ones the two in it; the base holds all."""

        def on_plane(a: int, d: int) -> bool:
            return self.mirrored[d] and ((a == d) == (parity[d] == 1))

        return Held(tuple((on_plane(a, 0), on_plane(a, 1), True) for a in range(3)))

    def integral(self, rectangle: Rectangle, a: int, parity: tuple[int, int]) -> FloatArray:
        """∫ of the top's functions of component a over a rectangle, its mirror images folded in, shape (nx, ny)."""
        along = []
        for d in range(2):
            shift = self.start_mm[d] + self.shear[d] * self.lines[2][-1]
            low, high = rectangle[d] - shift, rectangle[d + 2] - shift
            image = line_integral(self.lines[d], self.order, -high, -low) if self.mirrored[d] else 0.0
            along.append(line_integral(self.lines[d], self.order, low, high) + self._sign(a, d, parity) * image)
        return np.multiply.outer(*along)

    def value(self, position_mm: tuple[float, float, float], u: FloatArray, parity: tuple[int, int]) -> FloatArray:
        """Displacement of a point, shape (3,)."""
        z = position_mm[2]
        result = np.zeros(3)
        for a in range(3):
            sign, rows = 1, []
            for d in range(2):
                x = position_mm[d] - self.start_mm[d] - self.shear[d] * z
                if x < 0 and self.mirrored[d]:
                    x, sign = -x, sign * self._sign(a, d, parity)
                rows.append(line_values(self.lines[d], self.order, x))
            rows.append(line_values(self.lines[2], self.order, z))
            result[a] = sign * np.einsum("i,j,k,ijk", *rows, u[a], optimize=True)
        return result

    @staticmethod
    def _sign(a: int, d: int, parity: tuple[int, int]) -> int:
        return -parity[d] if a == d else parity[d]


def solve_by_hp(scene: Scene, grading: Grading, tolerance: float = 1e-7) -> HpSolution:
    """Displacement of a scene's probes.

    Parameters
    ----------
    scene : Scene
    grading : Grading
    tolerance : float
        Relative residual at which conjugate gradients stop.

    Raises
    ------
    ValueError
        If the scene has an oblique inclusion, or more than one material in an oblique pillar or a sensor.
    """
    part = _part(scene, grading)
    outer = elastic_tensors(scene.material, part.shear)
    stiffness = _terms(part, grading, outer)
    for inclusion in scene.inclusions:
        inner = elastic_tensors(inclusion.material, part.shear)
        difference = (inner[0] - outer[0], inner[1] - outer[1])
        stiffness += _terms(part, grading, difference, _elements(inclusion, part))

    probes = {probe.name: np.zeros(3) for probe in scene.probes}
    energy_mj, residual, solves, iterations = 0.0, 0.0, 0, 0
    for parity in part.parities():
        load = np.zeros(part.shape)
        for one in scene.loads:
            for a, traction in enumerate(one.traction_mpa):
                if traction:
                    load[a, :, :, -1] += part.share * traction * part.integral(one.rectangle, a, parity)
        held = part.held(parity)
        held.clear(load)
        if not np.abs(load).max() > 1e-13 * max(np.abs(scene.tractions_mpa).max(), 1e-300):
            continue

        def apply(u: FloatArray, held: Held = held) -> FloatArray:
            result = np.zeros_like(u)
            for term in stiffness:
                term.add_to(result, u)
            held.clear(result)
            return result

        precondition = FastDiagonal(part.lines, part.order, outer[0] + outer[1], held)
        u, steps, misfit = conjugate_gradients(apply, precondition, load, tolerance)
        energy_mj += float(np.vdot(load, u)) / 2 / part.share
        solves, iterations, residual = solves + 1, iterations + steps, max(residual, misfit)
        for probe in scene.mean_probes:
            x0, y0, x1, y1 = probe.rectangle
            for a in range(3):
                total = np.vdot(part.integral(probe.rectangle, a, parity), u[a, :, :, -1])
                probes[probe.name][a] += total / ((x1 - x0) * (y1 - y0))
        for probe in scene.point_probes:
            assert probe.position_mm is not None
            probes[probe.name] += part.value(probe.position_mm, u, parity)
    return HpSolution(probes, energy_mj, int(np.prod(part.shape)), solves, iterations, residual)


def conjugate_gradients(
    A: Callable[[FloatArray], FloatArray],
    precondition: Callable[[FloatArray], FloatArray],
    b: FloatArray,
    tolerance: float,
    most: int = 5000,
) -> tuple[FloatArray, int, float]:
    """Solution, number of steps and relative residual in the preconditioner's norm.

    Raises
    ------
    ArithmeticError
        If `most` steps do not reach the tolerance.
    """
    u = np.zeros_like(b)
    r = b.copy()
    z = precondition(r)
    p = z.copy()
    rz = first = float(np.vdot(r, z))
    for step in range(1, most + 1):
        Ap = A(p)
        alpha = rz / float(np.vdot(p, Ap))
        u += alpha * p
        r -= alpha * Ap
        z = precondition(r)
        rz, before = float(np.vdot(r, z)), rz
        if rz <= tolerance**2 * first:
            return u, step, (rz / first) ** 0.5
        p *= rz / before
        p += z
    raise ArithmeticError(f"residual {(rz / first) ** 0.5:.1e} is above {tolerance:g} after {most} steps.")


def _part(scene: Scene, grading: Grading) -> _Part:
    """The smallest part of the body from which mirrors make the whole, and its grid."""
    outline = scene.outline
    base, top = np.array(outline.base_mm), np.array(outline.top_mm)
    shear = tuple(float(slope) for slope in (top - base)[:2] / outline.height_mm)
    if isinstance(scene.body, Sensor) and not scene.body.design.is_homogeneous:
        raise ValueError("pillars of another rubber are oblique: no reference of this kind covers them.")
    if not all(inclusion.is_upright for inclusion in scene.inclusions):
        raise ValueError("oblique inclusions are not covered: Kronecker products need one Jacobian.")
    mirrored = (not shear[0] and _mirrors(scene, 0), not shear[1] and _mirrors(scene, 1))
    half = np.array(outline.section_mm) / 2
    start = np.where(mirrored, base[:2], base[:2] - half)

    lines = []
    for d in range(2):
        end = base[d] + half[d] - start[d]
        layers = {0.0: 0 if mirrored[d] else grading.body_layers, end: grading.body_layers}
        edges = [(load.rectangle[i] - shear[d] * outline.height_mm, grading.load_layers)
                 for load in scene.loads for i in (d, d + 2)]  # fmt: skip
        edges += [(inclusion.base_mm[d] + sign * inclusion.section_mm[d] / 2, grading.body_layers)
                  for inclusion in scene.inclusions for sign in (-1, 1)]  # fmt: skip
        for position, count in edges:
            at = abs(position - start[d]) if mirrored[d] else position - start[d]
            at = next((known for known in layers if abs(known - at) <= scene.rounding_mm), at)
            if not (mirrored[d] and at == 0.0):
                layers[at] = max(layers.get(at, 0), count)
        lines.append(geometric_line(layers, grading.ratio, grading.widest_mm))
    heights = {0.0: grading.body_layers, outline.height_mm: grading.load_layers}
    for z in (z for inclusion in scene.inclusions for z in (inclusion.base_mm[2], inclusion.top_mm[2])):
        heights[z] = max(heights.get(z, 0), grading.body_layers)
    lines.append(geometric_line(heights, grading.ratio, grading.widest_mm))
    return _Part((lines[0], lines[1], lines[2]), grading.order, start, (shear[0], shear[1]), mirrored)


def _mirrors(scene: Scene, axis: int) -> bool:
    """True if the inclusions mirror onto themselves in the body's middle plane."""
    middle = scene.outline.base_mm[axis]

    def described(sign: int) -> set[tuple[object, ...]]:
        found: set[tuple[object, ...]] = set()
        for inclusion in scene.inclusions:
            place = list(inclusion.base_mm)
            place[axis] = sign * (place[axis] - middle)
            size = (*inclusion.section_mm, inclusion.height_mm)
            found.add((tuple(np.round(place, 9) + 0.0), size, inclusion.material))
        return found

    return described(1) == described(-1)


def _elements(inclusion: Inclusion, part: _Part) -> tuple[tuple[int, int], ...]:
    """Elements of a part that an inclusion fills, as first and one after the last along each axis."""
    base, half = np.array(inclusion.base_mm), np.array(inclusion.section_mm) / 2
    low = np.array([*(base[:2] - half - part.start_mm), base[2]])
    high = np.array([*(base[:2] + half - part.start_mm), inclusion.top_mm[2]])
    ranges = []
    for line, start, end in zip(part.lines, low, high, strict=True):
        middles = (line[1:] + line[:-1]) / 2
        inside = np.flatnonzero((middles > start) & (middles < end))
        ranges.append((int(inside[0]), int(inside[-1]) + 1) if len(inside) else (0, 0))
    return tuple(ranges)


def _terms(
    part: _Part,
    grading: Grading,
    tensors: tuple[FloatArray, FloatArray],
    elements: tuple[tuple[int, int], ...] | None = None,
) -> list[Term]:
    """Stiffness of a box of elements (default: all) as one term, or two where they differ in quadrature."""
    elements = elements or tuple((0, len(line) - 1) for line in part.lines)
    if any(first == last for first, last in elements):
        return []  # the mirror image of an inclusion that lies wholly on the other side
    order = part.order
    if not grading.reduced:
        return [Term(part.lines, order, order + 1, tensors[0] + tensors[1], elements)]
    return [Term(part.lines, order, order + k, C, elements) for k, C in enumerate(tensors)]
