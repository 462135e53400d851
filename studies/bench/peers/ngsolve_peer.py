"""NGSolve as one who knows it would use it: netgen's graded or hp-refined meshes, orders 2 to 4, its own solver.

Patch outlines and inclusions are glued into the body, so that the mesh conforms to them and is refined there: either by
local edge sizes, or by NGSolve's own geometric hp-refinement toward marked edges, or on mapped hexahedra.
"""

import os
from collections.abc import Callable
from contextlib import nullcontext
from importlib.util import find_spec
from typing import Any, Literal

from fem.scene.scene import Pillar, Scene
from geometry.layout import FloatArray
from studies.bench.contender import Answer, Contender, fits_boxes, is_homogeneous
from studies.bench.ngsolve_solution import inside, mean_over, moduli, prism, rectangle
from studies.bench.peers.grids import geometric_lines, lean, scene_lines
from studies.bench.stopwatch import Stopwatch

Form = Literal["displacement", "reduced", "mixed"]
MeshMaker = Callable[[Scene, float], Any]


def local_size_mesh(scene: Scene, n: float) -> Any:
    """Tetrahedra by netgen, shrinking toward the outlines of loads and toward inclusions."""
    return _netgen_mesh(scene, largest_mm=scene.height_mm / max(1.0, n / 2), fineness=n**1.5, hp=0)


def hp_mesh(scene: Scene, n: float) -> Any:
    """Tetrahedra and their kin by netgen, refined geometrically twice toward the outlines of loads and inclusions."""
    return _netgen_mesh(scene, largest_mm=scene.height_mm / n, fineness=n, hp=2)


def hexahedra_mesh(scene: Scene, n: float) -> Any:
    """Graded hexahedra on the lines of `grids.scene_lines`."""
    return _structured_mesh(scene, scene_lines(scene, n, graded=True))


def geometric_mesh(scene: Scene, layers: float) -> Any:
    """Few hexahedra on the lines of `grids.geometric_lines`."""
    return _structured_mesh(scene, geometric_lines(scene, int(layers)))


def _structured_mesh(scene: Scene, lines: tuple[FloatArray, FloatArray, FloatArray]) -> Any:
    from ngsolve.meshes import MakeStructured3DMesh

    counts = [len(line) - 1 for line in lines]

    def mapped(*share: float) -> tuple[float, ...]:
        # vertices are whole shares of each line, up to rounding
        x, y, z = (float(line[round(s * count)]) for line, count, s in zip(lines, counts, share, strict=True))
        dx, dy = lean(scene, z).tolist()
        return x + dx, y + dy, z

    return MakeStructured3DMesh(hexes=True, nx=counts[0], ny=counts[1], nz=counts[2], mapping=mapped)


def _netgen_mesh(scene: Scene, largest_mm: float, fineness: float, hp: int) -> Any:
    """A mesh whose edges along loads and inclusions are half as long as those are wide, over the fineness."""
    from netgen.occ import Glue, OCCGeometry
    from ngsolve import Mesh

    def refined(shape: Any, width_mm: float) -> Any:
        for edge in shape.edges:
            edge.maxh = width_mm / 2 / fineness
            edge.hpref = 1 if hp else 0
        return shape

    h, smallest_mm = scene.height_mm, min(min(load.size_mm) for load in scene.loads)
    rectangles = {tuple(r): True for r in scene.load_rectangles_mm.tolist()}
    rectangles |= {tuple(r): r in scene.load_rectangles_mm.tolist() for r in scene.probe_rectangles_mm.tolist()}
    parts = [prism(scene.outline)]
    if isinstance(scene.body, Pillar):  # the clamped end of a free pillar is as singular as what is near its load
        for edge in parts[0].edges:
            if abs(edge.center.z) < 1e-9 * h:
                edge.maxh = smallest_mm / 2 / fineness
                edge.hpref = 1 if hp else 0
    for corners, loaded in rectangles.items():
        face = rectangle(corners, h)
        parts.append(refined(face, smallest_mm) if loaded else face)
    parts += [refined(prism(inclusion), min(inclusion.section_mm)) for inclusion in scene.inclusions]
    shape = Glue(parts)
    for face in shape.faces:
        if abs(face.center.z) < 1e-9 * h:
            face.name = "bottom"
        elif abs(face.center.z - h) < 1e-9 * h:
            face.name = "top"
    mesh = Mesh(OCCGeometry(shape).GenerateMesh(maxh=largest_mm, grading=0.4, parallel_meshing=False))
    if hp:
        mesh.RefineHP(hp, factor=0.15)
    return mesh


