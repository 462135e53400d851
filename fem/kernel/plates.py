"""Rigid plates bonded to rectangles of the top.

A plate has six motions. A node at X of a plate whose middle was at C moves to c + R (X − C). Rotations are matrices R,
and small changes of them spins δω: δR = [δω] R. The forces f of the nodes are as strong as their sum and their moment
Σ R (X − C) × f.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from common.errors import SceneError
from fem.kernel.reference import IntArray
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False)
class Plates:
    """Plates on a body; k of them, with n bonded nodes in all."""

    node: IntArray  #: bonded nodes, (n,)
    plate: IntArray  #: the plate of each, (n,)
    arm_mm: FloatArray  #: X − C of each, (n, 3)
    half_mm: FloatArray  #: half the larger side of each plate, (k,): the arm that makes a spin a length

    @classmethod
    def on(
        cls, points_mm: FloatArray, nodes: Sequence[IntArray], sizes_mm: FloatArray, middles_mm: FloatArray
    ) -> "Plates":
        """Plates of sizes (k, 2) that bind these nodes of a body's top; they turn about `middles_mm` (k, 2).

        `SceneError` if two share a node: together they would be a hinge, which is not modelled.
        """
        node = np.concatenate([np.zeros(0, dtype=np.int64), *nodes])
        if len(np.unique(node)) < len(node):
            raise SceneError("two stiff loads touch or overlap: part them by at least one element.")
        plate = np.repeat(np.arange(len(nodes)), np.array([len(own) for own in nodes], dtype=np.int64))
        centre = np.column_stack([middles_mm, np.full(len(middles_mm), points_mm[:, 2].max())])
        return cls(node, plate, points_mm[node] - centre[plate], sizes_mm.max(axis=1, initial=0.0) / 2)

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

    def spins(self, rotation: FloatArray) -> FloatArray:
        """Displacement of every bonded node by spin times half width of its plate, (n, 3, 3)."""
        return -skew(self.turned(rotation)) / self.half_mm[self.plate][:, None, None]

    def displacements(self, shift: FloatArray, turn: FloatArray) -> FloatArray:
        """Of every bonded node, (..., n, 3), for shifts (..., k, 3) of the middles and turns R − I [mm]."""
        return shift[..., self.plate, :] + self.turned(turn)

    def resultants(self, forces: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sum (..., k, 3) [N] and moment about the middles (..., k, 3) [N mm] of forces (..., n, 3) on the nodes."""
        if not self.count:
            return np.zeros((*forces.shape[:-2], 0, 3)), np.zeros((*forces.shape[:-2], 0, 3))
        moments = np.cross(self.turned(rotation), forces)
        return np.add.reduceat(forces, self.starts, axis=-2), np.add.reduceat(moments, self.starts, axis=-2)


def turns(spin: FloatArray) -> FloatArray:
    """exp [ω] − I, (..., 3, 3), of vectors ω (..., 3) (Rodrigues): what rotations R change, exact to rounding of ω.

    >>> np.round(turns(np.array([0.0, 0.0, np.pi / 2])) @ np.array([1.0, 0.0, 0.0]), 12)
    array([-1.,  1.,  0.])
    """
    angle = np.linalg.norm(spin, axis=-1)[..., None, None]
    W = skew(spin)
    return np.sinc(angle / np.pi) * W + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * (W @ W)


def spins(rotation: FloatArray) -> FloatArray:
    """Vectors ω (..., 3) of rotations exp [ω] (..., 3, 3) by less than a right angle.

    >>> np.round(spins(np.eye(3) + turns(np.array([0.3, 0.0, -0.4]))), 12)
    array([ 0.3,  0. , -0.4])
    """
    odd = (rotation - rotation.swapaxes(-1, -2)) / 2
    v = np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1)
    angle = np.arcsin(np.minimum(np.linalg.norm(v, axis=-1), 1.0))
    return np.asarray(v / np.sinc(angle / np.pi)[..., None])


def skew(v: FloatArray) -> FloatArray:
    """Matrices [v] (..., 3, 3) for which [v] w = v × w, of vectors (..., 3).

    >>> skew(np.array([0.0, 0.0, 1.0])) @ np.array([1.0, 0.0, 0.0])
    array([0., 1., 0.])
    """
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out
