"""NGSolve by an expert's hand: ``python ngsolve_by_hand.py SCENE.toml --order 3 --even xy`` prints means over probes.

A program of its own, which imports nothing else, so that its whole process is what NGSolve takes. It takes scenes of
blocks and pillars with upright or leaning inclusions under dead loads, and cuts them at the planes that the flags name.
Nothing estimates its error.
"""

import argparse
import json
import time
import tomllib
from pathlib import Path
from typing import Any

import ngsolve as ng
from netgen.occ import Axes, Glue, OCCGeometry, Pnt, Vec, WorkPlane, X, Z


def flags() -> argparse.Namespace:
    """What the expert chooses."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("--order", type=int, default=3, help="of the functions")
    parser.add_argument("--fine", type=float, default=1.0, help="largest elements along the height")
    parser.add_argument("--edge", type=float, default=0.0, help="edges of loads and inclusions, over the least load")
    parser.add_argument("--base", type=float, default=0.0, help="edges of the base, over the least load")
    parser.add_argument("--grading", type=float, default=0.4, help="netgen's, 0 to 1")
    parser.add_argument("--hp", type=int, default=0, help="levels of geometric refinement toward singular edges")
    parser.add_argument("--ratio", type=float, default=0.15, help="of the distances of neighbouring levels")
    parser.add_argument("--singular", default="base,loads,regions", help="edges that are refined so")
    parser.add_argument("--mixed", action="store_true", help="pressures two orders lower beside the displacements")
    parser.add_argument("--even", default="", help="axes whose middle plane mirrors body and loads")
    parser.add_argument("--odd", default="", help="axes whose middle plane turns the loads over")
    parser.add_argument("--gauss", type=int, default=0, help="points a side of probes, to which no mesh then conforms")
    return parser.parse_args()


def face(corners: tuple[float, ...], z: float) -> Any:
    """A rectangle x0, y0, x1, y1 at some height."""
    x0, y0, x1, y1 = corners
    return WorkPlane(Axes(Pnt(x0, y0, z), n=Z, h=X)).Rectangle(x1 - x0, y1 - y0).Face()


def rectangle(middle: list[float], size: list[float]) -> tuple[float, ...]:
    """Corners x0, y0, x1, y1."""
    return (middle[0] - size[0] / 2, middle[1] - size[1] / 2, middle[0] + size[0] / 2, middle[1] + size[1] / 2)


def moduli(rubber: dict[str, Any]) -> tuple[float, float]:
    """λ and μ."""
    young, nu = rubber["young_mpa"], rubber["poisson"]
    return young * nu / ((1 + nu) * (1 - 2 * nu)), young / (2 * (1 + nu))


given, start = flags(), time.process_time()
ng.SetNumThreads(1)
scene = tomllib.loads(given.scene.read_text(encoding="utf-8"))
body, regions = scene["body"], scene.get("inclusion", [])
if body["kind"] == "block":
    x, y, height = body["size_mm"]
    body = {"base_mm": [x / 2, y / 2, 0.0], "top_mm": [x / 2, y / 2, height], "section_mm": [x, y]}
height, cut = body["top_mm"][2], given.even + given.odd
outline = rectangle(body["base_mm"], body["section_mm"])
middle = [body["base_mm"][k] if axis in cut else outline[2 + k] for k, axis in enumerate("xy")]
halves = 2 ** len(cut)


def left(corners: tuple[float, ...]) -> tuple[float, ...]:
    """What the planes leave of a rectangle."""
    return (*corners[:2], *map(min, corners[2:], middle))


def solid(prism: dict[str, Any]) -> Any:
    """A prism, left of the planes where it is the body's."""
    corners = rectangle(prism["base_mm"], prism["section_mm"])
    along = [q - p for p, q in zip(prism["base_mm"], prism["top_mm"], strict=True)]
    return face(left(corners) if prism is body else corners, prism["base_mm"][2]).Extrude(Vec(*along))


# mesh
loads = [(left(rectangle(one["center_mm"], one["size_mm"])), one["traction_mpa"]) for one in scene["load"]]
probes = {one["name"]: rectangle(one["center_mm"], one["size_mm"]) for one in scene["probe"]}
least = min(min(x1 - x0, y1 - y0) for (x0, y0, x1, y1), _ in loads)


def marked(edges: Any, kind: str, share: float) -> None:
    """Refine edges by their length or geometrically."""
    for edge in edges:
        edge.hpref = 1 if given.hp and kind in given.singular.split(",") else 0
        if share:
            edge.maxh = share * least


