"""Rigid plates bonded to rectangles of the top face: six motions each.

A node at X of a plate whose middle was at C moves to c + R (X − C). Rotations are matrices R, and small changes of them
spins δω: δR = [δω] R. The forces f of the nodes are as strong as their sum and their moment Σ R (X − C) × f.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fem.finite.loads import bonded_nodes, skew
from fem.finite.rubber_body import RubberBody
from fem.scene.checks import SceneError
from fem.scene.loads import StiffLoad
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Plates:
    """Plates on a body; k of them, with n bonded nodes in all."""

    node: IntArray  #: bonded nodes, (n,)
    plate: IntArray  #: the plate of each, (n,)
    arm_mm: FloatArray  #: X − C of each, (n, 3)
    half_mm: FloatArray  #: half the larger side of each plate, (k,): the arm that makes a spin a length

    @classmethod
    def of(cls, body: RubberBody, loads: list[StiffLoad]) -> "Plates":
        """The plates of stiff loads.

        Raises
        ------
        SceneError
            If two plates share a node: together they would be a hinge, which is not modelled.
        """
        nodes = [bonded_nodes(body, load.rectangle) for load in loads]
        node = np.concatenate(nodes) if nodes else np.zeros(0, dtype=np.int64)
        if len(np.unique(node)) < len(node):
            raise SceneError("two stiff loads touch or overlap: part them by at least one element.")
        plate = np.repeat(np.arange(len(nodes)), np.array([len(own) for own in nodes], dtype=np.int64))
        centre = np.array([[*load.center_mm, body.grid.height_mm] for load in loads]).reshape(-1, 3)
        arm = body.basis.doflocs.T[node] - centre[plate]
        half = np.array([max(load.size_mm) / 2 for load in loads])
        return cls(node=node, plate=plate, arm_mm=arm, half_mm=half)

    @property
    def count(self) -> int:
        return len(self.half_mm)

    @cached_property
    def starts(self) -> IntArray:
        """First bonded node of each plate."""
        return np.searchsorted(self.plate, np.arange(self.count))

    def turned(self, rotation: FloatArray) -> FloatArray:
        """R (X − C) of every bonded node, (..., n, 3), of rotations, or turns, (..., k, 3, 3)."""
        return np.einsum("...nij,nj->...ni", rotation[..., self.plate, :, :], self.arm_mm)

    def displacements(self, shift: FloatArray, turn: FloatArray) -> FloatArray:
        """Of every bonded node, (..., n, 3), for shifts (..., k, 3) of the middles and turns R − I [mm]."""
        return shift[..., self.plate, :] + self.turned(turn)

    def resultants(self, forces: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sum (..., k, 3) [N] and moment about the middles (..., k, 3) [N mm] of forces (..., n, 3) on the nodes."""
        if not self.count:
            return np.zeros((*forces.shape[:-2], 0, 3)), np.zeros((*forces.shape[:-2], 0, 3))
        moments = np.cross(self.turned(rotation), forces)
        return tuple(np.add.reduceat(v, self.starts, axis=-2) for v in (forces, moments))  # type: ignore[return-value]  # two


def turns(spin: FloatArray) -> FloatArray:
    """exp [ω] − I, (..., 3, 3), of vectors ω (..., 3) (Rodrigues): what rotations R change, exact to rounding of ω.

    >>> np.round(turns(np.array([0.0, 0.0, np.pi / 2])) @ np.array([1.0, 0.0, 0.0]), 12)
    array([-1.,  1.,  0.])
    """
    angle = np.linalg.norm(spin, axis=-1)[..., None, None]
    W = skew(spin)
    return np.sinc(angle / np.pi) * W + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * (W @ W)