def solve_by_ngsolve(scene: Scene, make_mesh: MeshMaker, n: float, order: int, form: Form) -> Answer:
    """Mesh, assemble, factor by NGSolve's sparse Cholesky, solve.

    The displacement form condenses what lies inside elements; in its reduced kind the volumetric part is integrated one
    order lower. The mixed form adds a continuous pressure one order below the displacement (Taylor-Hood).
    """
    import ngsolve as ng

    threads = int(os.environ.get("OMP_NUM_THREADS", "2"))
    ng.SetNumThreads(threads)
    done = Stopwatch()
    mesh = make_mesh(scene, n)
    done("mesh")
    # a task manager of one thread would only cost
    with ng.TaskManager() if threads > 1 else nullcontext():
        answer = _solve(scene, mesh, order, form, done)
    return answer


def _solve(scene: Scene, mesh: Any, order: int, form: Form, done: Stopwatch) -> Answer:
    import ngsolve as ng
    from ngsolve import ET, H1, BilinearForm, GridFunction, InnerProduct, IntegrationRule, LinearForm, Sym, VectorH1

    lame, mu = moduli(scene, mesh, least=1e-9)  # the mixed form divides by λ
    V = VectorH1(mesh, order=order, dirichlet="bottom")
    if form == "mixed":
        space = V * H1(mesh, order=order - 1)
        (u, p), (v, q) = space.TnT()
    else:
        space = V
        u, v = space.TnT()
    a = BilinearForm(space, symmetric=True, condense=True)
    a += 2 * mu * InnerProduct(Sym(ng.Grad(u)), Sym(ng.Grad(v))) * ng.dx
    if form == "mixed":
        a += (p * ng.div(v) + q * ng.div(u) - p * q / lame) * ng.dx
    elif form == "reduced":
        a += lame * ng.div(u) * ng.div(v) * ng.dx(intrules={ET.HEX: IntegrationRule(ET.HEX, 2 * order - 1)})
    else:
        a += lame * ng.div(u) * ng.div(v) * ng.dx
    f = LinearForm(space)
    for load in scene.loads:
        f += inside(load.rectangle) * InnerProduct(ng.CF(load.traction_mpa), v) * ng.ds("top")
    a.Assemble()
    f.Assemble()
    done("assemble")

    inverse = a.mat.Inverse(space.FreeDofs(True), inverse="sparsecholesky")
    done("factor")
    solution = GridFunction(space)
    f.vec.data += a.harmonic_extension_trans * f.vec
    solution.vec.data = inverse * f.vec
    solution.vec.data += a.harmonic_extension * solution.vec
    solution.vec.data += a.inner_solve * f.vec
    displacement = solution.components[0] if form == "mixed" else solution
    probes = {probe.name: mean_over(displacement, probe.rectangle) for probe in scene.mean_probes}
    done("solve")
    return Answer(probes, space.ndof, done.seconds)


def missing() -> str:
    """The wheel, where it is not installed."""
    return "" if find_spec("ngsolve") else "ngsolve is not installed (pip install 'tripillar[bench]')"


IMPORTS = ("ngsolve", "ngsolve.meshes", "netgen.occ")

CONTENDERS = [
    Contender(
        name="NGSolve P3 tetrahedra, local sizes",
        family="NGSolve",
        solve=lambda scene, n: solve_by_ngsolve(scene, local_size_mesh, n, 3, "displacement"),
        resolutions=(1, 1.5, 2, 3, 4),
        covers=fits_boxes,
        missing=missing,
        imports=IMPORTS,
    ),
    Contender(
        name="NGSolve Taylor-Hood P2-P1 tetrahedra, local sizes",
        family="NGSolve",
        solve=lambda scene, n: solve_by_ngsolve(scene, local_size_mesh, n, 2, "mixed"),
        resolutions=(1, 2, 3, 4, 5),
        covers=is_homogeneous,  # a continuous pressure does not suit two rubbers
        missing=missing,
        imports=IMPORTS,
    ),
    Contender(
        name="NGSolve P4, hp-refined",
        family="NGSolve",
        solve=lambda scene, n: solve_by_ngsolve(scene, hp_mesh, n, 4, "displacement"),
        resolutions=(1, 1.5, 2),
        covers=fits_boxes,
        missing=missing,
        imports=IMPORTS,
    ),
    Contender(
        name="NGSolve Q3 hexahedra, reduced, graded",
        family="NGSolve",
        solve=lambda scene, n: solve_by_ngsolve(scene, hexahedra_mesh, n, 3, "reduced"),
        resolutions=(1, 1.5, 2, 3, 4),
        covers=fits_boxes,
        missing=missing,
        imports=IMPORTS,
    ),
    Contender(
        name="NGSolve hexahedra of rising order, reduced, geometric",
        family="NGSolve",
        solve=lambda scene, order: solve_by_ngsolve(scene, geometric_mesh, 2, int(order), "reduced"),
        resolutions=(2, 3, 4, 5),
        covers=fits_boxes,
        missing=missing,
        imports=IMPORTS,
    ),
]
