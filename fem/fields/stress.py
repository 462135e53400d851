"""Stress of a finite-element answer, averaged at the corners of its elements; for pictures.

Near ν = 0.5 the pointwise λ div u of a displacement answer is noise: only those moments of div u that the elements
constrain mean anything. In boxes, whose pressures are linear, that is its linear part, and all strains are taken by
theirs. In Taylor-Hood tetrahedra gradients are linear, and the pressure is a field of its own. Stresses at corners are
averaged over the elements of one region that meet, weighted by volume: across an interface of two rubbers stress may
jump.

Components run xx, yy, zz, yz, xz, xy everywhere; tension is positive.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from fem.tetrahedra.elements import Elements, shape_gradients, shape_values
from fem.tetrahedra.mixed import MIN_POISSON, lame_of_regions
from geometry.design import Material
from geometry.layout import FloatArray

COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  #: xx, yy, zz, yz, xz, xy
MAX_NUMBERS = 4_000_000  #: in memory at a time


@dataclass(frozen=True, eq=False)
class CornerStress:
    """Stress at the corners of elements, each region's on its own."""

    number: NDArray[np.int64]  #: (m, 4 or 8): number of the stress at each element's corners
    stress_mpa: FloatArray  #: (n_corners, 6, c) of c answers

    def at(self, elements: Elements, places: NDArray[np.int64], local: FloatArray) -> FloatArray:
        """Stress where `Elements.places` found points, shape (k, 6, c)."""
        values = shape_values(elements.corner_element, local.T)
        return np.einsum("pa,pasc->psc", values, self.stress_mpa[self.number[places]], optimize=True)


def corner_numbers(elements: Elements) -> NDArray[np.int64]:
    """Number of the stress at each corner, shape (m, 4 or 8): as those of `elasticity.pressure_dofs`."""
    keys = elements.corners * (int(elements.region.max()) + 1) + elements.region[:, None]
    _, numbers = np.unique(keys, return_inverse=True)
    return numbers.reshape(keys.shape)


def corner_stress(
    elements: Elements, material: list[Material], u: FloatArray, pressure: FloatArray | None = None
) -> CornerStress:
    """Stress of answers, averaged at corners.

    Parameters
    ----------
    elements : Elements
    material : list of Material
        One per region.
    u : array, shape (n_nodes, 3, c)
        c answers [mm].
    pressure : array, shape (n_pressure, c), optional
        p = λ div u of the mixed form, numbered as `elasticity.pressure_dofs` does [MPa]; without it λ times the linear
        part of div u in each element, which is the pressure of boxes.
    """
    number, n_answers = corner_numbers(elements), u.shape[2]
    lame_mpa, mu_mpa = lame_of_regions(material, elements.region, 0.0 if pressure is None else MIN_POISSON)
    # what an element's corner adds to the mean there: (n_corners, m·n_of_element)
    weight = np.repeat(elements.volumes_mm3, number.shape[1])
    average = sp.csr_matrix((weight, (number.ravel(), np.arange(number.size))))
    average = sp.diags_array(1 / np.asarray(average.sum(axis=1)).ravel()) @ average
    total = np.zeros((average.shape[0], 6 * n_answers))
    for some, H in _corner_gradients(elements, u):
        mu = mu_mpa[some, None, None]
        stress = np.stack([mu * (H[:, :, i, j] + H[:, :, j, i]) for i, j in COMPONENTS], axis=2)
        if pressure is None:
            stress[:, :, :3] += lame_mpa[some, None, None, None] * np.trace(H, axis1=2, axis2=3)[:, :, None]
        columns = slice(some.start * number.shape[1], some.stop * number.shape[1])
        total += average[:, columns] @ stress.reshape(-1, 6 * n_answers)
    total = total.reshape(-1, 6, n_answers)
    if pressure is not None:
        total[:, :3] += pressure[:, None]
    return CornerStress(number, total)


