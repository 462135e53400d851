"""Resistances of an array's pillars by conduction, in states of one of its grids."""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.boxes.boxes import Boxes
from fem.conduction.potentials import Piezoresistivity, pillars_per_mm
from fem.conduction.reduced import ACROSS, ALONG, reduced_conduction
from fem.finite.preloads import PreloadedArray
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pillar_ends, pillar_volumes, unit_centres

MIN_J = 0.3  #: of the volume of a pillar's point that counts: rubber of ν = 0.49 keeps far more


class PointGradients:
    """Deformation gradients at fixed points (n, 3) of boxes; those outside are taken for the nearest ones inside."""

    def __init__(self, boxes: Boxes, points_mm: FloatArray) -> None:
        self.n_points, self._slopes = len(points_mm), boxes.slopes(points_mm)

    def of(self, displacement_mm: FloatArray) -> FloatArray:
        """∂u/∂X (m, n, 3, 3) of m states of the nodes (m, n_nodes, 3) [mm]; add 1 for F = ∂x/∂X."""
        m = len(displacement_mm)
        columns = displacement_mm.transpose(1, 0, 2).reshape(-1, 3 * m)
        found = (self._slopes @ columns).reshape(3, self.n_points, m, 3)
        return np.ascontiguousarray(found.transpose(2, 1, 3, 0))


class PillarReader:
    """Conduction in the pillars of every unit of an array of k units, as its electrics say."""

    def __init__(self, design: SensorDesign) -> None:
        self.unit, electrics = design.unit, design.electrics
        self._piezo = Piezoresistivity(along=electrics.elastoresistance_along, across=electrics.elastoresistance_across)
        self._reduced = reduced_conduction(design.unit)
        centres = np.pad(unit_centres(design), ((0, 0), (0, 1)))
        self._points = (centres[:, None] + self._reduced.points_mm).reshape(-1, 3)
        self._shape = (len(centres), len(self._reduced.points_mm), 3, 3)

    def slopes_on(self, array: PreloadedArray) -> sp.csr_matrix:
        """Rows that take the nodes of an array's grid to slopes at this reader's points, see `Boxes.slopes`."""
        return array.body.boxes.slopes(self._points)

    def ratios(self, gradient: FloatArray, electrode_mm: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Resistances over eq. 1's.

        Parameters
        ----------
        gradient : array, shape (m, k·n, 3, 3)
            ∂u/∂X of m states at this reader's points, see `gradients`.
        electrode_mm : array, shape (m, k, n_upper, 3)
            Displacements of the same states, for eq. 1.

        Returns
        -------
        array, shape (m, k, n_pillars)
            1 in states that are no answers.
        array, shape (m,)
            Which states are: on every level of a pillar some point has kept its volume.

        Notes
        -----
        Points under the edge of a plate, where coarse grids tear the rubber, take the mean of those on their level.
        """
        F, good = _mended(np.eye(3) + gradient.reshape(len(gradient), *self._shape))
        bottom, top = pillar_ends(self.unit).transpose(1, 0, 2)
        along = (top - bottom) + electrode_mm[good][..., self.unit.layout.pillar_top, :]
        ratios = np.ones((*electrode_mm.shape[:2], len(self.unit.layout.pillars)))
        per_mm = pillars_per_mm(self._reduced.conductances(F[good], self._piezo), self.unit.layout.pillar_terminals)
        ratios[good] = per_mm * pillar_volumes(self.unit) / (along**2).sum(axis=-1)
        return ratios, good


def gradients(slopes: sp.csr_matrix, displacement_mm: FloatArray) -> FloatArray:
    """∂u/∂X (m, n, 3, 3) of m states of the nodes (m, n_nodes, 3) [mm] by `Boxes.slopes` (3 n, n_nodes)."""
    m = len(displacement_mm)
    found = slopes @ displacement_mm.transpose(1, 0, 2).reshape(-1, 3 * m)
    return np.ascontiguousarray(found.reshape(3, -1, m, 3).transpose(2, 1, 3, 0))


def _mended(F: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Deformations (m, k, n, 3, 3) with torn points replaced by the mean of their level; states that could, (m,)."""
    by_level = F.reshape(*F.shape[:2], F.shape[2] // (ACROSS**2 * ALONG), ACROSS**2, ALONG, 3, 3)
    kept = (np.linalg.det(by_level) > MIN_J)[..., None, None]
    count = kept.sum(axis=3, keepdims=True)
    mean = (by_level * kept).sum(axis=3, keepdims=True) / np.maximum(count, 1)
    whole = np.where(kept, by_level, mean)
    good = (count > 0).all(axis=(1, 2, 3, 4, 5, 6)) & (np.linalg.det(whole) > 0).all(axis=(1, 2, 3, 4))
    return whole.reshape(F.shape), np.asarray(good)
