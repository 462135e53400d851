"""Balance of a shape with an elastic top: unilateral contact with Coulomb's friction, one increment at a time."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fem.contact.tiles import Patch
from fem.kernel.factor import SolverError
from geometry.layout import FloatArray

MAX_STEPS = 10_000  #: of projected gradients in one increment


@dataclass(frozen=True, eq=False)
class State:
    """Forces between a shape and the cells of a patch, and how the rubber is displaced: what friction remembers.

    Both have shape (3, ny, nx), along x, y and into the body, or (1, ny, nx) without friction.
    """

    force_n: FloatArray
    moved_mm: FloatArray
    rate: float = 0.0  #: of the last projected gradient [N/mm], with which the next balance begins

    @classmethod
    def at_rest(cls, patch: Patch, friction: float) -> "State":
        """Before anything touches."""
        zero = np.zeros((3 if friction else 1, patch.ny, patch.nx))
        return cls(zero, zero)

    @property
    def touches(self) -> NDArray[np.bool_]:
        """Cells that carry a force, (ny, nx)."""
        return self.force_n[-1] > 0

    @property
    def whole_n(self) -> FloatArray:
        """Forces along x, y and into the body, (3, ny, nx)."""
        return np.concatenate([np.zeros((3 - len(self.force_n), *self.force_n.shape[1:])), self.force_n])

    @property
    def drag_mm(self) -> FloatArray:
        """Mean displacement of the rubber under the shape along x and y, (2,), weighted by pressure."""
        pressing = self.force_n[-1]
        if len(self.force_n) == 1:
            return np.zeros(2)
        return np.asarray((self.moved_mm[:2] * pressing).sum(axis=(1, 2)) / max(pressing.sum(), np.finfo(float).tiny))

    def balanced(
        self,
        give: Callable[[FloatArray], FloatArray],
        apart_mm: FloatArray,
        friction: float,
        tolerance: float,
        slack_mm: float = np.inf,
    ) -> "State":
        """Forces of contact, sought from these, with a shape that is apart (k, ny, nx) from rubber at rest.

        Along x and y by how far the rubber would slip past the shape since the last balance, and along z by how far the
        shape's underside stands above. `give` is the displacement (k, ny, nx) [mm] of the body by forces (k, ny, nx)
        [N], the last component of both into it. Forces are found to a tolerance of the largest pressing one, and cells
        overlap, or slip where they stick, by at most a slack. A `SolverError` says that `MAX_STEPS` steps do not
        balance them.

        Signorini's and Coulomb's laws: f_n ≥ 0, gap ≥ 0, f_n gap = 0; |f_t| ≤ μ f_n, slip against f_t where equal, none
        where below. Both are f = P(f − α w), P the projection onto f_n ≥ 0 and then |f_t| ≤ μ f_n, for any α > 0. The
        rates α are Barzilai and Borwein's (IMA J. Numer. Anal. 8 (1988) 141), as in projected gradients; normal and
        tangential forces couple in `give` and are solved together.
        """
        force, moved, rate = self.force_n, self.moved_mm, self.rate
        if not rate:
            overlap = np.where((apart_mm + moved)[-1] < 0, apart_mm + moved, 0.0)
            probe = overlap if overlap.any() else force
            if not probe.any():
                return self
            rate = float(np.vdot(probe, probe) / np.vdot(probe, give(probe)))
        was_small = False
        for step in range(MAX_STEPS):
            change = _projected(force - rate * (apart_mm + moved), friction) - force
            gave = give(change)
            force, moved = force + change, moved + gave
            most = np.abs(change).max()
            is_small = most <= tolerance * force[-1].max(initial=0.0) and most <= rate * slack_mm
            if is_small and was_small:
                return State(force, moved, rate)
            was_small = is_small
            curvature = float(np.vdot(change, gave))
            if curvature > 0:
                square = float(np.vdot(change, change))
                rate = curvature / float(np.vdot(gave, gave)) if step % 2 else square / curvature
        raise SolverError(f"contact with friction={friction:g} found no balance in {MAX_STEPS} steps: lower friction.")


def _projected(force: FloatArray, friction: float) -> FloatArray:
    projected = np.zeros_like(force)
    projected[-1] = np.maximum(force[-1], 0.0)
    if friction:
        size, limit = np.hypot(*force[:-1]), friction * projected[-1]
        projected[:-1] = force[:-1] * np.divide(limit, size, out=np.ones_like(size), where=size > limit)
    return projected
