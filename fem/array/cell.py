"""One unit cell, condensed statically onto the port modes of its side faces.

Everything inside the cell is eliminated. What is left is small and dense: the stiffness between port modes, and what
rectangles of the top face (pads, electrodes) see of them. From that `coupled_cells.py` couples the copies of an array.

Port modes are the polynomials by which a cell touches the next. On the side faces of a cell x, y ∈ [−a, a], z ∈ [0, h]
displacements are combinations of hierarchical Lobatto functions: along a side the two linear ones of its vertical edges
and `side` − 1 bubbles, upwards `up` functions that vanish at the clamped base. Modes belong to a vertical edge or to a
face, so that neighbours share them and the field is continuous.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import block_diag

from fem.discretization.elasticity import ElasticBody
from fem.discretization.grid import Grid, GridBasis, grid_body
from fem.discretization.mirrors import QUARTER, Parity, flipped_rectangles, images, parities, sign
from fem.discretization.patch import patch_means
from fem.discretization.plate import Plate, without_plate
from fem.factor import Factor, checked_solve, schur_product
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


ON_FACE = 1e-9  #: of the half pitch: how far rounding may take a node off a side face


@dataclass(frozen=True, eq=False, kw_only=True)
class CondensedCell:
    """A cell seen from its ports and from k rectangles of its top face, three functionals (x, y, z) each.

    With port displacements q and forces f [N] spread evenly over the rectangles, the cell pulls its ports by S q − L f,
    and the mean displacements of the rectangles are Lᵀ q + C f.
    """

    ports: PortModes
    stiffness: FloatArray  #: S, (n_modes·3, n_modes·3) [N/mm]
    reach: FloatArray  #: L, (n_modes·3, k·3), no unit
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
    def standing_alone(self) -> FloatArray:
        """Mean displacements of the rectangles per newton on them, with free side faces, (k·3, k·3) [mm/N]."""
        return self.compliance + self.reach.T @ np.linalg.solve(self.stiffness, self.reach)

    def extrapolated(self, coarser: "CondensedCell", share: float) -> "CondensedCell":
        """Richardson extrapolation from a coarser cell of the same ports, by a share of their difference."""

        def on(fine: FloatArray, coarse: FloatArray) -> FloatArray:
            return fine + share * (fine - coarse)

        return replace(
            self,
            stiffness=on(self.stiffness, coarser.stiffness),
            reach=on(self.reach, coarser.reach),
            compliance=on(self.compliance, coarser.compliance),
        )

    def exchanged(self, twins: NDArray[np.int64]) -> "CondensedCell":
        """The cell that this one becomes when x and y are exchanged.

        `twins` (k,) is the number of the rectangle of this cell that becomes each rectangle of the other.
        """
        return self._image(self.ports.exchanged, (twins[:, None] * 3 + np.array([1, 0, 2])).ravel())

    def mirrored(self, axis: int, twins: NDArray[np.int64]) -> "CondensedCell":
        """The cell that this one becomes in the mirror x = 0 or y = 0, by its axis; `twins` as in `exchanged`."""
        dofs, signs = self.ports.image(axis, (1, 1))
        turned = np.tile([sign(component, axis, (1, 1)) for component in range(3)], len(twins))
        image = self._image(dofs, (twins[:, None] * 3 + np.arange(3)).ravel())
        return replace(
            image,
            stiffness=signs[:, None] * image.stiffness * signs,
            reach=signs[:, None] * image.reach * turned,
            compliance=turned[:, None] * image.compliance * turned,
        )

    def seeing(self, rectangles: NDArray[np.int64]) -> "CondensedCell":
        """The same cell with some of its rectangles, by number."""
        return self._image(np.arange(len(self.stiffness)), (rectangles[:, None] * 3 + np.arange(3)).ravel())

    def _image(self, dofs: NDArray[np.int64], seen: NDArray[np.int64]) -> "CondensedCell":
        return replace(
            self,
            stiffness=self.stiffness[np.ix_(dofs, dofs)],
            reach=self.reach[np.ix_(dofs, seen)],
            compliance=self.compliance[np.ix_(seen, seen)],
        )

    def of_degree(self, degree: int) -> "CondensedCell":
        """The same cell with port modes up to a lower degree along sides and upwards, at no cost."""
        kept = self.ports.up_to(degree)
        dofs = (kept[:, None] * 3 + np.arange(3)).ravel()
        return replace(
            self,
            ports=replace(self.ports, side=min(degree, self.ports.side), up=min(degree, self.ports.up)),
            stiffness=self.stiffness[np.ix_(dofs, dofs)],
            reach=self.reach[dofs],
        )


def condense(body: ElasticBody, ports: PortModes, rectangles: FloatArray, plate: Plate | None = None) -> CondensedCell:
    """Condense a meshed cell, whatever its mesh.

    Parameters
    ----------
    body : ElasticBody
        The cell x, y ∈ [−a, a], its base clamped, its side faces free.
    ports : PortModes
    rectangles : array, shape (k, 4)
        x0, y0, x1, y1 of the rectangles of its top face that are loaded or observed [mm].
    plate : Plate, optional
        Bonded to the top face, off the side faces. A force spread over its own rectangle is then one on its middle.

    Notes
    -----
    S = Φᵀ(K_BB − K_BI K_II⁻¹ K_IB)Φ, L = Φᵀ(f_B − K_BI K_II⁻¹ f_I), C = f_Iᵀ K_II⁻¹ f_I, where B are the unknowns on
    the side faces, which follow the port modes Φ, and I the others, all pressures included. With a plate B holds what
    is bonded to it as well, Φ its motions, and these are then eliminated (`plate.without_plate`).
    """
    parts = condensation(body, ports, rectangles, plate)
    S, L, C, residual = _eliminate(body, parts)
    return CondensedCell(
        ports=ports, stiffness=S, reach=L, compliance=C, unknowns=body.matrix.shape[0], residual=residual
    )


@dataclass(frozen=True, eq=False)
class Condensation:
    """A body's system split into what follows port modes and what is eliminated; notation of `condense`."""

    inner: NDArray[np.int64]  #: I, numbers of unknowns
    outer: NDArray[np.int64]  #: B
    n_ports: int  #: columns of Φ that are port modes; those after them are motions of a plate
    K_II: sp.csr_matrix
    K_IB: sp.csr_matrix
    K_BB: sp.csr_matrix
    modes: FloatArray  #: Φ, (len(outer), n_ports) or 6 more columns
    loads: FloatArray  #: f, (unknowns, k·3)

    @property
    def has_plate(self) -> bool:
        return self.modes.shape[1] > self.n_ports

    @classmethod
    def of(
        cls,
        body: ElasticBody,
        at_ports: NDArray[np.int64],
        modes: FloatArray,
        loads: FloatArray,
        plate: Plate | None = None,
        parity: Parity | None = None,
    ) -> "Condensation":
        """Split a system of which some displacement degrees of freedom follow modes, and those at a plate its motions.

        Shapes: `at_ports` (n,), `modes` (n, n_ports). Of the motions only those of the parity count, if one is given.
        """
        n_ports = modes.shape[1]
        at_modes = at_ports
        if plate is not None:
            at_plate, motions = plate.followers(body.free, body.basis.doflocs, parity)
            at_modes, place = np.unique(np.concatenate([at_ports, at_plate]), return_inverse=True)
            modes = block_diag(modes, motions)[np.argsort(place)]
        on_mode = np.zeros(body.matrix.shape[0], dtype=bool)
        on_mode[np.searchsorted(body.free, at_modes)] = True
        inner, outer = np.flatnonzero(~on_mode), np.flatnonzero(on_mode)
        of_inner = body.matrix[inner]
        return cls(
            inner=inner,
            outer=outer,
            n_ports=n_ports,
            K_II=of_inner[:, inner].tocsr(),
            K_IB=of_inner[:, outer],
            K_BB=body.matrix[outer][:, outer],
            modes=modes,
            loads=loads,
        )


