"""Stress of a finite-element answer, averaged at the corners of its elements; for pictures.

Near ν = 0.5 the pointwise λ div u of a displacement answer is noise: only those moments of div u that the elements
constrain mean anything. In boxes, whose λ div u div v is integrated at 2 × 2 × 2 points, these are its values at those
points; there, at the points of superconvergence, the rest of the stress is best as well. In Taylor-Hood tetrahedra the
pressure is an unknown of its own. Stresses are taken there, carried to the corners linearly, and averaged over the
elements of one region that meet, weighted by volume: across an interface of two rubbers stress may jump.

Components run xx, yy, zz, yz, xz, xy everywhere; tension is positive.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from fem.discretization.elements import Elements, shape_gradients, shape_values
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

    Returns
    -------
    CornerStress
    """
    number, n_answers = corner_numbers(elements), u.shape[2]
    lame_mpa, mu_mpa = lame_of_regions(material, elements.region, 0.0 if pressure is None else MIN_POISSON)
    sampled, to_corners = _samples(elements)
    gauss, linear = _linear_part(elements, sampled)
    at_gauss = shape_gradients(elements.element, gauss)
    slopes = shape_gradients(elements.element, sampled)  # (q, a, k)
    # what an element's corner adds to the mean there: (n_corners, m·n_of_element)
    weight = np.repeat(elements.volumes_mm3, number.shape[1])
    average = sp.csr_matrix((weight, (number.ravel(), np.arange(number.size))))
    average = sp.diags_array(1 / np.asarray(average.sum(axis=1)).ravel()) @ average
    total = np.zeros((average.shape[0], 6 * n_answers))
    width = max(1, MAX_NUMBERS // (len(slopes) * 9 * n_answers))
    for first in range(0, len(elements.nodes), width):
        some = slice(first, first + width)
        gradient = np.einsum("qak,eki,eajc->eqijc", slopes, elements.inverse_jacobian[some], u[elements.nodes[some]],
                             optimize=True)  # fmt: skip
        stress = _sheared(gradient, mu_mpa[some])
        if pressure is None:
            inverse = elements.inverse_jacobian[some]
            div = np.einsum("qak,eki,eaic->eqc", at_gauss, inverse, u[elements.nodes[some]], optimize=True)
            stress[:, :, :3] += (lame_mpa[some, None, None] * (linear @ div))[:, :, None]
        at_corners = np.einsum("vq,eqsc->evsc", to_corners, stress)
        columns = slice(first * number.shape[1], (first + len(stress)) * number.shape[1])
        total += average[:, columns] @ at_corners.reshape(-1, 6 * n_answers)
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
    slopes = shape_gradients(elements.element, elements.corner_element.doflocs.T)
    div = np.einsum("qak,eki,eaic->eqc", slopes, elements.inverse_jacobian, u[elements.nodes], optimize=True)
    mass = elements.volumes_mm3[:, None, None] * (1 + np.eye(4)) / 20
    rows, columns = (np.broadcast_to(numbers, mass.shape) for numbers in (number[:, :, None], number[:, None, :]))
    shape = (int(number.max()) + 1,) * 2
    matrix = sp.csc_matrix(((mass / lame_mpa[:, None, None]).ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    rhs = np.zeros((shape[0], u.shape[2]))
    np.add.at(rhs, number, mass @ div)
    return splu(matrix).solve(rhs)


def nodal_stress(elements: Elements, material: list[Material], u: FloatArray, region: int) -> FloatArray:
    """Stress of one answer (n_nodes, 3) at the nodes of one region, shape (n_nodes, 6); elsewhere not a number."""
    mixed = None
    if len(elements.element.doflocs) == 10:
        mixed = projected_pressure(elements, material, u[:, :, None])
    found = corner_stress(elements, material, u[:, :, None], mixed)
    own = np.flatnonzero(elements.region == region)
    values = shape_values(elements.corner_element, elements.element.doflocs.T)
    at_nodes = np.einsum("av,evs->eas", values, found.stress_mpa[found.number[own], :, 0])
    stress = np.full((len(elements.points_mm), 6), np.nan)
    stress[elements.nodes[own]] = at_nodes  # those that share a node agree on it
    return stress


def _samples(elements: Elements) -> tuple[FloatArray, FloatArray]:
    """Local points (3, q) at which stress is taken, and what carries it from there to the corners, (corners, q)."""
    corners = elements.corner_element.doflocs.T
    if not elements.is_box:
        return corners, np.eye(4)  # gradients of P2 are linear: their values at the corners say all
    # the points of 2 × 2 × 2 span a box in the box; its trilinear functions reach out to the corners
    return (corners - 0.5) / np.sqrt(3) + 0.5, shape_values(elements.corner_element, (corners - 0.5) * np.sqrt(3) + 0.5)


def _linear_part(elements: Elements, sampled: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (3, g) of an element, and what takes values there to the linear part of them at `sampled`, (q, g)."""
    if not elements.is_box:
        return sampled, np.eye(sampled.shape[1])  # gradients of P2 are linear
    x, w = np.polynomial.legendre.leggauss(3)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij")).reshape(3, -1) / 2 + 0.5
    weights = np.einsum("i,j,k->ijk", w, w, w).ravel()
    functions, wanted = (np.column_stack([np.ones(at.shape[1]), at.T - 0.5]) for at in (points, sampled))
    return points, wanted @ np.linalg.solve(functions.T @ (weights[:, None] * functions), functions.T * weights)


def _sheared(gradient: FloatArray, mu_mpa: FloatArray) -> FloatArray:
    """2μ ε(u) of displacement gradients (m, q, 3, 3, c), shape (m, q, 6, c)."""
    mu = mu_mpa[:, None, None]
    return np.stack([mu * (gradient[:, :, i, j] + gradient[:, :, j, i]) for i, j in COMPONENTS], axis=2)


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
