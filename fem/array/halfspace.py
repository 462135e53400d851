"""The surface of an elastic half-space in closed form: mean displacements of rectangles under loads on others.

No mesh and no system to solve: a response in milliseconds. The sensor is a clamped layer, not a half-space;
`fem.array.layer` corrects for that. z points up and the body lies below z = 0; a force with z < 0 pushes down.
"""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import xlogy

from fem.array.response import ArrayResponse
from geometry.design import Array, Material, SensorDesign
from geometry.errors import TriPillarError
from geometry.layout import FloatArray, electrode_squares, pad_squares

#: the books' z points into the body, ours up: u_z and f_z change sign, which is [i, j] → flip[i] flip[j]
FLIP = np.outer([1.0, 1.0, -1.0], [1.0, 1.0, -1.0])

EDGE_PAIRS = np.array([1.0, -1.0, -1.0, 1.0])  #: signs of pairs of edges of two rectangles in an integral between them


class HalfspaceError(TriPillarError, ValueError):
    """A rectangle without an area, or one that the closed form cannot take."""


def mean_compliance(targets_mm: ArrayLike, loads_mm: ArrayLike, material: Material) -> FloatArray:
    """Mean displacement of rectangles of the surface per newton spread evenly over others.

    Parameters
    ----------
    targets_mm, loads_mm : arrays, shapes (..., 4)
        x0, y0, x1, y1 [mm]; leading dimensions broadcast. They may overlap, touch or coincide.
    material : Material
        Of the half-space.

    Returns
    -------
    array, shape (..., 3, 3)
        Mean displacement along the first axis per force along the second [mm/N].

    Raises
    ------
    HalfspaceError
        If a rectangle is empty.

    Notes
    -----
    On the surface, with r the distance, G the shear modulus and w = u·4πG, down positive (Johnson, *Contact Mechanics*,
    eq. 3.18 for the normal force P, section 3.6 for the tangential force Q along x; Q along y likewise):

        P:  w_x = −(1−2ν) x/r²,  w_d = 2(1−ν)/r
        Q:  w_x = 1/r + x²/r³ + (1−2ν) y²/r³,  w_y = 2ν x y/r³,  w_d = (1−2ν) x/r²

    These kernels are integrated four times, ∂⁴H/∂X²∂Y² = kernel, and H is summed with signs over the 16 differences
    between edges: exact. Far away the sum cancels: the relative error grows as 1e-16 · distance⁴ / (both areas),
    2e-11 for a 12 mm pad and a 2 mm electrode 100 mm apart, 2e-7 at 1 m.
    """
    target, load = np.broadcast_arrays(_rectangles(targets_mm), _rectangles(loads_mm))
    X = _edge_pairs(target[..., 0::2], load[..., 0::2])[..., :, None]
    Y = _edge_pairs(target[..., 1::2], load[..., 1::2])[..., None, :]
    xx, yy, xy, gx, gy = (
        np.einsum("...ab,a,b->...", kernel, EDGE_PAIRS, EDGE_PAIRS) / (_area(target) * _area(load))
        for kernel in _edge_kernels(*np.broadcast_arrays(X, Y))
    )
    nu, (_, G) = material.poisson, material.lame_mpa
    m = 1 - 2 * nu
    down = [  # by forces and displacements into the body; 1/r = x²/r³ + y²/r³
        [2 * xx + (1 + m) * yy, 2 * nu * xy, -m * gx],
        [2 * nu * xy, 2 * yy + (1 + m) * xx, -m * gy],
        [m * gx, m * gy, 2 * (1 - nu) * (xx + yy)],
    ]
    return FLIP * np.moveaxis(np.array(down), (0, 1), (-2, -1)) / (4 * np.pi * G)


def halfspace_response(design: SensorDesign) -> ArrayResponse:
    """Response of a sensor taken as a half-space of its matrix material.

    Parameters
    ----------
    design : SensorDesign
        Its pillars must be of the matrix's rubber for the answer to mean much: they are not seen.

    Returns
    -------
    ArrayResponse
        In closed form, so without unknowns, mesh or residual. `influence_mm_per_n` is a read-only view of a table with
        one entry per offset between units, so that an array of 48 × 48 takes kilobytes; ``np.array`` copies it.

    Notes
    -----
    As the paper assumes. The clamped base and the free sides are ignored, so that every unit answers too strongly and
    far ones much too: displacement falls as 1/r where in a layer it falls exponentially. On the paper's array of 10 mm
    it is 59 % off finite elements for a centre unit under its own pad and 157 % under its neighbour's; see
    `fem.array.layer.layer_response` for less than 1 %.
    """
    return response_by_translation(
        design, "halfspace", lambda targets, loads: mean_compliance(targets, loads, design.matrix_material)
    )


