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

from geometry.layout import FloatArray

EDGES = ((-1, -1), (1, -1), (-1, 1), (1, 1))  #: signs of x and y of the vertical edges
FACES = ((0, -1), (0, 1), (1, -1), (1, 1))  #: normal axis and its sign
PARITIES = ((1, 1), (1, -1), (-1, 1), (-1, -1))  #: under the mirrors x → −x and y → −y; +1 symmetric


def lobatto(degree: int, t: FloatArray) -> FloatArray:
    """Bubble of a degree of at least 2: integral of the Legendre polynomial below it, zero at t = ±1.

    (P_k − P_{k−2}) / √(2(2k−1)), Szabó & Babuška, Finite Element Analysis, eq. 3.15.
    """
    series = np.zeros(degree + 1)
    series[degree], series[degree - 2] = 1.0, -1.0
    return legendre.legval(t, series) / np.sqrt(2 * (2 * degree - 1))


@dataclass(frozen=True)
class PortModes:
    """Which polynomials a cell's side faces have.

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

    @property
    def exchanged(self) -> NDArray[np.int64]:
        """Number of the degree of freedom that each one becomes when x and y are exchanged, shape (n_modes·3,)."""
        edges = np.arange(4 * self.per_edge).reshape(4, -1)[[EDGES.index((sy, sx)) for sx, sy in EDGES]]
        faces = np.arange(4 * self.per_face).reshape(4, -1)[[FACES.index((1 - axis, sign)) for axis, sign in FACES]]
        modes = np.concatenate([edges.ravel(), 4 * self.per_edge + faces.ravel()])
        return (modes[:, None] * 3 + np.array([1, 0, 2])).ravel()

    def values(self, points_mm: FloatArray) -> FloatArray:
        """Every mode at points (n, 3) of the side faces, shape (n, n_modes)."""
        x, y = points_mm[:, 0] / self.half_mm, points_mm[:, 1] / self.half_mm
        upward = self._upward(points_mm[:, 2])
        columns = [np.einsum("n,nk->nk", _hat(x, sx) * _hat(y, sy), upward) for sx, sy in EDGES]
        for axis, sign in FACES:
            across, along = (x, y) if axis == 0 else (y, x)
            bubbles = self._bubbles(along) * _hat(across, sign)[:, None]
            columns.append(np.einsum("nm,nk->nmk", bubbles, upward).reshape(len(points_mm), -1))
        return np.hstack(columns)

    def parity_values(self, points_mm: FloatArray, parity: tuple[int, int]) -> FloatArray:
        """Modes of a displacement of one parity at points (n, 3) of the faces x = a and y = a, shape (n·3, m).

        Rows interleave as degrees of freedom do; see `parity_share` for the columns.
        """
        x, y = points_mm[:, 0] / self.half_mm, points_mm[:, 1] / self.half_mm
        upward = self._upward(points_mm[:, 2])
        columns = []
        for axis in range(3):
            even_x, even_y = _evenness(parity, axis)
            sum_x, sum_y = (np.ones_like(x) if even_x > 0 else x), (np.ones_like(y) if even_y > 0 else y)
            scalar = [np.einsum("n,nk->nk", sum_x * sum_y, upward)]
            for across, along, even in ((sum_x, y, even_y), (sum_y, x, even_x)):
                bubbles = self._bubbles(along)[:, self._bubble_parity == even] * across[:, None]
                scalar.append(np.einsum("nm,nk->nmk", bubbles, upward).reshape(len(points_mm), -1))
            values = np.hstack(scalar)
            spread = np.zeros((len(points_mm), 3, values.shape[1]))
            spread[:, axis] = values
            columns.append(spread.reshape(-1, values.shape[1]))
        return np.hstack(columns)

    def parity_share(self, parity: tuple[int, int]) -> sp.csr_matrix:
        """What of the cell's port displacements (n_modes·3,) has a parity, shape (m, n_modes·3)."""
        rows, cols, signs = [], [], []
        row = 0
        face_start = 4 * self.per_edge
        for axis in range(3):
            evenness = _evenness(parity, axis)
            for k in range(self.up):
                for edge, (sx, sy) in enumerate(EDGES):
                    rows.append(row)
                    cols.append((edge * self.per_edge + k) * 3 + axis)
                    signs.append((evenness[0] if sx < 0 else 1) * (evenness[1] if sy < 0 else 1) / 4)
                row += 1
            for normal in (0, 1):
                for bubble in np.flatnonzero(self._bubble_parity == evenness[1 - normal]).tolist():
                    for k in range(self.up):
                        for face, (face_normal, sign) in enumerate(FACES):
                            if face_normal == normal:
                                mode = face_start + face * self.per_face + bubble * self.up + k
                                rows.append(row)
                                cols.append(mode * 3 + axis)
                                signs.append((evenness[normal] if sign < 0 else 1) / 2)
                        row += 1
        return sp.csr_matrix((signs, (rows, cols)), shape=(row, self.n_modes * 3))

    @property
    def _bubble_parity(self) -> FloatArray:
        """+1 for even bubbles, −1 for odd ones, shape (side − 1,)."""
        return np.where(np.arange(2, self.side + 1) % 2, -1.0, 1.0)

    def _bubbles(self, t: FloatArray) -> FloatArray:
        return (
            np.stack([lobatto(k, t) for k in range(2, self.side + 1)], axis=-1) if self.side > 1 else t[:, None][:, :0]
        )

    def _upward(self, z_mm: FloatArray) -> FloatArray:
        t = 2 * z_mm / self.height_mm - 1
        return np.stack([_hat(t, 1), *[lobatto(k, t) for k in range(2, self.up + 1)]], axis=-1)


def image_signs(parity: tuple[int, int], image: tuple[int, int]) -> FloatArray:
    """Sign that each displacement component of a parity takes in a mirror image of the quarter, shape (3,)."""
    evenness = [_evenness(parity, axis) for axis in range(3)]
    return np.array([(ex if image[0] < 0 else 1) * (ey if image[1] < 0 else 1) for ex, ey in evenness], dtype=float)


def _hat(t: FloatArray, sign: int) -> FloatArray:
    return (1 + sign * t) / 2


def _evenness(parity: tuple[int, int], axis: int) -> tuple[int, int]:
    """Whether displacement along an axis is an even (+1) or odd (−1) function of x and of y."""
    return (-parity[0] if axis == 0 else parity[0]), (-parity[1] if axis == 1 else parity[1])
