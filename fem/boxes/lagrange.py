"""Lagrange functions on Gauss-Lobatto points: their values, slopes and integrals along a line, and in a cube."""

from functools import cache

import numpy as np
from numpy.polynomial import legendre

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
    """Lagrange functions and their derivatives at x in [-1, 1], both of shape (..., order + 1).

    Examples
    --------
    >>> shape_functions(1, np.array([0.0]))
    (array([[0.5, 0.5]]), array([[-0.5,  0.5]]))
    """
    functions, derivatives = _to_legendre(order)
    powers = legendre.legvander(x, order)
    return powers @ functions, powers[..., :order] @ derivatives


def cube_functions(order: int, places: FloatArray) -> FloatArray:
    """Functions of a box at places (k, 3) of [-1, 1]³, shape (k, (order + 1)³); nodes run z fastest."""
    X, Y, Z = (shape_functions(order, places[:, d])[0] for d in range(3))
    return np.einsum("ki,kj,kl->kijl", X, Y, Z).reshape(len(places), -1)


def cube_slopes(order: int, places: FloatArray) -> FloatArray:
    """Their derivatives along each axis of [-1, 1]³, shape (3, k, (order + 1)³)."""
    along = [shape_functions(order, places[:, d]) for d in range(3)]
    return np.stack([
        np.einsum("ki,kj,kl->kijl", *(along[axis][int(axis == d)] for axis in range(3))).reshape(len(places), -1)
        for d in range(3)
    ])  # fmt: skip


def interval_integrals(
    order: int, left: FloatArray, right: FloatArray, start: FloatArray, end: FloatArray
) -> FloatArray:
    """∫ φₐ dx over [start, end] of the functions of elements [left, right] that hold it, (m, order + 1); exact."""
    x, weights = gauss_points(order // 2 + 1)
    half = (end - start) / 2
    places = (2 * (start[:, None] + half[:, None] * (x + 1)) - (left + right)[:, None]) / (right - left)[:, None]
    return half[:, None] * np.einsum("q,mqa->ma", weights, shape_functions(order, places)[0])
