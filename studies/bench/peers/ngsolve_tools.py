"""Parts of NGSolve's studies: faces and solids of OpenCASCADE, and Newton's method."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from geometry.prism import Prism

LEAST_STEP = 1e-3  #: of Newton's own, below which a search gives up


def face(corners: Sequence[float], z_mm: float) -> Any:
    """A rectangle at some height; corners x0, y0, x1, y1."""
    from netgen.occ import Axes, Pnt, WorkPlane, X, Z

    x0, y0, x1, y1 = corners
    return WorkPlane(Axes(Pnt(x0, y0, z_mm), n=Z, h=X)).Rectangle(x1 - x0, y1 - y0).Face()


def solid(one: Prism) -> Any:
    """A prism."""
    from netgen.occ import Vec

    (x, y, z), (a, b) = one.base_mm, one.section_mm
    upward = Vec(*(np.array(one.top_mm) - np.array(one.base_mm)).tolist())
    return face((x - a / 2, y - b / 2, x + a / 2, y + b / 2), z).Extrude(upward)


def inside(corners: Sequence[float]) -> Any:
    """1 in a rectangle x0, y0, x1, y1, 0 elsewhere."""
    import ngsolve as ng

    x0, y0, x1, y1 = (float(corner) for corner in corners)
    return ng.IfPos((ng.x - x0) * (x1 - ng.x), 1, 0) * ng.IfPos((ng.y - y0) * (y1 - ng.y), 1, 0)


def balances(form: Any, found: Any, steps: int, accurate: float) -> bool:
    """Move a field to the least of a condensed form's energy; False where Newton's method finds none.

    Each step is halved until the energy falls; the last is whole, and smaller than `accurate` of the field.
    """
    import ngsolve as ng

    residual, step, start = (found.vec.CreateVector() for _ in range(3))
    for _ in range(steps):
        form.Apply(found.vec, residual)
        form.AssembleLinearization(found.vec)
        residual.data += form.harmonic_extension_trans * residual
        step.data = form.mat.Inverse(found.space.FreeDofs(True), "sparsecholesky") * residual
        step.data += form.harmonic_extension * step
        step.data += form.inner_solve * residual
        start.data, least, length = found.vec, form.Energy(found.vec), 1.0
        found.vec.data = start - step
        while not form.Energy(found.vec) <= least + 1e-9 * abs(least):
            length /= 2
            if length < LEAST_STEP:
                return False
            found.vec.data = start - length * step
        if length == 1.0 and ng.Norm(step) < accurate * ng.Norm(found.vec):
            return True
    return False
