"""One unit cell, condensed statically onto the port modes of its side faces.

Everything inside the cell is eliminated. What is left is small and dense: the stiffness between port modes, and what
rectangles of the top face (pads, electrodes) see of them. From that `coupled_cells.py` couples the copies of an array.

Port modes are the polynomials by which a cell touches the next. On the side faces of a cell x, y ∈ [−a, a], z ∈ [0, h]
displacements are combinations of hierarchical Lobatto functions: along a side the two linear ones of its vertical edges
and `side` − 1 bubbles, upwards `up` functions that vanish at the clamped base. Modes belong to a vertical edge or to a
face, so that neighbours share them and the field is continuous. Upward functions are polynomials of z^`CLAMPED`, since
that is how displacements begin where a free side meets the clamped base: six do what nine polynomials of z do.

`CellSides` keeps the nodes of the side faces instead: from it a cell of any place in an array follows without another
elimination. A side shared with a neighbour moves by port modes; one at the rim is free, and moves as its nodes do.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from fem.kernel.factor import Factor, SparseMatrix, checked_solve, schur_complement, schur_product, whole
from fem.kernel.mirrors import Parity, flipped_rectangles, images, parities, sign
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.array.meshed import CellBody

EDGES = ((-1, -1), (1, -1), (-1, 1), (1, 1))  #: signs of x and y of the vertical edges
FACES = ((0, -1), (0, 1), (1, -1), (1, 1))  #: normal axis and its sign
Free = tuple[int, ...]  #: numbers of the `FACES` that no neighbour shares
CLAMPED = 0.7  #: exponent of displacements at the clamped end of a free side: 0.6 as ν → 0.5, 0.71 at 0.3


def bubbles(degree: int, t: FloatArray) -> FloatArray:
    """Integrals of Legendre polynomials at places (n,), zero at t = ±1, of degrees 2 to `degree`: (n, degree − 1).

    (P_k − P_{k−2}) / √(2(2k−1)), Szabó & Babuška, Finite Element Analysis, eq. 3.15.
    """
    P = legendre.legvander(t, degree)
    return (P[:, 2:] - P[:, :-2]) / np.sqrt(2 * (2 * np.arange(2, degree + 1) - 1))


@dataclass(frozen=True)
class PortModes:
    """The polynomials of a cell's side faces.

    Modes are numbered first over the four vertical edges (`EDGES`), upward functions within, then over the four faces
    (`FACES`), bubbles and upward functions within. Degree of freedom mode·3 + axis moves a mode along an axis.
    """

    half_mm: float  #: half the pitch, a
    height_mm: float
    side: int  #: polynomial degree along a side, at least 1
    up: int  #: degree upwards, at least 1: as many functions vanish at the base

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
        """Degrees of freedom of the modes of at most a degree along sides and upwards, as such ports number them."""
        edges = np.arange(4 * self.per_edge).reshape(4, self.up)[:, :degree]
        faces = 4 * self.per_edge + np.arange(4 * self.per_face).reshape(4, self.side - 1, self.up)
        modes = np.concatenate([edges.ravel(), faces[:, : degree - 1, :degree].ravel()])
        return (modes[:, None] * 3 + np.arange(3)).ravel()

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
        for axis in np.flatnonzero(parity):
            number, signs = self.image(int(axis), parity)
            share = (share + signs[:, None] * share[number]) / 2  # the projection onto what is its own image
        size = share.diagonal()
        first = np.flatnonzero((np.abs(share).argmax(axis=1) == np.arange(len(share))) & (size > 0))  # of its images
        return sp.csr_matrix(share[:, first] / size[first]), sp.csr_matrix(share[first])

    def values(self, points_mm: FloatArray) -> FloatArray:
        """Every mode at points (n, 3) of the side faces, shape (n, n_modes)."""
        x, y = points_mm[:, 0] / self.half_mm, points_mm[:, 1] / self.half_mm
        t = 2 * (points_mm[:, 2] / self.height_mm) ** CLAMPED - 1
        upward = np.column_stack([_hat(t, 1), bubbles(self.up, t)])
        columns = [np.einsum("n,nk->nk", _hat(x, sx) * _hat(y, sy), upward) for sx, sy in EDGES]
        for axis, side in FACES:
            across, along = (x, y) if axis == 0 else (y, x)
            on_face = bubbles(self.side, along) * _hat(across, side)[:, None]
            columns.append(np.einsum("nm,nk->nmk", on_face, upward).reshape(len(points_mm), self.per_face))
        return np.hstack(columns)


def _hat(t: FloatArray, sign: int) -> FloatArray:
    return (1 + sign * t) / 2


ON_FACE = 1e-9  #: of the half pitch: how far rounding may take a node off a side face


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
        low, dofs = self.of_degree(coarser.ports.side), self.ports.up_to(coarser.ports.side)
        stiffness, transfer = self.stiffness.copy(), self.transfer.copy()
        stiffness[np.ix_(dofs, dofs)] += share * (low.stiffness - coarser.stiffness)
        transfer[dofs] += share * (low.transfer - coarser.transfer)
        compliance = self.compliance + share * (self.compliance - coarser.compliance)
        return replace(self, stiffness=stiffness, transfer=transfer, compliance=compliance)

    def exchanged(self, twins: NDArray[np.int64]) -> "CondensedCell":
        """The cell that this one becomes when x and y are exchanged.

        `twins` (k,) is the number of the rectangle of this cell that becomes each rectangle of the other.
        """
        return self._image(self.ports.exchanged, (twins[:, None] * 3 + np.array([1, 0, 2])).ravel())

    def seeing(self, rectangles: NDArray[np.int64]) -> "CondensedCell":
        """The same cell with some of its rectangles, by number."""
        return self._image(np.arange(len(self.stiffness)), (rectangles[:, None] * 3 + np.arange(3)).ravel())

    def _image(self, dofs: NDArray[np.int64], seen: NDArray[np.int64]) -> "CondensedCell":
        return replace(
            self,
            stiffness=self.stiffness[np.ix_(dofs, dofs)],
            transfer=self.transfer[np.ix_(dofs, seen)],
            compliance=self.compliance[np.ix_(seen, seen)],
        )

    def of_degree(self, degree: int) -> "CondensedCell":
        """The same cell with port modes up to a lower degree along sides and upwards, at no cost."""
        dofs = self.ports.up_to(degree)
        return replace(
            self,
            ports=replace(self.ports, side=min(degree, self.ports.side), up=min(degree, self.ports.up)),
            stiffness=self.stiffness[np.ix_(dofs, dofs)],
            transfer=self.transfer[dofs],
        )


def condense(
    body: "CellBody", ports: PortModes, rectangles: FloatArray, inside: list[FloatArray] | None = None
) -> CondensedCell:
    """Condense a cell, or the quarter x, y ≥ 0 of one that is its own mirror image in x and in y, whatever its mesh.

    Rectangles (k, 4) are x0, y0, x1, y1 of what is loaded or observed, anywhere on the top of the whole cell [mm]. A
    list `inside` takes the displacements (n_modes·3 + k·3, n, 3) of the body's nodes by unit port displacements [mm]
    and by unit forces on the rectangles [N], for each parity; such a solve costs more.

    S = Φᵀ(K_BB − K_BI K_II⁻¹ K_IB)Φ, L = Φᵀ(f_B − K_BI K_II⁻¹ f_I), C = f_Iᵀ K_II⁻¹ f_I, where B are the unknowns on
    the side faces, which follow the port modes Φ, and I the others, pressures and plates included.

    Of a quarter, a displacement splits into four parities, each a problem with its own conditions on the mirror planes
    (`fem.kernel.mirrors`); four quarters cost far less than one whole. Where the cell is the same in x and y, parity
    (−1, 1) is (1, −1) with x and y exchanged, and need not be solved.
    """
    k, copies = len(rectangles), 2 ** len(body.mirrors)
    square = copies == 4 and inside is None and body.is_square
    if square:
        rectangles = np.vstack([rectangles, rectangles[:, [1, 0, 3, 2]]])
    area_mm2 = (rectangles[:, 2:] - rectangles[:, :2]).prod(axis=1)
    means = [
        body.integrals(flipped_rectangles(rectangles, flipped)).toarray() / area_mm2[:, None]
        for flipped, _ in images(body.mirrors, (1, 1))
    ]
    parts = {}
    for parity in parities(body.mirrors):
        if square and parity == (-1, 1):
            continue
        forces = np.zeros((len(rectangles), 3, len(body.points_mm), 3))  # all images of a rectangle, on the part
        for (_, signs), mean in zip(images(body.mirrors, parity), means, strict=True):
            for axis in range(3):
                forces[:, axis, :, axis] += signs[axis] * mean
        loads = body.gathered(forces.reshape(-1, *forces.shape[2:]), parity)
        parts[parity] = _eliminated(body, ports, loads, parity, copies, inside)
    if square:
        parts[-1, 1] = parts[1, -1].exchanged(twins=np.roll(np.arange(2 * k), k))
    return replace(
        next(iter(parts.values())),
        stiffness=np.sum([part.stiffness for part in parts.values()], axis=0),
        transfer=np.sum([part.transfer for part in parts.values()], axis=0)[:, : 3 * k],
        compliance=np.sum([part.compliance for part in parts.values()], axis=0)[: 3 * k, : 3 * k],
        residual=max(part.residual for part in parts.values()),
    )


def _eliminated(
    body: "CellBody",
    ports: PortModes,
    loads: FloatArray,
    parity: Parity,
    copies: int,
    inside: list[FloatArray] | None,
) -> CondensedCell:
    """What a cell does in fields of a parity: `condense` of one of its copies, under loads (m, k·3) on the unknowns."""
    points, numbers = body.points_mm, body.numbers
    on_side = on_faces(points, ports.half_mm) & (numbers[:, 0] >= 0)
    K, follows = body.matrix(parity), numbers[on_side].ravel()
    block = K.blocksize[0] if K.format == "bsr" else 1
    is_outer = np.zeros(K.shape[0] // block, dtype=bool)
    is_outer[follows // block] = True
    I, B = (np.flatnonzero(some) for some in (~is_outer, is_outer))  # noqa: E741
    outer, inner = ((some[:, None] * block + np.arange(block)).ravel() for some in (B, I))
    expand, share = ports.of_parity(parity)
    modes = np.zeros((len(outer), expand.shape[1]))  # Φ
    modes[np.searchsorted(outer, follows)] = (expand.T @ np.kron(ports.values(points[on_side]), np.eye(3)).T).T
    factor = Factor(_part(K, I, I), definite=body.definite, upper=True)
    rhs = np.hstack([_part(K, I, B) @ modes + _part(K, B, I).T @ modes, loads[inner]])
    n = modes.shape[1]
    if inside is None:
        product = schur_product(factor, rhs)
        _, residual = checked_solve(factor, rhs[:, n : n + 3])
    else:
        x, residual = checked_solve(factor, rhs)
        product = rhs.T @ x
        solution = np.zeros((K.shape[0], rhs.shape[1]))
        solution[inner], solution[outer, :n] = x * np.repeat([-1.0, 1.0], [n, x.shape[1] - n]), modes
        by_ports, by_forces = np.split(body.displacements(solution), [n])
        by_ports = np.tensordot(share.toarray(), by_ports, (0, 0))
        inside.append(np.concatenate([by_ports, by_forces / copies]))
    S = modes.T @ (whole(_part(K, B, B)) @ modes) - product[:n, :n]
    L = modes.T @ loads[outer] - product[:n, n:]
    C = product[n:, n:] / copies
    S = copies * (share.T @ (share.T @ S).T)
    return CondensedCell(
        ports=ports,
        stiffness=(S + S.T) / 2,
        transfer=share.T @ L,
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


def on_faces(points_mm: FloatArray, half_mm: float, free: Free = ()) -> NDArray[np.bool_]:
    """Which points (n, 3) of a cell lie on a side that is not free, shape (n,)."""
    found = np.zeros(len(points_mm), dtype=bool)
    for number, (axis, side) in enumerate(FACES):
        if number not in free:
            found |= side * points_mm[:, axis] > half_mm * (1 - ON_FACE)
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class CellSides:
    """A cell seen from the n nodes of its side faces and k rectangles of its top face; units as of `CondensedCell`."""

    points_mm: FloatArray  #: of the nodes that are not clamped, (n, 3)
    half_mm: float  #: half the pitch
    height_mm: float
    stiffness: FloatArray  #: (n·3, n·3)
    transfer: FloatArray  #: (n·3, k·3)
    compliance: FloatArray  #: with the nodes held, (k·3, k·3)
    unknowns: int
    residual: float

    @classmethod
    def of(cls, body: "CellBody", rectangles: FloatArray, free: Free = ()) -> "CellSides":
        """Condense a whole cell with rectangles (k, 4) of its top face; of sides always free no nodes are kept."""
        points, parity = body.points_mm, (0, 0)
        half_mm = float(points[:, 0].max())
        on_side = on_faces(points, half_mm, free) & (body.numbers[:, 0] >= 0)
        mean = body.integrals(rectangles).toarray() / (rectangles[:, 2:] - rectangles[:, :2]).prod(axis=1)[:, None]
        forces = np.einsum("kn,ij->kinj", mean, np.eye(3)).reshape(-1, len(points), 3)
        K, last = whole(body.matrix(parity)), body.numbers[on_side].ravel()
        order = np.concatenate([np.setdiff1d(np.arange(K.shape[0]), last), last])
        loads = sp.csr_matrix(body.gathered(forces, parity)[order])
        bordered = sp.block_array([[K[order][:, order], loads], [loads.T, None]], format="csr")
        S, residual = schur_complement(sp.triu(bordered, format="csr"), len(last) + loads.shape[1])
        n = len(last)
        return cls(
            points_mm=points[on_side],
            half_mm=half_mm,
            height_mm=float(points[:, 2].max()),
            stiffness=S[:n, :n],
            transfer=S[:n, n:],
            compliance=-S[n:, n:],
            unknowns=K.shape[0],
            residual=residual,
        )

    def cell(self, degree: int, free: Free = ()) -> CondensedCell:
        """The cell with ports of a degree on all sides but the free ones.

        Modes of free sides alone move nothing: they have the stiffness of 1 N/mm, and none with others.
        """
        ports = PortModes(self.half_mm, self.height_mm, degree, degree)
        shared = [side for number, side in enumerate(FACES) if number not in free]
        follows = on_faces(self.points_mm, self.half_mm, free)
        of_edges = [(0, x) in shared or (1, y) in shared for x, y in EDGES]
        of_faces = [side in shared for side in FACES]
        kept = np.flatnonzero(np.repeat([*of_edges, *of_faces], [ports.per_edge] * 4 + [ports.per_face] * 4))
        values = ports.values(self.points_mm[follows])[:, kept]
        n, m, k = len(self.points_mm), 3 * len(kept), self.transfer.shape[1]

        K = (values.T @ self.stiffness.reshape(n, 9 * n)[follows]).reshape(m, n, 3)
        S = np.einsum("apc,pq->aqc", K[:, follows], values, optimize=True).reshape(m, m)
        L = (values.T @ self.transfer.reshape(n, 3 * k)[follows]).reshape(m, k)
        C = self.compliance
        loose = (3 * np.flatnonzero(~follows)[:, None] + np.arange(3)).ravel()
        if len(loose):
            coupling = np.hstack([K[:, ~follows].reshape(m, len(loose)).T, self.transfer[loose]])
            lower = cholesky(self.stiffness[np.ix_(loose, loose)], lower=True, overwrite_a=True, check_finite=False)
            half = solve_triangular(lower, coupling, lower=True, overwrite_b=True, check_finite=False)
            of_modes, of_loads = half[:, :m], half[:, m:]
            S, L, C = S - of_modes.T @ of_modes, L - of_modes.T @ of_loads, C + of_loads.T @ of_loads
        dofs = (3 * kept[:, None] + np.arange(3)).ravel()
        stiffness, transfer = np.eye(3 * ports.n_modes), np.zeros((3 * ports.n_modes, k))
        stiffness[np.ix_(dofs, dofs)] = (S + S.T) / 2
        transfer[dofs] = L
        return CondensedCell(
            ports=ports,
            stiffness=stiffness,
            transfer=transfer,
            compliance=C,
            unknowns=self.unknowns,
            residual=self.residual,
        )
