"""CalculiX (Debian's calculix-ccx): a deck of quadratic hexahedra or tetrahedra, run by `ccx` on two threads.

The deck is a structured grid through the outlines of loads and inclusions, sheared where the body leans. Tractions go
in as consistent nodal forces, so that any axis can be loaded; probes come back as nodal displacements of the top,
integrated by the same weights.
"""

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex, MeshTet
from skfem.mesh import Mesh

from fem.scene.loads import Rectangle
from fem.scene.scene import Scene
from fem.scene.solution import Stopwatch
from geometry.layout import FloatArray
from studies.bench.harness import Contender
from studies.bench.peers.grids import Solved, fits_boxes, inclusion_box, lean, scene_lines

#: corners in CalculiX's order, of scikit-fem's local vertices, and the ends of its mid-edges among these corners
HEXAHEDRON = (0, 2, 4, 1, 3, 6, 7, 5), (
    (0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)
)  # fmt: skip
TETRAHEDRON = (0, 1, 2, 3), ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
STEPS = 2  #: of the load at finite strain; CalculiX halves those that fail
MIRRORED = (1, 0, 2, 3, 4, 6, 5, 8, 7, 9)  #: nodes of a tetrahedron turned inside out


@dataclass(frozen=True)
class QuadraticGrid:
    """Quadratic elements on a structured grid; the mid-edge nodes come after the vertices."""

    points_mm: FloatArray  #: shape (n, 3)
    cells: NDArray[np.int64]  #: shape (m, 20) or (m, 10), into points
    element: str  #: CalculiX's name
    upright: Mesh  #: the mesh of scikit-fem, before it is sheared

    def weights(self, rectangle: Rectangle) -> FloatArray:
        """∫ of every function over a rectangle of the top that the mesh conforms to, shape (n,).

        On a face, mid-edge functions of the serendipity square integrate to a third of its area and corner functions
        to minus a twelfth; on a triangle to a third and 0.
        """
        mesh, w = self.upright, np.zeros(len(self.points_mm))
        x0, y0, x1, y1 = rectangle
        top = mesh.p[2].max()
        faces = mesh.facets_satisfying(
            lambda x: (x[2] == top) & (x[0] > x0) & (x[0] < x1) & (x[1] > y0) & (x[1] < y1), boundaries_only=True
        )
        sides = np.ptp(mesh.p[:2][:, mesh.facets[:, faces]], axis=1)
        triangles = isinstance(mesh, MeshTet)
        area = sides.prod(axis=0) / (2 if triangles else 1)
        for middles in mesh.nvertices + mesh.f2e[:, faces]:
            np.add.at(w, middles, area / 3)
        for corners in () if triangles else mesh.facets[:, faces]:
            np.add.at(w, corners, -area / 12)
        return w


def make_grid(scene: Scene, n: float, element: str, graded: bool) -> QuadraticGrid:
    """A grid of C3D20R (or C3D20) hexahedra, or of C3D10 tetrahedra, six to a hexahedron."""
    kind, (corners, ends) = (MeshTet, TETRAHEDRON) if element == "C3D10" else (MeshHex, HEXAHEDRON)
    mesh = kind.init_tensor(*scene_lines(scene, n, graded))
    number = {frozenset(pair): k for k, pair in enumerate(mesh.elem.refdom.edges)}
    edges = [number[frozenset((corners[a], corners[b]))] for a, b in ends]
    cells = np.vstack([mesh.t[list(corners)], mesh.nvertices + mesh.t2e[edges]]).T
    points = np.hstack([mesh.p, mesh.p[:, mesh.edges].mean(axis=1)]).T
    if element == "C3D10":
        sides = points[cells[:, 1:4]] - points[cells[:, :1]]
        inside_out = np.linalg.det(sides) < 0
        cells[inside_out] = cells[inside_out][:, MIRRORED]
    points[:, :2] += lean(scene, points[:, 2])
    return QuadraticGrid(points, cells, element, mesh)


