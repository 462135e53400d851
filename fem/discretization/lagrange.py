"""Lagrange functions on Gauss-Lobatto points along lines, and stiffness of boxes made of their products."""

from functools import cache
from itertools import pairwise

import numpy as np
from numpy.polynomial import legendre

from geometry.design import Material
from geometry.layout import FloatArray


@cache
def lobatto_points(order: int) -> FloatArray:
    """The order + 1 Gauss-Lobatto points of [-1, 1], read-only: nodes of the Lagrange functions."""
    inner = np.sort(legendre.legroots(legendre.legder([0.0] * order + [1.0]))) if order > 1 else np.zeros(0)
    return _read_only(np.concatenate([[-1.0], inner, [1.0]]))


@cache
def gauss_points(count: int) -> tuple[FloatArray, FloatArray]:
    """Gauss points of [-1, 1] and their weights, read-only."""
    x, weights = legendre.leggauss(count)
    return _read_only(x), _read_only(weights)


def _read_only(values: FloatArray) -> FloatArray:
    values.flags.writeable = False
    return values


@cache
def _to_legendre(order: int) -> tuple[FloatArray, FloatArray]:
    """Legendre coefficients of the Lagrange functions, and of their derivatives; columns are functions."""
    coefficients: FloatArray = np.asarray(np.linalg.inv(legendre.legvander(lobatto_points(order), order)), np.float64)
    return coefficients, np.asarray(legendre.legder(coefficients), np.float64)


