"""Solve a scene by NGSolve's hexahedra of high order, fully integrated: the reference that our own solvers are held to.

None of it is what `fem` solves by: NGSolve's functions (integrated Legendre polynomials), assembly, condensation and
preconditioner. Covers boxes and oblique pillars of one material, and upright inclusions in a box. Where a box mirrors
onto itself only a quarter is solved; loads need not be symmetric: they are split into even and odd parts, each of which
is one solve with other components held on the mirror planes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from fem.grid import geometric_line
from fem.scene import Inclusion, Scene, Sensor
from geometry.layout import FloatArray

FLAT = 3.0  #: width of an edge or face over the thickness beside it, above which all of it is solved for globally
MOST = 3000  #: iterations of conjugate gradients

Signs = tuple[int, int]  #: along x and y: 1 even, −1 odd


@dataclass(frozen=True, kw_only=True)
class Grading:
    """How fine to solve."""

    order: int  #: of the functions along each axis
    load_layers: int  #: of elements toward the outlines of loads and toward the top face
    body_layers: int  #: toward the base and inclusions
    side_layers: int  #: toward the sides of the body
    ratio: float  #: of the distances of neighbouring layers
    widest_mm: float  #: of elements near an edge


@dataclass(frozen=True)
class NgsolveSolution:
    """What a solve found."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    energy_mj: float  #: ½ f·u
    unknowns: int  #: of the part that was solved
    solves: int  #: parts with a load
    iterations: int  #: of conjugate gradients, over all solves


@dataclass(frozen=True)
class _Part:
    """What is solved of a body, in coordinates from the centre of its base."""

    lines: tuple[FloatArray, FloatArray, FloatArray]
    mirrored: tuple[bool, bool]  #: in x = 0 and y = 0; what lies above is solved
    shear: tuple[float, float]  #: shift along x and y per height

    @property
    def share(self) -> float:
        """Of the whole body."""
        return 0.5 ** sum(self.mirrored)

    def parities(self) -> list[Signs]:
        """Even and odd parts that make up any displacement."""
        x, y = ((1, -1) if mirrored else (1,) for mirrored in self.mirrored)
        return list(product(x, y))

    def images(self, rectangle: FloatArray, parity: Signs) -> Iterator[tuple[FloatArray, FloatArray]]:
        """A rectangle of the top and its mirror images, each cut to the part, and the signs of x, y and z there."""
        for flips in product(*((1, -1) if mirrored else (1,) for mirrored in self.mirrored)):
            image, signs = rectangle.reshape(2, 2).copy(), np.ones(3)
            for d, flip in enumerate(flips):
                if flip < 0:
                    image[:, d] = -image[::-1, d]
                    signs *= [_sign(a, d, parity) for a in range(3)]
                low = self.lines[d][0] + self.shear[d] * self.lines[2][-1]
                image[:, d] = np.maximum(image[:, d], low)
            if (image[1] > image[0]).all():
                yield image.ravel(), signs

    def mesh(self) -> Any:
        """Hexahedra between the lines; its boundaries x = 0, y = 0 and z = 0 are 'back', 'left' and 'bottom'."""
        from ngsolve.meshes import MakeStructured3DMesh

        counts = [len(line) - 1 for line in self.lines]

        def mapped(*share: float) -> tuple[float, ...]:
            # vertices are whole shares of each line, up to rounding
            x, y, z = (float(line[round(s * n)]) for line, n, s in zip(self.lines, counts, share, strict=True))
            return x + self.shear[0] * z, y + self.shear[1] * z, z

        return MakeStructured3DMesh(hexes=True, nx=counts[0], ny=counts[1], nz=counts[2], mapping=mapped)

    def held(self, parity: Signs) -> dict[str, str]:
        """Boundaries that hold each component: the base all, mirror planes what has the other sign in the image."""
        planes = ("back", "left")
        return {
            f"dirichlet{axis}": "|".join(
                ["bottom", *(planes[d] for d in range(2) if self.mirrored[d] and _sign(a, d, parity) < 0)]
            )
            for a, axis in enumerate("xyz")
        }