def deck(scene: Scene, grid: QuadraticGrid) -> str:
    """The input file: one static step that prints the displacement of the top.

    Neo-Hookean rubber is CalculiX's own, μ/2 (I₁ J^(−2/3) − 3) + K/2 (J − 1)²: this project's law at small strain only.
    """
    out = StringIO()
    out.write("*NODE, NSET=ALL\n")
    np.savetxt(out, np.column_stack([np.arange(1, len(grid.points_mm) + 1), grid.points_mm]), "%d, %.12g, %.12g, %.12g")
    out.write(f"*ELEMENT, TYPE={grid.element}, ELSET=BODY\n")
    rows = np.column_stack([np.arange(1, len(grid.cells) + 1), grid.cells + 1])
    if rows.shape[1] > 16:  # at most 16 entries a line
        for row in rows.tolist():
            out.write(", ".join(map(str, row[:16])) + ",\n" + ", ".join(map(str, row[16:])) + "\n")
    else:
        np.savetxt(out, rows, "%d", delimiter=", ")
    z = grid.points_mm[:, 2]
    for name, chosen in {"BASE": z == 0.0, "TOP": z == scene.height_mm}.items():
        out.write(f"*NSET, NSET={name}\n")
        np.savetxt(out, np.flatnonzero(chosen) + 1, "%d,")
    is_finite = scene.material.model == "neo-hookean"
    materials, region = [scene.material], np.zeros(len(grid.cells), dtype=int)
    middles = grid.points_mm[grid.cells].mean(axis=1)
    for inclusion in scene.inclusions:
        low, high = inclusion_box(inclusion)
        region[((middles > low) & (middles < high)).all(axis=1)] = len(materials)
        materials.append(inclusion.material)
    for number, material in enumerate(materials):
        out.write(f"*ELSET, ELSET=PART{number}\n")
        np.savetxt(out, np.flatnonzero(region == number) + 1, "%d,")
        lame, mu = material.lame_mpa
        if is_finite:
            law = f"*HYPERELASTIC, NEO HOOKE\n{mu / 2:.12g}, {2 / (lame + 2 / 3 * mu):.12g}"
        else:
            law = f"*ELASTIC\n{material.young_mpa:.12g}, {material.poisson:.12g}"
        out.write(f"*MATERIAL, NAME=RUBBER{number}\n{law}\n")
        out.write(f"*SOLID SECTION, ELSET=PART{number}, MATERIAL=RUBBER{number}\n")
    step, times = (", NLGEOM", f"{1 / STEPS:g}, 1.\n") if is_finite else ("", "")
    out.write(f"*BOUNDARY\nBASE, 1, 3\n*STEP{step}\n*STATIC, SOLVER=SPOOLES\n{times}*CLOAD\n")
    forces = np.zeros((len(grid.points_mm), 3))
    for load in scene.dead_loads:
        forces += np.outer(grid.weights(load.rectangle), load.traction_mpa)
    for node, axis in np.argwhere(forces != 0.0):
        out.write(f"{node + 1}, {axis + 1}, {forces[node, axis]:.12g}\n")
    out.write(f"*NODE PRINT, NSET=TOP{', FREQUENCY=1000' if is_finite else ''}\nU\n*END STEP\n")
    return out.getvalue()


def read_displacements(text: str, n_points: int) -> FloatArray:
    """Displacements (n_points, 3) [mm] printed in a .dat file; zero where nothing was printed."""
    rows = re.findall(r"^ +(\d+) +(\S+) +(\S+) +(\S+) *$", text, flags=re.MULTILINE)
    u = np.zeros((n_points, 3))
    table = np.array(rows, dtype=np.float64)
    u[table[:, 0].astype(int) - 1] = table[:, 1:]
    return u


def solve_by_ccx(scene: Scene, n: float, element: str, graded: bool) -> Solved:
    """Write a deck, run `ccx` on it, read what it printed."""
    watch = Stopwatch()
    grid = make_grid(scene, n, element, graded)
    watch.spent("mesh")
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "scene.inp").write_text(deck(scene, grid), encoding="ascii")
        threads = os.environ.get("OMP_NUM_THREADS", "2")
        environment = os.environ | {"OMP_NUM_THREADS": threads, "CCX_NPROC_EQUATION_SOLVER": threads}
        watch.spent("assemble")
        run = subprocess.run(
            ["ccx", "scene"], cwd=folder, env=environment, capture_output=True, encoding="utf-8", check=False
        )
        printed = Path(folder, "scene.dat")
        if run.returncode or not printed.exists() or not printed.stat().st_size:
            raise RuntimeError(f"ccx failed: {run.stdout[-500:]}{run.stderr[-500:]}")
        u = read_displacements(printed.read_text(encoding="ascii"), len(grid.points_mm))
    weights = {probe.name: grid.weights(probe.rectangle) for probe in scene.mean_probes}
    probes = {name: w @ u / w.sum() for name, w in weights.items()}
    watch.spent("solve")
    return Solved(probes, 3 * len(grid.points_mm), watch.seconds)


def missing() -> str:
    """`ccx`, where it is not on the path."""
    return "" if shutil.which("ccx") else "ccx is not installed (Debian: calculix-ccx)"


CONTENDERS = [
    Contender(
        name=f"CalculiX {element} {shape}, {'graded' if graded else 'uniform'}",
        family="CalculiX",
        solve=partial(solve_by_ccx, element=element, graded=graded),
        settings=settings,
        covers=fits_boxes,
        missing=missing,
    )
    for element, shape, graded, settings in (
        ("C3D10", "tetrahedra", True, (1, 1.5, 2, 3)),
        ("C3D20R", "hexahedra", False, (1, 2, 3)),
        ("C3D20R", "hexahedra", True, (1, 1.5, 2, 3, 4, 5, 6)),
    )
]
