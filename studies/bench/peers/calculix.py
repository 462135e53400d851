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
from itertools import permutations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fem.scene.scene import Rectangle, Scene
from geometry.layout import FloatArray
from studies.bench.harness import Contender, Stopwatch
from studies.bench.peers.grids import inclusion_box, lean, scene_lines
from studies.bench.peers.solved import Solved, fits_boxes

IntArray = NDArray[np.int64]

# corners anticlockwise from below, then mid-edges below, above and upright, as half-steps of the grid (CalculiX manual)
HEXAHEDRON = np.array(
    [
        (0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2),
        (1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2),
        (0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1),
    ]
)  # fmt: skip
TETRAHEDRON_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))


def _tetrahedra() -> NDArray[np.int64]:
    """Kuhn's six tetrahedra of a hexahedron with their mid-edges, as half-steps, shape (6, 10, 3)."""
    found = []
    for order in permutations(range(3)):
        corners = np.zeros((4, 3), dtype=np.int64)
        for step, axis in enumerate(order):
            corners[step + 1 :, axis] = 2
        if np.linalg.det(corners[1:] - corners[0]) < 0:
            corners[[1, 2]] = corners[[2, 1]]
        middles = [(corners[a] + corners[b]) // 2 for a, b in TETRAHEDRON_EDGES]
        found.append(np.vstack([corners, middles]))
    return np.array(found)


@dataclass(frozen=True)
class QuadraticGrid:
    """Quadratic elements on the half-step lattice of a structured grid."""

    points_mm: FloatArray  #: shape (n, 3)
    cells: IntArray  #: shape (m, 20) or (m, 10), into points
    element: str  #: CalculiX's name
    lattice: IntArray  #: point at each half-step or -1, shape (2nx + 1, 2ny + 1, 2nz + 1)
    lines: tuple[FloatArray, FloatArray, FloatArray]  #: in the coordinates of the top face

    def weights(self, rectangle: Rectangle) -> FloatArray:
        """∫ of every function over a rectangle of the top that the lines conform to, shape (n,).

        On a face, mid-edge functions of the serendipity square integrate to a third of its area and corner functions
        to minus a twelfth; on a triangle to a third and 0.
        """
        w = np.zeros(len(self.points_mm))
        x, y, _ = self.lines
        slack = 1e-9 * (x[-1] - x[0])
        top = self.lattice[:, :, -1]
        for i in np.flatnonzero((x[:-1] > rectangle[0] - slack) & (x[1:] < rectangle[2] + slack)):
            for j in np.flatnonzero((y[:-1] > rectangle[1] - slack) & (y[1:] < rectangle[3] + slack)):
                area = (x[i + 1] - x[i]) * (y[j + 1] - y[j])
                square = top[2 * i : 2 * i + 3, 2 * j : 2 * j + 3]
                if self.element == "C3D10":  # two triangles across the diagonal; its middle belongs to both
                    w[square[[0, 1, 1, 2], [1, 0, 2, 1]]] += area / 6
                    w[square[1, 1]] += area / 3
                else:
                    w[square[[0, 1, 1, 2], [1, 0, 2, 1]]] += area / 3
                    w[square[[0, 0, 2, 2], [0, 2, 0, 2]]] -= area / 12
        return w


def make_grid(scene: Scene, n: float, element: str, graded: bool) -> QuadraticGrid:
    """A grid of C3D20R (or C3D20) hexahedra, or of C3D10 tetrahedra, six to a hexahedron."""
    lines = scene_lines(scene, n, graded)
    counts = [len(line) - 1 for line in lines]
    halves = [np.insert(line, range(1, len(line)), (line[1:] + line[:-1]) / 2) for line in lines]
    patterns = _tetrahedra() if element == "C3D10" else HEXAHEDRON[None]
    start = 2 * np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    steps = (start[:, None, None, :] + patterns).reshape(-1, patterns.shape[1], 3)
    shape = tuple(2 * count + 1 for count in counts)
    numbers = np.ravel_multi_index(tuple(np.moveaxis(steps, -1, 0)), shape)
    used, cells = np.unique(numbers, return_inverse=True)
    lattice = np.full(int(np.prod(shape)), -1)
    lattice[used] = np.arange(len(used))
    index = np.unravel_index(used, shape)
    points = np.stack([half[i] for half, i in zip(halves, index, strict=True)], axis=1)
    points[:, :2] += lean(scene, points[:, 2])
    return QuadraticGrid(points, cells.reshape(numbers.shape), element, lattice.reshape(shape), lines)


def deck(scene: Scene, grid: QuadraticGrid, solver: str) -> str:
    """The input file: one linear static step that prints the displacement of the top."""
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
    materials, region = [scene.material], np.zeros(len(grid.cells), dtype=int)
    middles = grid.points_mm[grid.cells].mean(axis=1)
    for inclusion in scene.inclusions:
        low, high = inclusion_box(inclusion)
        region[((middles > low) & (middles < high)).all(axis=1)] = len(materials)
        materials.append(inclusion.material)
    for number, material in enumerate(materials):
        out.write(f"*ELSET, ELSET=PART{number}\n")
        np.savetxt(out, np.flatnonzero(region == number) + 1, "%d,")
        out.write(f"*MATERIAL, NAME=RUBBER{number}\n*ELASTIC\n{material.young_mpa:.12g}, {material.poisson:.12g}\n")
        out.write(f"*SOLID SECTION, ELSET=PART{number}, MATERIAL=RUBBER{number}\n")
    out.write(f"*BOUNDARY\nBASE, 1, 3\n*STEP\n*STATIC, SOLVER={solver}\n*CLOAD\n")
    forces = np.zeros((len(grid.points_mm), 3))
    for load in scene.loads:
        forces += np.outer(grid.weights(load.rectangle), load.traction_mpa)
    for node, axis in np.argwhere(forces != 0.0):
        out.write(f"{node + 1}, {axis + 1}, {forces[node, axis]:.12g}\n")
    out.write("*NODE PRINT, NSET=TOP\nU\n*END STEP\n")
    return out.getvalue()


def read_displacements(text: str, n_points: int) -> FloatArray:
    """Displacements (n_points, 3) [mm] printed in a .dat file; zero where nothing was printed."""
    rows = re.findall(r"^ +(\d+) +(\S+) +(\S+) +(\S+) *$", text, flags=re.MULTILINE)
    u = np.zeros((n_points, 3))
    table = np.array(rows, dtype=np.float64)
    u[table[:, 0].astype(int) - 1] = table[:, 1:]
    return u


def solve_by_ccx(scene: Scene, n: float, element: str, graded: bool, solver: str = "SPOOLES") -> Solved:
    """Write a deck, run `ccx` on it, read what it printed."""
    done = Stopwatch()
    grid = make_grid(scene, n, element, graded)
    done("mesh")
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "scene.inp").write_text(deck(scene, grid, solver), encoding="ascii")
        threads = os.environ.get("OMP_NUM_THREADS", "2")
        environment = os.environ | {"OMP_NUM_THREADS": threads, "CCX_NPROC_EQUATION_SOLVER": threads}
        done("write")
        run = subprocess.run(["ccx", "scene"], cwd=folder, env=environment, capture_output=True, text=True, check=False)
        done("solve")
        printed = Path(folder, "scene.dat")
        if run.returncode or not printed.exists() or not printed.stat().st_size:
            raise RuntimeError(f"ccx failed: {run.stdout[-500:]}{run.stderr[-500:]}")
        u = read_displacements(printed.read_text(encoding="ascii"), len(grid.points_mm))
    probes = {}
    for probe in scene.mean_probes:
        w = grid.weights(probe.rectangle)
        probes[probe.name] = w @ u / w.sum()
    done("read")
    return Solved(probes, 3 * len(grid.points_mm), done.seconds)


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