def shape_functions(order: int, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lagrange functions and their derivatives at x in [-1, 1], both of shape (n_x, order + 1).

    Examples
    --------
    >>> shape_functions(1, np.array([0.0]))
    (array([[0.5, 0.5]]), array([[-0.5,  0.5]]))
    """
    functions, derivatives = _to_legendre(order)
    powers = legendre.legvander(x, order)
    return powers @ functions, powers[:, :order] @ derivatives


def cube_functions(order: int, places: FloatArray) -> FloatArray:
    """Functions of a box at places (k, 3) of [-1, 1]³, shape (k, (order + 1)³); nodes run z fastest."""
    X, Y, Z = (shape_functions(order, places[:, d])[0] for d in range(3))
    return np.einsum("ki,kj,kl->kijl", X, Y, Z).reshape(len(places), -1)


def interval_integral(order: int, left: float, right: float, start: float, end: float) -> FloatArray:
    """∫ φₐ dx over [start, end] of the functions of an element [left, right] that holds it, exact."""
    x, weights = gauss_points(order // 2 + 1)
    half = (end - start) / 2
    places = (2 * (start + half * (x + 1)) - left - right) / (right - left)
    return half * (weights @ shape_functions(order, places)[0])


def line_nodes(lines: FloatArray, order: int) -> FloatArray:
    """Position of every node of a line, shape (n_elements·order + 1,)."""
    share = (lobatto_points(order)[1:] + 1) / 2
    return np.concatenate([lines[:1], (lines[:-1, None] + np.diff(lines)[:, None] * share).ravel()])


def line_integral(lines: FloatArray, order: int, start: float, end: float) -> FloatArray:
    """∫ φₐ dx over [start, end] of every function of a line; exact, whether or not the ends are on the lines."""
    integral = np.zeros(order * (len(lines) - 1) + 1)
    for e, (left, right) in enumerate(pairwise(lines)):
        a, b = max(left, start), min(right, end)
        if b > a:
            integral[e * order : (e + 1) * order + 1] += interval_integral(order, left, right, a, b)
    return integral


def line_values(lines: FloatArray, order: int, positions: FloatArray) -> FloatArray:
    """Value of every function of a line at positions (k,) on it, shape (k, n_elements·order + 1)."""
    e = np.clip(np.searchsorted(lines, positions, side="right") - 1, 0, len(lines) - 2)
    within = (2 * positions - lines[e] - lines[e + 1]) / (lines[e + 1] - lines[e])
    values = np.zeros((len(positions), order * (len(lines) - 1) + 1))
    columns = e[:, None] * order + np.arange(order + 1)
    np.put_along_axis(values, columns, shape_functions(order, within)[0], axis=1)
    return values


@cache
def reference_matrices(order: int, n_points: int) -> dict[tuple[bool, bool], FloatArray]:
    """∫ φₐ⁽ⁱ⁾ φ_b⁽ʲ⁾ dx over [−1, 1] by n_points Gauss points; keyed by (i, j): which is differentiated."""
    x, weights = gauss_points(n_points)
    functions = shape_functions(order, x)
    return {
        (test, trial): np.einsum("q,qa,qb->ab", weights, functions[test], functions[trial])
        for test in (False, True)
        for trial in (False, True)
    }


@cache
def cube_products(order: int, n_points: int) -> FloatArray:
    """∫ ∂ₖφₐ ∂ₗφ_b over [−1, 1]³ by n_points Gauss points along each axis, shape (3, 3, n, n)."""
    along = reference_matrices(order, n_points)
    n = (order + 1) ** 3
    products = np.empty((3, 3, n, n))
    for k, m in np.ndindex(3, 3):
        X, Y, Z = (along[k == d, m == d] for d in range(3))
        products[k, m] = np.einsum("ad,be,cf->abcdef", X, Y, Z).reshape(n, n)
    return products


def elastic_tensors(material: Material, lean: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Volumetric (λ) and shear (μ) part of the elastic tensor in the coordinates of a sheared box.

    Parameters
    ----------
    material : Material
    lean : tuple
        Shift of the body along x and y per height, x = ξ + lean·ζ; (0, 0) for an upright box.

    Returns
    -------
    two arrays, shape (3, 3, 3, 3)
        Entry [a, k, b, l] multiplies ∂_k v_a ∂_l u_b: u and v along x, y, z, derivatives along ξ, η, ζ. C is pulled
        back by the constant Jacobian of the shear, whose determinant is 1.
    """
    lame, mu = material.lame_mpa
    one = np.eye(3)
    pull = np.eye(3)  # ∂_x = Σ_m pull[m, x] ∂_m
    pull[:2, 2] = -np.array(lean)
    volumetric = lame * np.einsum("ak,bl->akbl", one, one)
    shear = mu * (np.einsum("ab,kl->akbl", one, one) + np.einsum("al,bk->akbl", one, one))
    first, second = (np.einsum("mk,akbl,nl->ambn", pull, C, pull) for C in (volumetric, shear))
    return first, second


def element_terms(
    material: Material, lean: tuple[float, float], volumetric: FloatArray, shear: FloatArray
) -> tuple[list[tuple[int, int]], FloatArray]:
    """Stiffness of boxes of any size as a sum of fixed matrices: K = Σ s_kl M_kl, see `term_scales`.

    Parameters
    ----------
    material : Material
    lean : tuple
        Shift of the body along x and y per height.
    volumetric, shear : arrays, shape (3, 3, n, n)
        ∫ ∂ₖφₐ ∂ₗφ_b over [−1, 1]³, integrated as each part of the energy needs it.

    Returns
    -------
    list of (k, l) and array, shape (n_terms, n, 3, n, 3)
        Rows and columns run over nodes, then components.
    """
    tensors = elastic_tensors(material, lean)
    n = volumetric.shape[-1]
    pairs, terms = [], []
    for k in range(3):
        for m in range(k, 3):
            M = np.zeros((n, 3, n, 3))
            for row, column in {(k, m), (m, k)}:
                for C, products in zip(tensors, (volumetric, shear), strict=True):
                    for a, b in np.argwhere(C[:, row, :, column]):
                        M[:, a, :, b] += C[a, row, b, column] * products[row, column]
            if M.any():
                pairs.append((k, m))
                terms.append(M)
    return pairs, np.array(terms)


def term_scales(pairs: list[tuple[int, int]], size_mm: FloatArray) -> FloatArray:
    """Factors s_kl = (volume/8) (2/h_k) (2/h_l) of `element_terms` for boxes of sizes (m, 3), shape (m, n_terms)."""
    return np.stack([size_mm.prod(axis=1) / 2 / size_mm[:, k] / size_mm[:, m] for k, m in pairs], axis=1)