matrix = solid(body)
marked([edge for edge in matrix.edges if abs(edge.center.z) < 1e-9], "base", given.base)
parts = []
for number, region in enumerate(regions):
    part = solid(region)
    if cut:
        part = part * matrix
    part.mat(f"region {number}")
    marked(part.edges, "regions", given.edge)
    matrix = matrix - part
    parts.append(part)
matrix.mat("matrix")
outlines = dict.fromkeys(corners for corners, _ in loads)
for corners in outlines:
    parts.append(face(corners, height))
    marked(parts[-1].edges, "loads", given.edge)
conforming = outlines if given.gauss else outlines | dict.fromkeys(map(left, probes.values()))
parts += [face(corners, height) for corners in conforming if corners not in outlines]
shape = Glue([matrix, *parts])
places = {"bottom": ("z", 0.0), "top": ("z", height)} | {axis: (axis, middle["xy".index(axis)]) for axis in cut}
for each in shape.faces:
    each.name = next((name for name, (axis, at) in places.items() if abs(getattr(each.center, axis) - at) < 1e-9), "")
geometry = OCCGeometry(shape)
mesh = ng.Mesh(geometry.GenerateMesh(maxh=height / given.fine, grading=given.grading, parallel_meshing=False))
if given.hp:
    mesh.RefineHP(given.hp, factor=given.ratio)

# equations
names = ["matrix", *(f"region {number}" for number in range(len(regions)))]
rubbers = [moduli(rubber) for rubber in (scene["material"], *regions)]
lame, mu = (mesh.MaterialCF(dict(zip(names, values, strict=True))) for values in zip(*rubbers, strict=True))
held = {
    f"dirichlet{one}": "|".join(["bottom", *(axis for axis in cut if (axis == one) == (axis in given.even))])
    for one in "xyz"
}
displacements = ng.VectorH1(mesh, order=given.order, **held)
if given.mixed:
    space = displacements * ng.L2(mesh, order=given.order - 2)
    (u, p), (v, q) = space.TnT()
    volumes = ng.div(u) * q + ng.div(v) * p - p * q / lame
else:
    space = displacements
    u, v = space.TnT()
    volumes = lame * ng.div(u) * ng.div(v)
K = ng.BilinearForm(space, symmetric=True, condense=True)
K += (2 * mu * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))) + volumes) * ng.dx


def inside(corners: tuple[float, ...]) -> Any:
    """1 inside a rectangle, 0 outside."""
    x0, y0, x1, y1 = corners
    return ng.IfPos((ng.x - x0) * (x1 - ng.x), 1, 0) * ng.IfPos((ng.y - y0) * (y1 - ng.y), 1, 0)


f = ng.LinearForm(space)
for corners, traction in loads:
    f += inside(corners) * ng.InnerProduct(ng.CF(tuple(traction)), v) * ng.ds("top")
K.Assemble()
f.Assemble()

# solve
found = ng.GridFunction(space)
f.vec.data += K.harmonic_extension_trans * f.vec
found.vec.data = K.mat.Inverse(space.FreeDofs(True), inverse="sparsecholesky") * f.vec
found.vec.data += K.harmonic_extension * found.vec
found.vec.data += K.inner_solve * f.vec
w = found.components[0] if given.mixed else found
means = {}
for name, (x0, y0, x1, y1) in probes.items():
    if (x0, y0, x1, y1) in conforming or cut:
        seen = inside(left((x0, y0, x1, y1))) * w
        total = ng.Integrate(seen, mesh, ng.BND, order=2 * given.order, definedon=mesh.Boundaries("top"))
    else:
        import numpy as np  # of what the others need not load

        local, weights = np.polynomial.legendre.leggauss(given.gauss)
        p, q = np.meshgrid((x0 + x1 + (x1 - x0) * local) / 2, (y0 + y1 + (y1 - y0) * local) / 2, indexing="ij")
        values = w(mesh(p.ravel(), q.ravel(), np.full(p.size, height)))
        total = np.outer(weights, weights).ravel() @ values * (x1 - x0) * (y1 - y0) / 4
    kept = [all((one == axis) == (axis in given.odd) for axis in cut) for one in "xyz"]
    means[name] = [k * halves * value / ((x1 - x0) * (y1 - y0)) for k, value in zip(kept, total, strict=True)]
seconds = time.process_time() - start
print(json.dumps({"probes": means, "dofs": space.ndof, "elements": mesh.ne, "seconds": seconds}))
