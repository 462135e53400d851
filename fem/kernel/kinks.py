"""Boxes that faces of pillars cut, of another rubber on either side: strain may jump inside them.

Across a face of normal n the gradient of the displacement jumps by some a ⊗ n, which no polynomial follows: boxes that
only integrate over both rubbers are too stiff, by 2 % where these differ 20 times. Here a box has further gradients

    Σ (a ⊗ n) G,    G = χ f − (its linear part),    f = 1, x, y, z,    χ = 1 beyond the face,

whose a are found inside it (enhanced strain: Simo & Rifai, Int. J. Numer. Meth. Engng. 29 (1990) 1595). Traction hardly
changes across a face, so that such G, on which no linear traction works, keep equilibrium. Pressures jump, too: each
rubber has its own. Bodies are at rest; of others nothing here is known.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.polynomial.legendre import leggauss
from skfem import Element

from fem.kernel.elements import Basis
from fem.kernel.reference import IntArray, point_stiffness, tabulated
from fem.kernel.rubber import Rubber
from geometry.design import Material
from geometry.law import LAWS, MIN_LAME
from geometry.layout import FloatArray
from geometry.prism import Prism

PARTS, POINTS = 3, 3  #: of a box along each axis, and Gauss points in each part, where a face may cut it
UNCUT = 1e-9  #: of a box: a smaller part is none
DEPENDENT = 1e-7  #: of the largest eigenvalue: combinations of jumps, or of pressures, that say nothing of their own


class KinkedRubber(Rubber):
    """Boxes along the axes, filled with the first of two rubbers and, where prisms with plane sides lie, the second."""

    def __init__(
        self, basis: Basis, pressure: Element, materials: tuple[Material, Material], prisms: Sequence[Prism]
    ) -> None:
        x, w = leggauss(POINTS)
        along = ((np.arange(PARTS)[:, None] + (x + 1) / 2) / PARTS).ravel()
        self._places: FloatArray = np.array(list(product(along, repeat=3))).T
        self._weights: FloatArray = np.prod(list(product(np.tile(w / 2 / PARTS, PARTS), repeat=3)), axis=1)
        self._prisms, self._rubbers = prisms, materials
        every = np.arange(basis.mesh.nelements)
        share = np.concatenate([self._inside(self._at(basis, some)) @ self._weights for some in _few(every)])
        law = LAWS["linear"].of(materials, np.stack([1 - share, share])[..., None])
        super().__init__(basis, pressure, law)
        self.is_cut = (share > UNCUT) & (share < 1 - UNCUT)

    def _at(self, basis: Basis, elements: IntArray) -> FloatArray:
        """Points of integration of boxes, (e, q, 3) [mm]."""
        return np.asarray(basis.mapping.F(self._places, tind=elements).transpose(1, 2, 0))

    def _inside(self, points_mm: FloatArray) -> FloatArray:
        """1 where points (e, q, 3) lie in the second rubber, else 0."""
        flat = points_mm.reshape(-1, 3)
        return np.any([prism.holds(flat) for prism in self._prisms], axis=0).reshape(points_mm.shape[:2]).astype(float)

    @property
    def _alike(self) -> FloatArray:
        """No box that is cut is like another."""
        return np.column_stack([super()._alike, np.cumsum(self.is_cut) * self.is_cut / self.n_elements])

    def _rest_stiffness(self, some: IntArray | slice) -> FloatArray:
        K, elements = super()._rest_stiffness(some), np.arange(self.n_elements)[some]
        cut = np.flatnonzero(self.is_cut[elements])
        for few in _few(cut):
            K[few] = self._cut_stiffness(elements[few])
        return K

    def _cut_stiffness(self, elements: IntArray) -> FloatArray:
        """Stiffness of boxes that are cut, (e, n, n, 3, 3) [N/mm], their jumps and pressures eliminated."""
        points = self._at(self.basis, elements)
        inside, dx = self._inside(points), self._volume[elements] * self._weights
        (_, mu), (_, other_mu) = moduli = [rubber.lame_mpa for rubber in self._rubbers]
        lame, other_lame = (max(first, MIN_LAME * second) for first, second in moduli)
        slopes = np.einsum("mnq,emi->einq", tabulated(self.basis.elem, self._places)[1], self.pull[elements, 0])
        slopes = np.concatenate([slopes, self._jumps(points)], axis=2)
        shown = tabulated(self.pressure, self._places)[0].T
        shown = np.concatenate([(1 - inside)[..., None] * shown, inside[..., None] * shown], axis=2)  # of each rubber
        mass = (shown * (dx / (lame + (other_lame - lame) * inside))[..., None]).swapaxes(1, 2) @ shown
        pressing = (slopes * dx[:, None, None]) @ shown[:, None]
        pressed = pressing @ _inverse(mass)[:, None]
        K = point_stiffness(slopes, (mu + (other_mu - mu) * inside) * dx, pressing, pressed)
        e, m = K.shape[:2]
        n = 3 * self.nodes.shape[1]
        K = K.swapaxes(2, 3).reshape(e, 3 * m, 3 * m)
        K = K[:, :n, :n] - K[:, :n, n:] @ _inverse(K[:, n:, n:]) @ K[:, n:, :n]
        return np.asarray(K.reshape(e, n // 3, 3, n // 3, 3).swapaxes(2, 3))

    def _jumps(self, points_mm: FloatArray) -> FloatArray:
        """n G of every face in each of some boxes, (e, 3, k, q), of points (e, q, 3); 0 of faces that do not cut it."""
        beyond, normals = [], []
        for prism, axis, sign in product(self._prisms, (0, 1), (-1, 1)):
            base, half, lean = np.array(prism.base_mm), np.array(prism.section_mm) / 2, np.array(prism.lean)
            off = points_mm[..., :2] - base[:2] - (points_mm[..., 2:] - base[2]) * lean
            out, is_beside = sign * off[..., axis], np.abs(off[..., 1 - axis]) < half[1 - axis]
            after, before = is_beside & (out > half[axis]), is_beside & (out > 0) & (out < half[axis])
            beyond.append(after & (after.any(axis=1) & before.any(axis=1))[:, None])
            normals.append([*np.eye(2)[axis], -lean[axis]])
        cuts = np.array(beyond)  # (faces, e, q)
        used = cuts.any(axis=2)
        order = np.argsort(~used, axis=0, kind="stable")[: used.sum(axis=0).max()]
        chi = np.take_along_axis(cuts, order[..., None], axis=0)
        linear = np.vstack([np.ones_like(self._weights), np.sqrt(3) * (2 * self._places - 1)])  # orthonormal
        G = chi[:, :, None] * linear
        G -= ((G * self._weights) @ linear.T) @ linear
        jumps = np.einsum("fei,femq->eifmq", np.array(normals)[order], G)
        return jumps.reshape(*jumps.shape[:2], -1, jumps.shape[-1])


def _inverse(A: FloatArray) -> FloatArray:
    """Inverse of symmetric matrices (e, k, k) on all but what depends on others, or is 0."""
    scale = np.sqrt(np.einsum("ekk->ek", A))
    over = np.divide(
        1.0, scale, out=np.zeros_like(scale), where=scale > UNCUT * scale.max(axis=1, keepdims=True, initial=0.0)
    )
    both = over[:, :, None] * over[:, None, :]
    values, modes = np.linalg.eigh(A * both)
    least = DEPENDENT * values.max(axis=1, keepdims=True, initial=0.0)
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=values > least)
    return np.asarray((modes * inverse[:, None]) @ modes.swapaxes(1, 2) * both)


def _few(elements: IntArray) -> list[IntArray]:
    """Elements in groups whose points of integration need little memory."""
    return [elements[first : first + 32] for first in range(0, len(elements), 32)]
