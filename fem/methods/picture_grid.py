"""Displacement of a scene of boxes on one grid of quadratic hexahedra, for pictures of its stress.

The few large elements of the other methods give displacements to a tolerance, but their stress only at certain points.
"""

import numpy as np

from fem.discretization.graded_box import Level, box_part
from fem.discretization.hexahedra import GridBasis, grid_body, grid_stiffness
from fem.discretization.mirrors import folded_integrals, parities
from fem.linear.linear_solver import checked_solve, factorized
from fem.methods.box_field import crossings, lattice_boxes, unfolded_field
from fem.methods.plan import Plan
from fem.scene.scene import Scene
from fem.scene.solution import Field
from geometry.layout import FloatArray

WIDEST = 0.45  #: element far from all edges, relative to the body's height
ACROSS = 15  #: such elements to the greatest extent of a flat body, where that makes them wider


def picture_field(scene: Scene, plan: Plan) -> Field:
    """Displacement of the whole body on a grid that is fine enough for pictures, not to the scene's tolerance."""
    widest = max(WIDEST, max(scene.outline.section_mm) / scene.height_mm / ACROSS)
    part = box_part(scene, plan.regions, plan.mirrors, Level(order=2, layers=1, at_loads=1, widest=widest, fall=1.0))
    basis = GridBasis(part.grid)
    stiffness = grid_stiffness(basis, [scene.material, *(material for _, material in plan.regions)])

    def integral(rectangle: FloatArray) -> FloatArray:
        return basis.patch_integrals(rectangle[None]).toarray()[0]

    parts = []
    for parity in parities(plan.mirrors):
        body = grid_body(basis, stiffness, parity)
        forces = np.zeros((basis.N, 3))
        for load in scene.loads:
            integrals = folded_integrals(integral, np.array(load.rectangle), plan.mirrors, parity)
            forces += part.share * integrals * np.array(load.traction_mpa)
        factor = factorized(body.matrix, definite=True)
        x, _ = checked_solve(body.matrix, factor, body.loads(forces.reshape(-1, 1)))
        parts.append((parity, body.displacements(x).reshape(-1, 3)))
    halves, cells = lattice_boxes(part.grid.lines)
    return unfolded_field(scene, plan, crossings(halves), cells, parts)