def solve_by_ngsolve_hexahedra(scene: Scene, grading: Grading, tolerance: float = 1e-8) -> NgsolveSolution:
    """Displacement of a scene's mean probes.

    Parameters
    ----------
    scene : Scene
    grading : Grading
    tolerance : float
        Relative residual at which conjugate gradients stop.

    Raises
    ------
    ValueError
        If the scene has a point probe, an oblique inclusion, or more than one material in a sensor.
    ArithmeticError
        If conjugate gradients do not reach the tolerance.
    """
    import ngsolve as ng

    part = _part(scene, grading)
    base = np.array(scene.outline.base_mm)[[0, 1, 0, 1]]
    mesh = part.mesh()
    probes = {probe.name: np.zeros(3) for probe in scene.probes}
    energy_mj, solves, iterations, unknowns = 0.0, 0, 0, 0
    for parity in part.parities():
        pressed = [
            (image, part.share * signs * load.traction_mpa)
            for load in scene.loads
            for image, signs in part.images(load.rectangle - base, parity)
        ]
        V = ng.VectorH1(mesh, order=grading.order, **part.held(parity))
        v = V.TestFunction()
        f = ng.LinearForm(V)
        for image, traction in pressed:
            f += _inside(image) * ng.InnerProduct(ng.CF(tuple(traction)), v) * ng.ds("top")
        f.Assemble()
        forces = f.vec.FV().NumPy()
        forces *= np.array(V.FreeDofs())
        if not np.abs(forces).max() > 1e-13 * np.abs(scene.tractions_mpa).max():
            continue
        _choose_coarse(V, part.shear)
        u = ng.GridFunction(V)
        iterations += _solve(_stiffness(V, scene), f.vec, u.vec, tolerance)
        energy_mj += ng.InnerProduct(f.vec, u.vec) / 2 / part.share
        solves, unknowns = solves + 1, V.ndof
        for probe in scene.mean_probes:
            for image, signs in part.images(probe.rectangle - base, parity):
                probes[probe.name] += signs * _integral(u, part, image, grading.order)
    for probe in scene.mean_probes:
        x0, y0, x1, y1 = probe.rectangle
        probes[probe.name] /= (x1 - x0) * (y1 - y0)
    return NgsolveSolution(probes, energy_mj, unknowns, solves, iterations)


def _stiffness(V: Any, scene: Scene) -> Any:
    """The stiffness, not yet assembled; what lies inside elements is eliminated and dropped.

    Nothing loads or probes the inside, so it need not come back.
    """
    import ngsolve as ng

    u, v = V.TnT()
    lame, mu = _moduli(scene)
    strain, virtual = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    a = ng.BilinearForm(V, symmetric=True, eliminate_internal=True, keep_internal=False)
    a += (2 * mu * ng.InnerProduct(strain, virtual) + lame * ng.div(u) * ng.div(v)) * ng.dx
    return a


def _choose_coarse(V: Any, shear: tuple[float, float]) -> None:
    """Say which functions BDDC solves for globally, so that few iterations suffice.

    Beside vertices: the lowest of each edge and, so that the flux through faces is free as nearly incompressible rubber
    asks for, of each face; all of those that are much wider than an element beside them is thick.
    """
    import ngsolve as ng

    points = np.array([vertex.point for vertex in V.mesh.vertices])
    points[:, :2] -= np.multiply.outer(points[:, 2], shear)

    def extent(part: Any) -> FloatArray:
        return np.ptp(points[[vertex.nr for vertex in part.vertices]], axis=0)

    for kind, lowest in (("edges", 2), ("faces", 1)):
        parts = list(getattr(V.mesh, kind))
        thinnest = np.full((len(parts), 3), np.inf)
        for element in V.mesh.Elements(ng.VOL):
            beside = [part.nr for part in getattr(element, kind)]
            thinnest[beside] = np.minimum(thinnest[beside], extent(element))
        for part in parts:
            size = extent(part)
            along = size > 1e-6 * thinnest[part.nr]
            wide = size[along].min() > FLAT * thinnest[part.nr, ~along].min()
            dofs = np.array(V.GetDofNrs(part)).reshape(3, -1)
            for dof in (dofs if wide else dofs[:, :lowest]).ravel().tolist():
                V.SetCouplingType(dof, ng.COUPLING_TYPE.WIREBASKET_DOF)


def _solve(a: Any, f: Any, u: Any, tolerance: float) -> int:
    """Assemble, solve for u by conjugate gradients; number of iterations."""
    import ngsolve as ng

    bddc = ng.Preconditioner(a, "bddc", inverse="sparsecholesky")
    a.Assemble()
    cg = ng.CGSolver(a.mat, bddc.mat, tol=tolerance, maxiter=MOST)
    u.data = cg * f
    if cg.iterations >= MOST:
        raise ArithmeticError(f"conjugate gradients did not reach {tolerance:g} in {MOST} iterations.")
    return int(cg.iterations)


def _moduli(scene: Scene) -> tuple[Any, Any]:
    """λ and μ over the part, in coordinates from the centre of the body's base; lines conform to inclusions."""
    import ngsolve as ng

    lame, mu = (ng.CF(value) for value in scene.material.lame_mpa)
    for inclusion in scene.inclusions:
        low, high = _box(inclusion, scene)
        inside = _inside(np.array([*low[:2], *high[:2]])) * ng.IfPos((ng.z - low[2]) * (high[2] - ng.z), 1, 0)
        lame += inside * (inclusion.material.lame_mpa[0] - scene.material.lame_mpa[0])
        mu += inside * (inclusion.material.lame_mpa[1] - scene.material.lame_mpa[1])
    return lame, mu


