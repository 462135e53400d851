"""Responses in closed form: an elastic half-space, and a layer on a rigid base, the sensor's slab without its sides.

No mesh and no system to solve: mean displacements of rectangles of the surface under loads on others, in milliseconds.
The half-space's are exact integrals (Boussinesq, Cerruti). The layer's compliance is in closed form for every
wavenumber; what it adds to the half-space's is smooth, so that it is inverted once into four functions of distance and
averaged over rectangles by a few Gauss points. It is an independent check of the finite elements, which also see the
sides. z points up and the surface is at z = 0; a force with z < 0 pushes down.
"""

from dataclasses import replace
from functools import lru_cache
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_banded

from common.errors import TriPillarError
from fem.array.response import ArrayResponse
from geometry.design import Array, Material, SensorDesign
from geometry.layout import FloatArray, electrode_squares, pad_squares

#: the books' z points into the body, ours up: u_z and f_z change sign, which is [i, j] → flip[i] flip[j]
FLIP = np.outer([1.0, 1.0, -1.0], [1.0, 1.0, -1.0])

EDGE_PAIRS = np.array([1.0, -1.0, -1.0, 1.0])  #: signs of pairs of edges of two rectangles in an integral between them


class HalfspaceError(TriPillarError, ValueError):
    """A rectangle without an area, or one that the closed form cannot take."""