def response_by_translation(
    design: SensorDesign, method: str, mean: Callable[[FloatArray, FloatArray], FloatArray]
) -> ArrayResponse:
    """Response of a body that is the same everywhere along x and y: only offsets between units matter.

    Parameters
    ----------
    design : SensorDesign
        Where pads and electrodes are.
    method : str
        Name of the response's method.
    mean : function
        Compliance (..., 3, 3) [mm/N] of targets (..., 4) under loads (4,), as `mean_compliance`.

    Returns
    -------
    ArrayResponse
        Its influence is a read-only view of the table of offsets.
    """
    start = perf_counter()
    rows, cols, pitch_mm = design.array.rows, design.array.cols, design.array.pitch_mm
    single = replace(design, array=Array(rows=1, cols=1, pitch_mm=pitch_mm))
    pad, electrodes = pad_squares(single)[0], electrode_squares(single)
    table = np.empty((2 * rows - 1, 2 * cols - 1, len(electrodes), 3, 3))
    x = np.arange(1 - cols, cols)[:, None, None] * pitch_mm
    for number, steps in enumerate(range(1 - rows, rows)):  # a row at a time bounds the memory
        shift = np.concatenate([x, np.full_like(x, steps * pitch_mm)] * 2, axis=-1)
        table[number] = mean(electrodes + shift, pad)
    # influence[i, j, e, a, k, l, b] = table[i − k + rows − 1, j − l + cols − 1, e, a, b]: windows, one for each k, l
    windows = np.lib.stride_tricks.sliding_window_view(table, (rows, cols), axis=(0, 1))  # k reversed, l, e, a, b, i, j
    return ArrayResponse(
        design=design,
        influence_mm_per_n=windows[::-1, ::-1].transpose(5, 6, 2, 3, 0, 1, 4),
        residual=0.0,
        unknowns=0,
        seconds={"closed form": perf_counter() - start},
        method=method,
    )


def _edge_kernels(X: FloatArray, Y: FloatArray) -> tuple[FloatArray, ...]:
    """Fourth integrals H, ∂⁴H/∂X²∂Y², of x²/r³, y²/r³, x y/r³, x/r² and y/r², up to what the sum over edges cancels.

    Logarithms are written asinh(Y/|X|) for ln(Y + r): no cancellation at Y < 0, and 0 where the factor before one is 0.
    """
    r = np.hypot(X, Y)
    log_y, log_x = _asinh_ratio(Y, np.abs(X)), _asinh_ratio(X, np.abs(Y))
    xx = X * Y**2 / 2 * log_x + X**2 * r / 2 - r**3 / 3
    yy = Y * X**2 / 2 * log_y + Y**2 * r / 2 - r**3 / 3
    xy = -(X * Y * r / 3 + X**3 / 6 * log_y + Y**3 / 6 * log_x)
    turn_y, turn_x = np.arctan2(Y, np.abs(X)), np.arctan2(X, np.abs(Y))
    gx = xlogy(X * Y**2 / 2 - X**3 / 6, r) + np.abs(Y) ** 3 / 6 * turn_x + X * np.abs(X) * Y / 2 * turn_y
    gy = xlogy(Y * X**2 / 2 - Y**3 / 6, r) + np.abs(X) ** 3 / 6 * turn_y + Y * np.abs(Y) * X / 2 * turn_x
    return xx, yy, xy, gx, gy


def _asinh_ratio(a: FloatArray, b: FloatArray) -> FloatArray:
    """asinh(a/b), 0 where b = 0."""
    return np.arcsinh(np.divide(a, b, out=np.zeros_like(a), where=b > 0))


def _edge_pairs(target: FloatArray, load: FloatArray) -> FloatArray:
    """Differences of edges (..., 2), in the order of EDGE_PAIRS: t1 − l0, t0 − l0, t1 − l1, t0 − l1."""
    return (target[..., None, ::-1] - load[..., :, None]).reshape(*target.shape[:-1], 4)


def _rectangles(rectangles_mm: ArrayLike) -> FloatArray:
    rectangles = np.asarray(rectangles_mm, dtype=float)
    if rectangles.shape[-1:] != (4,):
        raise HalfspaceError(f"rectangles have shape {rectangles.shape}, expected (..., 4): x0, y0, x1, y1 in mm.")
    if not (rectangles[..., 2:] > rectangles[..., :2]).all():
        raise HalfspaceError("a rectangle is empty: x1 must be above x0 and y1 above y0.")
    return rectangles


def _area(rectangles: FloatArray) -> FloatArray:
    return (rectangles[..., 2] - rectangles[..., 0]) * (rectangles[..., 3] - rectangles[..., 1])
