"""scikit-fem as its own examples use it: stock `linear_elasticity`, `condense` and the default sparse solver.

Follows its example 11 (three-dimensional linear elasticity) with quadratic elements and loads on named boundaries.
"""

from functools import partial

import numpy as np
from skfem import (
    Basis,
    ElementHex2,
    ElementTetP2,
    ElementVector,
    FacetBasis,
    LinearForm,
    MeshHex,
    MeshTet,
    condense,
    solve,
)
from skfem.element import Element
from skfem.models.elasticity import linear_elasticity

from fem.scene.loads import Rectangle
from fem.scene.scene import Scene
from fem.scene.solution import Stopwatch
from studies.bench.harness import Contender
from studies.bench.peers.grids import Solved, is_homogeneous_block, scene_lines


def solve_stock(scene: Scene, n: float, element: type[Element]) -> Solved:
    """A uniform grid of tetrahedra or hexahedra, solved as in the documentation."""
    watch = Stopwatch()
    lines = scene_lines(scene, n, graded=False)
    mesh = (MeshTet if element is ElementTetP2 else MeshHex).init_tensor(*lines)
    height = scene.height_mm
    mesh = mesh.with_boundaries({"base": lambda x: x[2] == 0.0})
    basis = Basis(mesh, ElementVector(element()))
    watch.spent("mesh")

    def on(rectangle: Rectangle, axis: int) -> np.ndarray:
        """∫ of every function's component over a rectangle of the top."""
        x0, y0, x1, y1 = rectangle
        facets = mesh.facets_satisfying(
            lambda x: (x[2] == height) & (x[0] > x0) & (x[0] < x1) & (x[1] > y0) & (x[1] < y1)
        )
        return LinearForm(lambda v, w: v[axis]).assemble(FacetBasis(mesh, ElementVector(element()), facets=facets))

    K = linear_elasticity(*scene.material.lame_mpa).assemble(basis)
    f = sum(t * on(load.rectangle, a) for load in scene.dead_loads for a, t in enumerate(load.traction_mpa) if t)
    watch.spent("assemble")
    system = condense(K, f, D=basis.get_dofs("base"))
    u = solve(*system)
    watch.spent("factor")
    probes = {}
    for probe in scene.mean_probes:
        assert probe.size_mm is not None
        area = probe.size_mm[0] * probe.size_mm[1]
        probes[probe.name] = np.array([on(probe.rectangle, a) @ u / area for a in range(3)])
    watch.spent("solve")
    return Solved(probes, int(basis.N), watch.seconds)


CONTENDERS = [
    Contender(
        name=f"scikit-fem stock {name}",
        family="scikit-fem",
        solve=partial(solve_stock, element=element),
        settings=(1, 2, 3),
        covers=is_homogeneous_block,
    )
    for name, element in (("P2 tetrahedra", ElementTetP2), ("Q2 hexahedra", ElementHex2))
]