def mean_compliance(targets_mm: ArrayLike, loads_mm: ArrayLike, material: Material) -> FloatArray:
    """Mean displacement of rectangles of a half-space's surface per newton spread evenly over others.

    Rectangles (..., 4) are x0, y0, x1, y1 [mm]; leading dimensions broadcast, and they may overlap, touch or coincide.
    Returns (..., 3, 3): along the first axis per force along the second [mm/N]. An empty rectangle is a
    `HalfspaceError`.

    On the surface, with r the distance, G the shear modulus and w = u·4πG, down positive (Johnson, *Contact Mechanics*,
    eq. 3.18 for the normal force P, section 3.6 for the tangential force Q along x; Q along y likewise):

        P:  w_x = −(1−2ν) x/r²,  w_d = 2(1−ν)/r
        Q:  w_x = 1/r + x²/r³ + (1−2ν) y²/r³,  w_y = 2ν x y/r³,  w_d = (1−2ν) x/r²

    These kernels are integrated four times, ∂⁴H/∂X²∂Y² = kernel, and H is summed with signs over the 16 differences
    between edges: exact. Far away the sum cancels: the relative error grows as 1e-16 · distance⁴ / (both areas),
    2e-11 for a 12 mm pad and a 2 mm electrode 100 mm apart, 2e-7 at 1 m.
    """
    target, load = np.broadcast_arrays(_rectangles(targets_mm), _rectangles(loads_mm))
    areas = (target[..., 2:] - target[..., :2]).prod(axis=-1) * (load[..., 2:] - load[..., :2]).prod(axis=-1)
    X = _edge_pairs(target[..., 0::2], load[..., 0::2])[..., :, None]
    Y = _edge_pairs(target[..., 1::2], load[..., 1::2])[..., None, :]
    xx, yy, xy, gx, gy = (
        np.einsum("...ab,a,b->...", kernel, EDGE_PAIRS, EDGE_PAIRS) / areas
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
    log_r = np.log(np.where(r > 0, r, 1.0))
    gx = (X * Y**2 / 2 - X**3 / 6) * log_r + np.abs(Y) ** 3 / 6 * turn_x + X * np.abs(X) * Y / 2 * turn_y
    gy = (Y * X**2 / 2 - Y**3 / 6) * log_r + np.abs(X) ** 3 / 6 * turn_y + Y * np.abs(Y) * X / 2 * turn_x
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


MAX_DISTANCE = 30.0  #: heights beyond which nothing is felt: the slowest share of a response falls as exp(−0.74 r/h)
MAX_WAVENUMBER = 20.0  #: wavenumbers · height beyond which the base is not felt, to exp(−40)
GAUSS_ERROR = 1e-9  #: of the means over rectangles, relative to the half-space's
MAX_WIDTH = 100.0  #: heights, of a rectangle's side: more takes many Gauss points, and no sensor is like that
STEP = 0.05  #: heights between the points of the functions of distance
POINTS = 400_000  #: Gauss points at a time, which bounds the memory to some 100 MB


def layer_spectrum(q: ArrayLike, poisson: float) -> FloatArray:
    """Difference that a rigid base makes to a half-space's surface compliance at wavenumber k, height h, q = k h > 0.

    Differences of G k times the compliance (4, ...), layer minus half-space, free of cancellation and of overflow:
    transverse, longitudinal, normal, and cross (longitudinal by a normal traction, 90° ahead). Poisson's ratio ν is
    from 0 to below 0.5.

    Per traction of wavenumber k, z into the body, e = exp(−2q), κ = 3 − 4ν, D = κ(1+e²) + (4q²+1+κ²)e:

        transverse    G k C = (1−e)/(1+e)                                       half-space: 1
        longitudinal  G k C = (1−ν) [κ(1−e²) + 4q e]/D                          1−ν
        normal        G k C = (1−ν) [κ(1−e²) − 4q e]/D                          1−ν
        cross         G k C = [(1−2ν) κ (1−e)²/2 − 2q² e]/D                     (1−2ν)/2

    from Navier's equation for each wave with u = 0 at the base; tests/fem/test_closed_forms.py solves it another way.
    """
    q, nu = np.asarray(q, dtype=float), poisson
    e, kappa, m = np.exp(-2 * q), 3 - 4 * nu, 1 - 2 * nu
    D = kappa * (1 + e**2) + (4 * q**2 + 1 + kappa**2) * e
    common = 2 * kappa * e + 4 * q**2 + 1 + kappa**2
    return np.array([
        -2 * e / (1 + e),
        -(1 - nu) * e * (common - 4 * q) / D,
        -(1 - nu) * e * (common + 4 * q) / D,
        -e * (2 * q**2 + m / 2 * ((1 + kappa) ** 2 + 4 * q**2)) / D,
    ])  # fmt: skip


def layer_mean_compliance(
    targets_mm: ArrayLike, loads_mm: ArrayLike, height_mm: float, material: Material
) -> FloatArray:
    """The same as `mean_compliance` on a layer of a height, endless along x and y.

    To 1e-8 of what a half-space would answer at that distance: its closed form plus the mean of the smooth rest over
    both rectangles. Gauss points are as many as the nearest singularity of the rest asks for, 2·height away like a
    mirror image below the base. A rectangle wider than 100 heights or a height not above 0 is a `HalfspaceError`, too.

    1 MPa over 400 × 400 mm of a layer of 10 mm sinks the middle as in confined compression, by h/(λ + 2μ):

    >>> wide, middle = [-200.0, -200.0, 200.0, 200.0], [-1.0, -1.0, 1.0, 1.0]
    >>> material = Material(young_mpa=6.1, poisson=0.3)
    >>> lame, mu = material.lame_mpa
    >>> sunk = 400.0**2 * layer_mean_compliance(middle, wide, 10.0, material)[2, 2]
    >>> print(round(float(sunk * (lame + 2 * mu) / 10.0), 6))
    1.0
    """
    if not height_mm > 0:
        raise HalfspaceError(f"height_mm={height_mm:g} must be above 0: the layer's thickness.")
    compliance = mean_compliance(targets_mm, loads_mm, material)
    pairs = np.broadcast_arrays(np.asarray(targets_mm, dtype=float), np.asarray(loads_mm, dtype=float))
    target, load = (side.reshape(-1, 2, 2) / height_mm for side in pairs)  # (n_pairs, low or high, x or y) in heights
    gap = np.maximum(target[:, 0] - load[:, 1], load[:, 0] - target[:, 1]).clip(min=0.0)
    felt = np.hypot(*gap.T) < MAX_DISTANCE
    x, wx = _differences(target[felt, :, 0], load[felt, :, 0])
    y, wy = _differences(target[felt, :, 1], load[felt, :, 1])
    chunk = max(1, POINTS // (len(wx) * len(wy)))
    rest = np.zeros((int(felt.sum()), 3, 3))
    for first in range(0, len(rest), chunk):
        some = slice(first, first + chunk)
        points = _rest(x[some, :, None], y[some, None, :], material.poisson)
        rest[some] = np.einsum("ijnab,a,b->nij", points, wx, wy)
    _, G = material.lame_mpa
    flat = np.zeros((len(felt), 3, 3))  # what is not felt is 0, not the rounding of two large numbers
    flat[felt] = compliance.reshape(-1, 3, 3)[felt] + rest / (2 * np.pi * G * height_mm)
    return flat.reshape(compliance.shape)


def influence_range(design: SensorDesign, share: float) -> int:
    """Pitches beyond which a pad moves a pad of the endless layer by less than a share of what it moves itself."""
    half, steps = design.pad.size_mm / 2, np.arange(64) * design.array.pitch_mm
    targets = np.stack([steps - half, np.full(64, -half), steps + half, np.full(64, half)], axis=1)
    loads = np.broadcast_to([-half, -half, half, half], (64, 4))
    moved = layer_mean_compliance(targets, loads, design.unit.height_mm, design.matrix_material)
    size = np.linalg.norm(moved, axis=(1, 2))
    return int(np.flatnonzero(size >= share * size[0])[-1]) + 1


def layer_response(design: SensorDesign) -> ArrayResponse:
    """Response of a sensor taken as an infinite layer of its matrix material on a rigid base.

    Pillars of another rubber are not seen, nor the free sides: what a pad of the paper's 6 × 6 array does to its own
    unit differs from finite elements by 0.2 to 0.3 % in the middle, 1 to 4 % one ring further out, and 19 to 61 % on
    the rim, where it is no answer. The influence is a read-only view of a table with one entry per offset between
    units, kilobytes for 48 × 48; ``np.array`` copies.
    """
    start = perf_counter()
    rows, cols, pitch_mm = design.array.rows, design.array.cols, design.array.pitch_mm
    single = replace(design, array=Array(rows=1, cols=1, pitch_mm=pitch_mm))
    pad, electrodes = pad_squares(single)[0], electrode_squares(single)
    table = np.empty((2 * rows - 1, 2 * cols - 1, len(electrodes), 3, 3))
    x = np.arange(1 - cols, cols)[:, None, None] * pitch_mm
    for number, steps in enumerate(range(1 - rows, rows)):  # a row at a time bounds the memory
        shift = np.concatenate([x, np.full_like(x, steps * pitch_mm)] * 2, axis=-1)
        table[number] = layer_mean_compliance(electrodes + shift, pad, design.unit.height_mm, design.matrix_material)
    # influence[i, j, e, a, k, l, b] = table[i − k + rows − 1, j − l + cols − 1, e, a, b]: windows, one for each k, l
    windows = np.lib.stride_tricks.sliding_window_view(table, (rows, cols), axis=(0, 1))  # k reversed, l, e, a, b, i, j
    return ArrayResponse(
        design=design,
        influence_mm_per_n=windows[::-1, ::-1].transpose(5, 6, 2, 3, 0, 1, 4),
        residual=0.0,
        unknowns=0,
        seconds={"closed form": perf_counter() - start},
        method="layer",
    )


def _differences(target: FloatArray, load: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Differences (n_pairs, n) of Gauss points of intervals (n_pairs, 2) on an axis, and their weights (n,), sum 1.

    Of intervals of one size many differences are the same: they count once.
    """
    (half_t, t, wt), (half_s, s, ws) = (
        (half := np.diff(side) / 2, *_gauss(float(np.max(2 * half, initial=1e-3)))) for side in (target, load)
    )
    middle, weights = (target.mean(axis=1) - load.mean(axis=1))[:, None], np.outer(wt, ws).ravel()
    if np.allclose(half_t, half_s[:1], rtol=1e-9, atol=0) and np.allclose(half_s, half_s[:1], rtol=1e-9, atol=0):
        steps, which = np.unique(np.subtract.outer(t, s).round(12), return_inverse=True)
        return middle + half_s * steps, np.bincount(which.ravel(), weights).astype(np.float64)
    return middle + (half_t[..., None] * t[:, None] - half_s[..., None] * s).reshape(len(middle), -1), weights


def _gauss(size: float) -> tuple[FloatArray, FloatArray]:
    """Gauss rule on −1..1 for an interval of `size` heights; n points err by ρ^(−2n) on Bernstein's ellipse ρ."""
    if not size <= MAX_WIDTH:
        raise HalfspaceError(f"a rectangle is {size:.3g} heights wide, at most {MAX_WIDTH:g} are allowed: split it.")
    t = 4 / size  # the singularity 2 heights away, in half-intervals
    n = 1 + int(np.ceil(-np.log(GAUSS_ERROR) / (2 * np.arcsinh(t))))
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return nodes, weights / 2


def _rest(x: FloatArray, y: FloatArray, poisson: float) -> FloatArray:
    """Layer minus half-space, 2πG·height times displacement per newton, shape (3, 3, ...); x and y in heights."""
    r = np.hypot(x, y)
    isotropic, shear, cross, normal = _splined(np.minimum(r, MAX_DISTANCE), _radial(poisson))
    far = r > MAX_DISTANCE  # the layer is still: take the half-space away
    if far.any():
        R = r[far]
        isotropic[far], normal[far] = (poisson / 2 - 1) / R, (poisson - 1) / R
        shear[far], cross[far] = poisson / 2 / R**3, (poisson - 0.5) / R**2
    down = np.array([
        [isotropic - (x**2 - y**2) * shear, -2 * x * y * shear, -x * cross],
        [-2 * x * y * shear, isotropic + (x**2 - y**2) * shear, -y * cross],
        [x * cross, y * cross, normal],
    ])  # fmt: skip
    return FLIP.reshape(3, 3, *[1] * r.ndim) * down


@lru_cache(maxsize=16)
def _radial(poisson: float) -> FloatArray:
    """Four functions of r/h for `_splined`: coefficients of a cubic spline at steps of `STEP`, (4 powers, 4, n).

    Isotropic and deviatoric (over r²) of the tangential block, cross (over r), normal. Hankel transforms
    ∫ Jₙ(q r) δ(q) dq: (δ_l + δ_t)/2 with J0, (δ_l − δ_t)/2 with J2, δ_c with J1, δ_n with J0.
    """
    from scipy.special import j0, j1

    edges = np.concatenate([[0.0], np.geomspace(0.05, 1.0, 5), np.linspace(1.0, MAX_WAVENUMBER, 58)[1:]])
    nodes, weights = np.polynomial.legendre.leggauss(16)
    half = np.diff(edges)[:, None] / 2
    q = (edges[:-1, None] + half * (1 + nodes)).ravel()
    dq = (half * weights).ravel()
    transverse, longitudinal, normal, cross = layer_spectrum(q, poisson) * dq
    r = np.linspace(0.0, MAX_DISTANCE, 1 + round(MAX_DISTANCE / STEP))
    qr = np.outer(np.maximum(r, 1e-4), q)
    J0, J1 = j0(qr), j1(qr)
    J1_over = J1 / qr
    J2_over = np.where(qr > 0.01, (2 * J1_over - J0) / qr**2, 1 / 8 - qr**2 / 96)  # the difference cancels near 0
    values = np.stack([
        J0 @ (longitudinal + transverse) / 2,
        (J2_over @ ((longitudinal - transverse) * q**2)) / 2,
        J1_over @ (cross * q),
        J0 @ normal,
    ])  # fmt: skip
    bands = np.ones((3, len(r) - 2))
    bands[1, 1:-1], bands[1, [0, -1]], bands[0, 1], bands[2, -2] = 4.0, 6.0, 0.0, 0.0  # not-a-knot: linear at the ends
    inner = solve_banded((1, 1), bands, 6 / STEP**2 * np.diff(values, 2).T).T
    ends = 2 * inner[:, [0, -1]] - inner[:, [1, -2]]
    bends = np.concatenate([ends[:, :1], inner, ends[:, 1:]], axis=1) * STEP**2 / 6
    low, up = bends[:, :-1], bends[:, 1:]
    return np.stack([values[:, :-1], np.diff(values) - 2 * low - up, 3 * low, up - low])


def _splined(r: FloatArray, powers: FloatArray) -> FloatArray:
    """Cubic splines (k, ...) at r by coefficients (4, k, n) of the powers of what r is over its step of `STEP`."""
    steps = r / STEP
    low = np.minimum(steps.astype(np.int32), powers.shape[2] - 1)
    over = steps - low
    found = powers[3].take(low, axis=1)
    for each in powers[2::-1]:
        found *= over
        found += each.take(low, axis=1)
    return found
