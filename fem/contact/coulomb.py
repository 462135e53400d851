"""Unilateral contact with Coulomb friction on a grid: forces from gaps and slips, whatever the body below."""

from collections.abc import Callable

import numpy as np

from fem.factor import SolverError
from geometry.layout import FloatArray

MAX_STEPS = 2000


def balanced(
    give: Callable[[FloatArray], FloatArray],
    apart_mm: FloatArray,
    friction: float,
    first: FloatArray,
    tolerance: float,
) -> tuple[FloatArray, FloatArray]:
    """Solve one increment of contact.

    Parameters
    ----------
    give : function
        Displacement (k, ny, nx) [mm] of the body by forces (k, ny, nx) [N], the last component of both into the body.
    apart_mm : array, shape (k, ny, nx)
        Slip past the indenter along x and y, and gap, as they would be without forces; negative gaps overlap. Without
        friction k may be 1, the gap alone.
    friction : float
        Coefficient μ.
    first : array, shape (k, ny, nx)
        Forces to begin with.
    tolerance : float
        Last change of any force, relative to the largest pressing one.

    Returns
    -------
    array, shape (k, ny, nx)
        Forces on the body [N].
    array, shape (k, ny, nx)
        Displacement of the body by them [mm].

    Raises
    ------
    SolverError
        If `MAX_STEPS` steps do not balance it.

    Notes
    -----
    Signorini's and Coulomb's laws: f_n ≥ 0, gap ≥ 0, f_n gap = 0; |f_t| ≤ μ f_n, slip against f_t where equal, none
    where below. Both are f = P(f − α w), P the projection onto f_n ≥ 0 and then |f_t| ≤ μ f_n, for any α > 0. The steps
    α are Barzilai and Borwein's (IMA J. Numer. Anal. 8 (1988) 141), as in projected gradients; normal and tangential
    forces couple in `give` and are solved together.
    """
    force = _projected(first, friction)
    moved = give(force)
    overlap = np.where((apart_mm + moved)[-1] < 0, apart_mm + moved, 0.0)
    probe = overlap if overlap.any() else force
    if not probe.any():
        return force, moved
    alpha = float(np.vdot(probe, probe) / np.vdot(probe, give(probe)))
    for step in range(MAX_STEPS):
        change = _projected(force - alpha * (apart_mm + moved), friction) - force
        gave = give(change)
        force, moved = force + change, moved + gave
        if np.abs(change).max() <= tolerance * force[-1].max(initial=0.0):
            return force, moved
        curvature = float(np.vdot(change, gave))
        if curvature > 0:
            square = float(np.vdot(change, change))
            alpha = curvature / float(np.vdot(gave, gave)) if step % 2 else square / curvature
    raise SolverError(f"the contact with friction={friction:g} found no balance in {MAX_STEPS} steps: lower friction.")


def _projected(force: FloatArray, friction: float) -> FloatArray:
    projected = np.zeros_like(force)
    projected[-1] = np.maximum(force[-1], 0.0)
    if friction:
        size, limit = np.hypot(*force[:-1]), friction * projected[-1]
        projected[:-1] = force[:-1] * np.divide(limit, size, out=np.ones_like(size), where=size > limit)
    return projected