def condensation(
    body: ElasticBody, ports: PortModes, rectangles: FloatArray, plate: Plate | None = None
) -> Condensation:
    """Split a whole cell's system; parameters as in `condense`."""
    nodes = body.basis.doflocs
    on_side = (np.abs(nodes[:2]) > ports.half_mm * (1 - ON_FACE)).any(axis=0)
    at_ports = body.free[on_side[body.free // 3]]  # displacement degrees of freedom on the side faces
    number, place = np.unique(at_ports // 3, return_inverse=True)
    modes = np.zeros((len(at_ports), ports.n_modes, 3))
    modes[np.arange(len(at_ports)), :, at_ports % 3] = ports.values(nodes[:, number].T)[place]
    loads = body.loads(patch_means(body.basis, rectangles).T.toarray())
    return Condensation.of(body, at_ports, modes.reshape(len(at_ports), -1), loads, plate)


def condense_by_parity(
    basis: GridBasis,
    stiffness: sp.csr_matrix,
    ports: PortModes,
    rectangles: FloatArray,
    plate: Plate | None = None,
) -> CondensedCell:
    """Condense a cell that is its own mirror image in x and in y, from a grid of its quarter x, y ∈ [0, a].

    A displacement splits into four parities, each a problem of the quarter with its own conditions on the mirror planes
    (`fem.discretization.mirrors`); four quarters cost far less than one whole. Where the grid is the same in x and y,
    parity (−1, 1) is (1, −1) with x and y exchanged, and need not be solved. `rectangles` may lie anywhere on the whole
    cell, a plate only in its middle. Otherwise as `condense`; `stiffness` is that of `grid_stiffness` on the quarter.
    """
    k = len(rectangles)
    square = _is_square(basis.grid)
    if square:
        rectangles = np.vstack([rectangles, rectangles[:, [1, 0, 3, 2]]])
    means = _image_means(basis, rectangles)
    parts = {
        parity: _parity_part(basis, stiffness, ports, means, parity, plate)
        for parity in parities(QUARTER)
        if not (square and parity == (-1, 1))
    }
    if square:
        parts[-1, 1] = parts[1, -1].exchanged(twins=np.roll(np.arange(2 * k), k))
    return CondensedCell(
        ports=ports,
        stiffness=np.sum([part.stiffness for part in parts.values()], axis=0),
        reach=np.sum([part.reach[:, : 3 * k] for part in parts.values()], axis=0),
        compliance=np.sum([part.compliance[: 3 * k, : 3 * k] for part in parts.values()], axis=0),
        unknowns=max(part.unknowns for part in parts.values()),
        residual=max(part.residual for part in parts.values()),
    )


def _parity_part(
    basis: GridBasis,
    stiffness: sp.csr_matrix,
    ports: PortModes,
    means: FloatArray,
    parity: Parity,
    plate: Plate | None,
) -> CondensedCell:
    """The share of a cell's matrices that displacements of one parity have; `means` of `_image_means`."""
    nodes = basis.doflocs
    on_side = nodes[:2].max(axis=0) > ports.half_mm * (1 - ON_FACE)
    body = grid_body(basis, stiffness, mirrors=parity)
    at_ports = body.free[on_side[body.free // 3]]
    number, place = np.unique(at_ports // 3, return_inverse=True)
    expanded, share = ports.of_parity(parity)
    values = ports.values(nodes[:, number].T)
    modes = np.stack([values @ expanded[component::3] for component in range(3)], axis=1)[place, at_ports % 3]
    # what a rectangle sees of a displacement of this parity, all four images of it gathered on the quarter
    signs = np.stack([signs for _, signs in images(QUARTER, parity)])
    gathered = np.einsum("nqki,qi->nki", means, signs).reshape(len(means), -1)
    parts = Condensation.of(body, at_ports, modes, body.loads(gathered), plate, parity)
    S, L, C, residual = _eliminate(body, parts)
    return CondensedCell(
        ports=ports,
        stiffness=4 * (share.T @ (share.T @ S).T),
        reach=share.T @ L,
        compliance=C / 4,
        unknowns=len(body.free),
        residual=residual,
    )


def _is_square(grid: Grid) -> bool:
    """True if a grid stays the same when x and y are exchanged."""
    if not (np.array_equal(grid.x, grid.y) and grid.lean[0] == grid.lean[1]):
        return False
    region = np.broadcast_to(grid.region, grid.shape)
    return np.array_equal(region, region.swapaxes(0, 1))


def _image_means(basis: GridBasis, rectangles: FloatArray) -> FloatArray:
    """`patch_means` of rectangles (k, 4) in their four mirror images, shape (n_displacement, 4, k, 3)."""
    mirrored = [flipped_rectangles(rectangles, flipped) for flipped, _ in images(QUARTER, (1, 1))]
    different, number = np.unique(np.vstack(mirrored), axis=0, return_inverse=True)
    means = patch_means(basis, different).T.toarray().reshape(-1, len(different), 3)
    return means[:, number.reshape(len(mirrored), -1)]


def _eliminate(body: ElasticBody, parts: Condensation) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """S, L and C of `condense`, and the residual of some of the solves: the first rectangle's, or a plate's motions."""
    factor = Factor(parts.K_II, definite=body.n_pressure == 0)
    n, loads = parts.modes.shape[1], parts.loads
    rhs = np.hstack([parts.K_IB @ parts.modes, loads[parts.inner]])
    product = schur_product(factor, rhs)
    S = parts.modes.T @ (parts.K_BB @ parts.modes) - product[:n, :n]
    L = parts.modes.T @ loads[parts.outer] - product[:n, n:]
    C = product[n:, n:]
    _, residual = checked_solve(factor, rhs[:, parts.n_ports :][:, :3])
    if parts.has_plate:
        S, L, C, *_ = without_plate(S, L, C, parts.n_ports)
    return (S + S.T) / 2, L, (C + C.T) / 2, residual