def projected_pressure(elements: Elements, material: list[Material], u: FloatArray) -> FloatArray:
    """The pressure of the mixed form of tetrahedra, from its displacements.

    Parameters as in `corner_stress`, whose `pressure` it is: ∫ div u q − ∫ p q / λ = 0 for all q defines it.
    """
    number = corner_numbers(elements)
    lame_mpa, _ = lame_of_regions(material, elements.region, MIN_POISSON)
    mass = elements.volumes_mm3[:, None, None] * (1 + np.eye(4)) / 20
    rows, columns = (np.broadcast_to(numbers, mass.shape) for numbers in (number[:, :, None], number[:, None, :]))
    shape = (int(number.max()) + 1,) * 2
    matrix = sp.csc_matrix(((mass / lame_mpa[:, None, None]).ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    rhs = np.zeros((shape[0], u.shape[2]))
    for some, H in _corner_gradients(elements, u):
        np.add.at(rhs, number[some], mass[some] @ np.trace(H, axis1=2, axis2=3))
    return splu(matrix).solve(rhs)


def nodal_stress(elements: Elements, material: list[Material], u: FloatArray, region: int) -> FloatArray:
    """Stress of one answer (n_nodes, 3) at the nodes of one region, shape (n_nodes, 6); elsewhere not a number."""
    mixed = None if elements.is_box else projected_pressure(elements, material, u[:, :, None])
    found = corner_stress(elements, material, u[:, :, None], mixed)
    own = np.flatnonzero(elements.region == region)
    values = shape_values(elements.corner_element, elements.element.doflocs.T)
    stress = np.full((len(elements.points_mm), 6), np.nan)
    # nodes that elements share have one stress in all of them
    stress[elements.nodes[own]] = np.einsum("av,evs->eas", values, found.stress_mpa[found.number[own], :, 0])
    return stress


def _corner_gradients(elements: Elements, u: FloatArray) -> Iterator[tuple[slice, FloatArray]]:
    """Linear part of the displacement gradient at elements' corners, (m, corners, 3, 3, c), some elements at a time."""
    corners = elements.corner_element.doflocs.T
    slopes = shape_gradients(elements.element, corners)  # (v, a, k); those of P2 are linear
    if elements.is_box:
        x, w = np.polynomial.legendre.leggauss(3)
        points = np.stack(np.meshgrid(x, x, x, indexing="ij")).reshape(3, -1) / 2 + 0.5
        functions, wanted = (np.column_stack([np.ones(at.shape[1]), at.T - 0.5]) for at in (points, corners))
        weighted = functions * np.einsum("i,j,k->ijk", w, w, w).reshape(-1, 1)
        fitted = wanted @ np.linalg.solve(weighted.T @ functions, weighted.T)  # values at points to those at corners
        slopes = np.einsum("vq,qak->vak", fitted, shape_gradients(elements.element, points))
    width = max(1, MAX_NUMBERS // (len(slopes) * 9 * u.shape[2]))
    for first in range(0, len(elements.nodes), width):
        some = slice(first, min(first + width, len(elements.nodes)))
        yield (
            some,
            np.einsum(
                "vak,eki,eajc->evijc", slopes, elements.inverse_jacobian[some], u[elements.nodes[some]], optimize=True
            ),
        )


def von_mises(stress_mpa: FloatArray) -> FloatArray:
    """√(3/2 s:s) of stresses (..., 6), s their deviator, shape (...) [MPa].

    >>> float(von_mises(np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])))
    2.0
    """
    xx, yy, zz, yz, xz, xy = np.moveaxis(np.asarray(stress_mpa, dtype=float), -1, 0)
    normal = ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2
    return np.sqrt(normal + 3 * (yz**2 + xz**2 + xy**2))


def pressure(stress_mpa: FloatArray) -> FloatArray:
    """−tr σ/3 of stresses (..., 6), positive in compression, shape (...) [MPa].

    >>> float(pressure(np.array([-1.0, -1.0, -1.0, 0.0, 0.5, 0.0])))
    1.0
    """
    return -np.asarray(stress_mpa, dtype=float)[..., :3].mean(axis=-1)
