"""Small bodies of every mesh and pair of elements, 4 mm high on a base of 4 × 4 mm, on which the kernel is tried."""

from collections.abc import Sequence

import numpy as np
from skfem import MeshHex, MeshTet

from fem.kernel.elements import hexahedra, taylor_hood
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.field import Places
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.meshes.grid import Grid
from fem.meshes.tetrahedra import Tetrahedra
from geometry.design import Material
from geometry.layout import FloatArray

LINES = np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 2.0, 2.5, 4.0]), np.array([0.0, 1.5, 4.0])
LEAN = (0.3, -0.2)
STIFFENING = 0.3  #: c₂/c₁ of Yeoh's law
RUBBER = Material(young_mpa=6.1, poisson=0.49)
#: mesh and order of the displacement
KINDS = ["grid 2", "grid 3", "grid 4", "leaning 2", "leaning 3", "mapped 2", "mapped 3", "tetrahedra 2"]


def model(name: str, poisson: float = RUBBER.poisson) -> Material:
    """The rubber by another law."""
    return Material(young_mpa=6.1, poisson=poisson, model=name, stiffening=STIFFENING if name == "yeoh" else 0.0)


def places_of(kind: str, lines: Sequence[FloatArray] = LINES) -> Places:
    """The mesh of a kind; of mapped hexahedra and of tetrahedra what is inside the body is moved at random."""
    if kind.startswith(("grid", "leaning")):
        return Grid(tuple(lines), LEAN if kind.startswith("leaning") else (0.0, 0.0))
    mesh = (MeshHex if kind.startswith("mapped") else MeshTet).init_tensor(*lines)
    low, high = mesh.p.min(axis=1)[:, None], mesh.p.max(axis=1)[:, None]
    inside = ((mesh.p > low) & (mesh.p < high)).all(axis=0)
    far = 0.3 * min(np.diff(line).min() for line in lines)
    points = mesh.p + inside * np.random.default_rng(1).uniform(-far, far, mesh.p.shape)
    moved = type(mesh)(points, mesh.t)
    return Tetrahedra(moved)  # of mapped hexahedra nothing is located


def body_of(
    kind: str, materials: Sequence[Material] = (RUBBER,), lines: Sequence[FloatArray] = LINES, halvings: int = 0
) -> Rubber:
    """A body of a kind, its elements halved; of two materials the second fills every other element."""
    mesh = places_of(kind, lines).mesh
    mesh = mesh.refined(halvings) if halvings else mesh
    pair = taylor_hood() if kind.startswith("tetrahedra") else hexahedra(int(kind.split()[1]))
    return Rubber.of(mesh, pair, materials, np.arange(mesh.nelements) % len(materials))


def solved(system: System, loads: FloatArray | None = None) -> FloatArray:
    """Displacements (k, n_nodes, 3) at rest by right-hand sides (n_unknowns, k), the full loads unless told."""
    factor = Factor(system.rest_matrix(), definite=not system.n_mixed, upper=True)
    return system.displaced(checked_solve(factor, system.full_loads if loads is None else loads)[0])
