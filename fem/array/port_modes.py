"""Port modes: the polynomials by which one unit cell touches the next.

On the side faces of a cell x, y ∈ [−a, a], z ∈ [0, h] displacements are combinations of hierarchical Lobatto functions:
along a side the two linear ones of its vertical edges and `side` − 1 bubbles, upwards `up` functions that vanish at the
clamped base. Modes belong to a vertical edge or to a face, so that neighbours share them and the field is continuous.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fem.discretization.mirrors import Parity, sign
from geometry.layout import FloatArray

EDGES = ((-1, -1), (1, -1), (-1, 1), (1, 1))  #: signs of x and y of the vertical edges
FACES = ((0, -1), (0, 1), (1, -1), (1, 1))  #: normal axis and its sign


def lobatto(degree: int, t: FloatArray) -> FloatArray:
    """Bubble of a degree of at least 2: integral of the Legendre polynomial below it, zero at t = ±1.

    (P_k − P_{k−2}) / √(2(2k−1)), Szabó & Babuška, Finite Element Analysis, eq. 3.15.
    """
    series = np.zeros(degree + 1)
    series[degree], series[degree - 2] = 1.0, -1.0
    return legendre.legval(t, series) / np.sqrt(2 * (2 * degree - 1))


@dataclass(frozen=True)
class PortModes:
    """The polynomials of a cell's side faces.

    Modes are numbered first over the four vertical edges (`EDGES`), upward functions within, then over the four faces
    (`FACES`), bubbles and upward functions within. Degree of freedom mode·3 + axis moves a mode along an axis.
    """

    half_mm: float  #: half the pitch, a
    height_mm: float
    side: int  #: polynomial degree along a side, at least 1
    up: int  #: polynomial degree upwards, at least 1: as many functions vanish at the base

    @property
    def per_edge(self) -> int:
        return self.up

    @property
    def per_face(self) -> int:
        return (self.side - 1) * self.up

    @property
    def n_modes(self) -> int:
        return 4 * self.per_edge + 4 * self.per_face

    def up_to(self, degree: int) -> NDArray[np.int64]:
        """Numbers of the modes of at most a degree along sides and upwards, in the order that such ports have them."""
        edges = np.arange(4 * self.per_edge).reshape(4, self.up)[:, :degree]
        faces = 4 * self.per_edge + np.arange(4 * self.per_face).reshape(4, self.side - 1, self.up)
        return np.concatenate([edges.ravel(), faces[:, : degree - 1, :degree].ravel()])

    def renumbered(self, edges: list[int], faces: list[int], component: NDArray[np.int64]) -> NDArray[np.int64]:
        """Degrees of freedom (n_modes·3,) in another order of edges, faces and components."""
        of_edges = np.arange(4 * self.per_edge).reshape(4, -1)[edges]
        of_faces = 4 * self.per_edge + np.arange(4 * self.per_face).reshape(4, -1)[faces]
        modes = np.concatenate([of_edges.ravel(), of_faces.ravel()])
        return (modes[:, None] * 3 + component).ravel()

    @property
    def exchanged(self) -> NDArray[np.int64]:
        """Number of the degree of freedom that each one becomes when x and y are exchanged, shape (n_modes·3,)."""
        edges = [EDGES.index((sy, sx)) for sx, sy in EDGES]
        faces = [FACES.index((1 - axis, sign)) for axis, sign in FACES]
        return self.renumbered(edges, faces, np.array([1, 0, 2]))

    def image(self, axis: int, parity: Parity) -> tuple[NDArray[np.int64], FloatArray]:
        """Number of the degree of freedom that each one becomes in the mirror across x = 0 or y = 0, and its sign.

        A displacement of a parity is its own image with these signs. Shapes (n_modes·3,).
        """
        edges = [EDGES.index((-sx, sy) if axis == 0 else (sx, -sy)) for sx, sy in EDGES]
        faces = [FACES.index((normal, -side if normal == axis else side)) for normal, side in FACES]
        signs = np.ones((self.n_modes, 3))
        odd = np.where(np.arange(2, self.side + 1) % 2, -1.0, 1.0)  # bubbles of odd degree along the side
        along = np.repeat([np.ones_like(odd) if normal == axis else odd for normal, _ in FACES], self.up, axis=1)
        signs[4 * self.per_edge :] *= along.reshape(-1, 1)
        signs *= [sign(component, axis, parity) for component in range(3)]
        return self.renumbered(edges, faces, np.arange(3)), signs.ravel()

    def of_parity(self, parity: Parity) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """Displacements of a parity, (n_modes·3, m), and how much of each any displacement has, (m, n_modes·3)."""
        share = np.eye(self.n_modes * 3)
        for axis in (0, 1):
            number, signs = self.image(axis, parity)
            share = (share + signs[:, None] * share[number]) / 2  # the projection onto what is its own image
        size = share.diagonal()
        first = np.flatnonzero((np.abs(share).argmax(axis=1) == np.arange(len(share))) & (size > 0))  # of its images
        return sp.csr_matrix(share[:, first] / size[first]), sp.csr_matrix(share[first])

    def values(self, points_mm: FloatArray) -> FloatArray:
        """Every mode at points (n, 3) of the side faces, shape (n, n_modes)."""
        x, y = points_mm[:, 0] / self.half_mm, points_mm[:, 1] / self.half_mm
        upward = self._upward(points_mm[:, 2])
        columns = [np.einsum("n,nk->nk", _hat(x, sx) * _hat(y, sy), upward) for sx, sy in EDGES]
        for axis, side in FACES:
            across, along = (x, y) if axis == 0 else (y, x)
            bubbles = self._bubbles(along) * _hat(across, side)[:, None]
            columns.append(np.einsum("nm,nk->nmk", bubbles, upward).reshape(len(points_mm), -1))
        return np.hstack(columns)

    def _bubbles(self, t: FloatArray) -> FloatArray:
        return (
            np.stack([lobatto(k, t) for k in range(2, self.side + 1)], axis=-1) if self.side > 1 else t[:, None][:, :0]
        )

    def _upward(self, z_mm: FloatArray) -> FloatArray:
        t = 2 * z_mm / self.height_mm - 1
        return np.stack([_hat(t, 1), *[lobatto(k, t) for k in range(2, self.up + 1)]], axis=-1)


def _hat(t: FloatArray, sign: int) -> FloatArray:
    return (1 + sign * t) / 2
