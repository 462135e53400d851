"""One unit cell, condensed statically onto the port modes of its side faces.

Everything inside the cell is eliminated. What is left is small and dense: the stiffness between port modes, and what
rectangles of the top face (pads, electrodes) see of them. From that `coupled_cells.py` couples the copies of an array.

Port modes are the polynomials by which a cell touches the next. On the side faces of a cell x, y ∈ [−a, a], z ∈ [0, h]
displacements are combinations of hierarchical Lobatto functions: along a side the two linear ones of its vertical edges
and bubbles, upwards functions that vanish at the clamped base. Modes belong to a vertical edge or to a face, so that
neighbours share them and the field is continuous. Upward functions are polynomials of z^`CLAMPED`, since that is how
displacements begin where a free side meets the clamped base: six do what nine polynomials of z do.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fem.kernel.factor import Factor, SparseMatrix, checked_solve, schur_product, whole
from fem.kernel.mirrors import Parity, flipped_rectangles, images, parities
from fem.kernel.system import System
from geometry.layout import FloatArray

EDGES = ((-1, -1), (1, -1), (-1, 1), (1, 1))  #: signs of x and y of the vertical edges
FACES = ((0, -1), (0, 1), (1, -1), (1, 1))  #: normal axis and its sign
CLAMPED = 0.7  #: exponent of displacements at the clamped end of a free side: 0.6 as ν → 0.5, 0.71 at 0.3
ROUNDING = 1e-14  #: of a mode that does not move a node
ON_FACE = 1e-9  #: of the half pitch: how far rounding may take a node off a side face
EXCHANGE = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  #: of x and y


@dataclass(frozen=True)
class PortModes:
    """The polynomials of a cell's side faces, of one degree along sides and upwards.

    Modes are numbered first over the four vertical edges (`EDGES`), upward functions within, then over the four faces
    (`FACES`), bubbles and upward functions within. Degree of freedom mode·3 + axis moves a mode along an axis.
    """

    half_mm: float  #: half the pitch, a
    height_mm: float
    degree: int  #: at least 1; as many upward functions

    @cached_property
    def blocks(self) -> NDArray[np.int64]:
        """Where each block of upward functions lies, (4·degree, 3): signs of y and x, 0 amid a side; bubble number."""
        edges = [(y, x, 0) for x, y in EDGES]
        bubbles = range(self.degree - 1)
        faces = [(side * (axis == 1), side * (axis == 0), m) for axis, side in FACES for m in bubbles]
        return np.array(edges + faces, dtype=np.int64)

    @property
    def n_modes(self) -> int:
        return 4 * self.degree**2

    def up_to(self, degree: int) -> NDArray[np.int64]:
        """Degrees of freedom of the modes of at most a degree, as such ports number them."""
        is_edge = (self.blocks[:, :2] != 0).all(axis=1)
        modes = np.arange(self.n_modes).reshape(-1, self.degree)[is_edge | (self.blocks[:, 2] < degree - 1), :degree]
        return (modes.reshape(-1, 1) * 3 + np.arange(3)).ravel()

    def along(self, xy_mm: FloatArray) -> FloatArray:
        """The part along the sides of every block at places (n, 2) on them, (n, 4·degree)."""
        x, y = xy_mm.T / self.half_mm
        columns = [(_hat(x, sx) * _hat(y, sy))[:, None] for sx, sy in EDGES]
        for axis, side in FACES:
            across, beside = (x, y) if axis == 0 else (y, x)
            columns.append(_bubbles(self.degree, beside) * _hat(across, side)[:, None])
        return np.hstack(columns)

    def values(self, points_mm: FloatArray) -> FloatArray:
        """Every mode at points (n, 3) of the side faces, shape (n, n_modes)."""
        t = 2 * (points_mm[:, 2] / self.height_mm) ** CLAMPED - 1
        upward = np.column_stack([_hat(t, 1), _bubbles(self.degree, t)])
        return np.einsum("nb,nu->nbu", self.along(points_mm[:, :2]), upward).reshape(-1, self.n_modes)

    def image(self, way: FloatArray) -> sp.csr_matrix:
        """G, that takes port displacements to those of the cell in a mirror (3, 3) of the square, found by values."""
        ends = np.linspace(-self.half_mm, self.half_mm, self.degree + 2)
        sides = [np.insert(ends[:, None], axis, side * self.half_mm, axis=1) for axis, side in FACES]
        places = np.concatenate(sides)
        found = np.linalg.lstsq(self.along(places), self.along(places @ way[:2, :2]), rcond=None)[0].round(6)
        return sp.csr_matrix(sp.kron(sp.kron(sp.csr_matrix(found), sp.eye_array(self.degree)), way, format="csr"))

    def of_parity(self, parity: Parity) -> sp.csr_matrix:
        """Orthonormal port displacements E (n_modes·3, m), of each a few modes, that all of a parity are sums of."""
        projection = sp.eye_array(3 * self.n_modes, format="csr")
        for axis in np.flatnonzero(parity):
            way = np.where(np.arange(3) == axis, -1.0, 1.0)
            projection = (projection + parity[axis] * self.image(np.diag(way)) @ projection) / 2
        of_image = np.asarray(abs(projection).argmax(axis=1)).ravel()
        first = np.flatnonzero((of_image == np.arange(len(of_image))) & (projection.diagonal() > 0))
        return sp.csr_matrix(projection[:, first] @ sp.diags_array(projection.diagonal()[first] ** -0.5))


def _hat(t: FloatArray, sign: int) -> FloatArray:
    return (1 + sign * t) / 2


def _bubbles(degree: int, t: FloatArray) -> FloatArray:
    """Integrals of Legendre polynomials at places (n,), zero at t = ±1, of degrees 2 to `degree`: (n, degree − 1).

    (P_k − P_{k−2}) / √(2(2k−1)), Szabó & Babuška, Finite Element Analysis, eq. 3.15.
    """
    P = legendre.legvander(t, degree)
    return (P[:, 2:] - P[:, :-2]) / np.sqrt(2 * (2 * np.arange(2, degree + 1) - 1))


@dataclass(frozen=True, eq=False, kw_only=True)
class CondensedCell:
    """A cell seen from its ports and from k rectangles of its top face, three functionals (x, y, z) each.

    With port displacements q and forces f [N] spread evenly over the rectangles, the cell pulls its ports by S q − L f,
    and the mean displacements of the rectangles are Lᵀ q + C f.
    """

    ports: PortModes
    stiffness: FloatArray  #: S, (n_modes·3, n_modes·3) [N/mm]
    transfer: FloatArray  #: L, (n_modes·3, k·3), no unit
    compliance: FloatArray  #: C with the ports held, (k·3, k·3) [mm/N]
    unknowns: int  #: of the largest system that was factored
    residual: float  #: largest relative residual of the solves that were checked

    @property
    def is_definite(self) -> bool:
        """True if every displacement of the ports stores energy, as it must with a clamped base."""
        try:
            np.linalg.cholesky(self.stiffness)
        except np.linalg.LinAlgError:
            return False
        return True

    @property
    def free_compliance(self) -> FloatArray:
        """Mean displacements of the rectangles per newton on them, with free side faces, (k·3, k·3) [mm/N]."""
        return self.compliance + self.transfer.T @ np.linalg.solve(self.stiffness, self.transfer)

    def extrapolated(self, coarser: "CondensedCell", share: float) -> "CondensedCell":
        """Richardson extrapolation from a coarser cell, perhaps of a lower degree, by a share of their difference."""
        low, dofs = self.of_degree(coarser.ports.degree), self.ports.up_to(coarser.ports.degree)
        stiffness, transfer = self.stiffness.copy(), self.transfer.copy()
        stiffness[np.ix_(dofs, dofs)] += share * (low.stiffness - coarser.stiffness)
        transfer[dofs] += share * (low.transfer - coarser.transfer)
        compliance = self.compliance + share * (self.compliance - coarser.compliance)
        return replace(self, stiffness=stiffness, transfer=transfer, compliance=compliance)

    def loaded_by(self, T: FloatArray) -> "CondensedCell":
        """The same cell with other functionals, whose unit forces are the columns of T (k·3, m) on the present ones."""
        return replace(self, transfer=self.transfer @ T, compliance=T.T @ self.compliance @ T)

    def of_degree(self, degree: int) -> "CondensedCell":
        """The same cell with port modes up to a lower degree along sides and upwards, at no cost."""
        dofs = self.ports.up_to(degree)
        return replace(
            self,
            ports=replace(self.ports, degree=min(degree, self.ports.degree)),
            stiffness=self.stiffness[np.ix_(dofs, dofs)],
            transfer=self.transfer[dofs],
        )


def condense(
    system: System,
    ports: PortModes,
    rectangles: FloatArray,
    is_square: bool = False,
    inside: list[FloatArray] | None = None,
) -> CondensedCell:
    """Condense a cell, or the part beyond mirrors x = 0 or y = 0 of one that is its own image there, on any mesh.

    Rectangles (k, 4) are x0, y0, x1, y1 of what is loaded or observed, anywhere on the top of the whole cell [mm]. A
    list `inside` takes the displacements (n_modes·3 + k·3, n, 3) of the part's nodes by unit port displacements [mm]
    and by unit forces on the rectangles [N], for each parity; such a solve costs more.

    S = Φᵀ(K_BB − K_BI K_II⁻¹ K_IB)Φ, L = Φᵀ(f_B − K_BI K_II⁻¹ f_I), C = f_Iᵀ K_II⁻¹ f_I, where B are the unknowns on
    the side faces, which follow the port modes Φ, and I the others, pressures and plates included.

    Of a quarter, a displacement splits into four parities, each a problem with its own conditions on the mirror planes
    (`fem.kernel.mirrors`); four quarters cost far less than one whole. Where a quarter `is_square`, the same in x and
    y, parity (−1, 1) is (1, −1) with x and y exchanged, and need not be solved.
    """
    k, exchanged = len(rectangles), is_square and inside is None
    if exchanged:
        rectangles = np.vstack([rectangles, rectangles[:, [1, 0, 3, 2]]])
    area_mm2 = (rectangles[:, 2:] - rectangles[:, :2]).prod(axis=1)
    seen = [flipped_rectangles(rectangles, flipped) for flipped, _ in images(system.mirrors, (1, 1))]
    means = np.stack([system.integrals(image).toarray() / area_mm2[:, None] for image in seen])
    parts: dict[Parity, CondensedCell] = {}
    for parity in parities(system.mirrors):
        if exchanged and parity == (-1, 1):
            continue
        signs = np.stack([signs for _, signs in images(system.mirrors, parity)])
        forces = np.einsum("gkn,ga,ab->kanb", means, signs, np.eye(3), optimize=True)  # all images, on the part
        loads = system.of_parity(parity).rest_loads(forces.reshape(-1, *forces.shape[2:]))
        parts[parity] = _eliminated(system, ports, loads, parity, inside)
    if exchanged:
        twin, G = parts[1, -1].loaded_by(np.kron(np.roll(np.eye(2 * k), k, axis=1), EXCHANGE)), ports.image(EXCHANGE)
        parts[-1, 1] = replace(twin, stiffness=G @ (G @ twin.stiffness).T, transfer=G @ twin.transfer)
    return replace(
        next(iter(parts.values())),
        stiffness=np.sum([part.stiffness for part in parts.values()], axis=0),
        transfer=np.sum([part.transfer for part in parts.values()], axis=0)[:, : 3 * k],
        compliance=np.sum([part.compliance for part in parts.values()], axis=0)[: 3 * k, : 3 * k],
        residual=max(part.residual for part in parts.values()),
    )


def _eliminated(
    system: System, ports: PortModes, loads: FloatArray, parity: Parity, inside: list[FloatArray] | None
) -> CondensedCell:
    """What a cell does in fields of a parity: `condense` of one of its copies, under loads (m, k·3) on the unknowns."""
    points, copies = system.points_mm, system.copies
    on_side = (np.abs(points[:, :2]).max(axis=1) > ports.half_mm * (1 - ON_FACE)) & (system.number >= 0)
    K = system.rest_matrix(parity)
    block = K.blocksize[0] if K.format == "bsr" else 1
    follows = (3 * system.number[on_side][:, None] + np.arange(3)).ravel()
    is_outer = np.zeros(K.shape[0] // block, dtype=bool)
    is_outer[follows // block] = True
    I, B = (np.flatnonzero(some) for some in (~is_outer, is_outer))  # noqa: E741
    outer, inner = ((some[:, None] * block + np.arange(block)).ravel() for some in (B, I))
    E = ports.of_parity(parity)
    values = ports.values(points[on_side])
    values[np.abs(values) < ROUNDING] = 0.0  # few modes move a node
    row, each = np.searchsorted(outer, follows), np.arange(len(follows))
    placed = sp.csr_matrix((np.ones(len(each)), (row, each)), shape=(len(outer), len(each)))
    modes = placed @ sp.kron(sp.csr_matrix(values), np.eye(3), format="csr") @ E  # Φ
    factor = Factor(_part(K, I, I), definite=not system.n_mixed, upper=True)
    across = _part(K, I, B).tocsr() + _part(K, B, I).T.tocsr()
    n = modes.shape[1]
    rhs = np.empty((len(inner), n + loads.shape[1]), order="F")  # as PARDISO takes it, without copies
    (across @ modes).toarray(out=rhs[:, :n])
    rhs[:, n:] = loads[inner]
    if inside is None:
        product = schur_product(factor, rhs)
        _, residual = checked_solve(factor, rhs[:, n : n + 3])
    else:
        x, residual = checked_solve(factor, rhs)
        product = rhs.T @ x
        solution = np.zeros((K.shape[0], rhs.shape[1]))
        solution[inner] = x * np.repeat([-1.0, 1.0], [n, x.shape[1] - n])
        solution[outer, :n] = modes.toarray()
        by_ports, by_forces = np.split(system.displaced(solution), [n])
        inside.append(np.concatenate([np.tensordot(E.toarray(), by_ports, (1, 0)), by_forces / copies]))
    S = copies * ((modes.T @ whole(_part(K, B, B)) @ modes).toarray() - product[:n, :n])
    L = modes.T @ loads[outer] - product[:n, n:]
    C = product[n:, n:] / copies
    return CondensedCell(
        ports=ports,
        stiffness=E @ (E @ ((S + S.T) / 2)).T,
        transfer=E @ L,
        compliance=(C + C.T) / 2,
        unknowns=K.shape[0],
        residual=residual,
    )


def _part(K: SparseMatrix, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> SparseMatrix:
    """Some rows and columns of a matrix, by the number of its blocks if it is stored in such."""
    if K.format != "bsr":
        return K[rows][:, cols]
    number = np.arange(1, len(K.indices) + 1)
    some = sp.csr_matrix((number, K.indices, K.indptr))[rows][:, cols]
    block = K.blocksize[0]
    shape = (block * len(rows), block * len(cols))
    return sp.bsr_matrix((K.data[some.data - 1], some.indices, some.indptr), shape=shape)