def _inside(rectangle: FloatArray) -> Any:
    """1 inside a rectangle, 0 outside: constant on each face, for the mesh conforms to its outline."""
    import ngsolve as ng

    x0, y0, x1, y1 = rectangle.tolist()
    return ng.IfPos((ng.x - x0) * (x1 - ng.x), 1, 0) * ng.IfPos((ng.y - y0) * (y1 - ng.y), 1, 0)


def _integral(u: Any, part: _Part, rectangle: FloatArray, order: int) -> FloatArray:
    """∫ u over a rectangle of the top by Gauss points between lines, shape (3,): exact, for u is a polynomial there."""
    places, weights = np.polynomial.legendre.leggauss(order // 2 + 1)
    x, w = [], []
    for d in range(2):
        line = part.lines[d] + part.shear[d] * part.lines[2][-1]
        low, high = rectangle[d], rectangle[d + 2]
        ends = np.unique(np.concatenate([[low, high], line[(line > low) & (line < high)]]))
        half, middle = np.diff(ends)[:, None] / 2, (ends[1:] + ends[:-1])[:, None] / 2
        x.append((middle + half * places).ravel())
        w.append((half * weights).ravel())
    points = [one.ravel() for one in np.meshgrid(*x, part.lines[2][-1:], indexing="ij")]
    return np.asarray(np.outer(*w).ravel() @ u(u.space.mesh(*points)))


def _part(scene: Scene, grading: Grading) -> _Part:
    """The smallest part of the body from which mirrors make the whole, and its lines."""
    outline = scene.outline
    base, half = np.array(outline.base_mm), np.array(outline.section_mm) / 2
    shear = (np.array(outline.top_mm) - base)[:2] / outline.height_mm
    if isinstance(scene.body, Sensor) and not scene.body.design.is_homogeneous:
        raise ValueError("pillars of another rubber are oblique: no reference of this kind covers them.")
    if not all(inclusion.is_upright for inclusion in scene.inclusions):
        raise ValueError("oblique inclusions are not covered: lines must conform to inclusions.")
    if scene.point_probes:
        raise ValueError("point probes are not covered: the inside of elements is eliminated.")
    mirrored = (not shear[0] and _mirrors(scene, 0), not shear[1] and _mirrors(scene, 1))
    boxes = [_box(inclusion, scene) for inclusion in scene.inclusions]
    lines = []
    for d in range(2):
        at = [(0.0, 0)] if mirrored[d] else [(-half[d], grading.side_layers)]
        at.append((half[d], grading.side_layers))
        at += [(load.rectangle[i] - base[d] - shear[d] * outline.height_mm, grading.load_layers)
               for load in scene.loads for i in (d, d + 2)]  # fmt: skip
        at += [(corner[d], grading.body_layers) for box in boxes for corner in box]
        lines.append(_line([(abs(x), n) if mirrored[d] else (x, n) for x, n in at], grading, scene.rounding_mm))
    heights = [(0.0, grading.body_layers), (outline.height_mm, grading.load_layers)]
    heights += [(corner[2], grading.body_layers) for box in boxes for corner in box]
    lines.append(_line(heights, grading, scene.rounding_mm))
    return _Part((lines[0], lines[1], lines[2]), mirrored, (float(shear[0]), float(shear[1])))


def _line(places: list[tuple[float, int]], grading: Grading, rounding_mm: float) -> FloatArray:
    """Lines through places, with the most layers that any asks for there."""
    layers: dict[float, int] = {}
    for x, count in places:
        known = next((one for one in layers if abs(one - x) <= rounding_mm), float(x))
        layers[known] = max(layers.get(known, 0), count)
    return geometric_line(layers, grading.ratio, grading.widest_mm)


def _box(inclusion: Inclusion, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest corner, from the centre of the body's base."""
    corners = inclusion.corners() - np.array(scene.outline.base_mm)
    return corners.min(axis=0), corners.max(axis=0)


def _mirrors(scene: Scene, axis: int) -> bool:
    """True if the inclusions mirror onto themselves in the body's middle plane."""

    def described(sign: int) -> set[tuple[object, ...]]:
        found: set[tuple[object, ...]] = set()
        for inclusion in scene.inclusions:
            low, high = _box(inclusion, scene)
            place = (low + high) / 2
            place[axis] *= sign
            found.add((*np.round([*place, *(high - low)], 9) + 0.0, inclusion.material))
        return found

    return described(1) == described(-1)


def _sign(component: int, axis: int, parity: Signs) -> int:
    """Of a component in the image across a plane, relative to the component itself."""
    return -parity[axis] if component == axis else parity[axis]
