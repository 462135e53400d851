"""An elastic layer bonded to a rigid base: the sensor's slab without its sides, solved in Fourier space.

The compliance of the surface is in closed form for every wavenumber. What it adds to the half-space's is smooth, so
that it is inverted once into four functions of distance and averaged over rectangles by a few Gauss points; the rest
is `fem.array.halfspace`, exact. No mesh: an independent check of the finite elements, which also see the sides.

As there, z points up, the surface is at z = 0 and the base at z = −height.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.special import j0, j1

from fem.array.halfspace import FLIP, HalfspaceError, mean_compliance, response_by_translation
from fem.array.response import ArrayResponse
from geometry.design import Material, SensorDesign
from geometry.layout import FloatArray

REACH = 30.0  #: heights beyond which nothing is felt: the slowest share of a response falls as exp(−0.74 r/h)
WAVES = 20.0  #: wavenumbers · height beyond which the base is not felt, to exp(−40)
GAUSS_ERROR = 1e-9  #: of the means over rectangles, relative to the half-space's
WIDEST = 100.0  #: heights, of a rectangle's side: more takes many Gauss points, and no sensor is like that
POINTS = 400_000  #: Gauss points at a time, which bounds the memory to some 100 MB


def layer_spectrum(q: ArrayLike, poisson: float) -> FloatArray:
    """Difference that a rigid base makes to a half-space's surface compliance, at wavenumber k, height h and q = k h.

    Parameters
    ----------
    q : array, shape (...)
        Above 0.
    poisson : float
        ν, from 0 to below 0.5.

    Returns
    -------
    array, shape (4, ...)
        Differences δ of G k times the compliance, layer minus half-space, free of cancellation and of overflow:
        transverse, longitudinal, normal, and cross (longitudinal by a normal traction, 90° ahead).

    Notes
    -----
    Per traction of wavenumber k, z into the body, e = exp(−2q), κ = 3 − 4ν, D = κ(1+e²) + (4q²+1+κ²)e:

        transverse    G k C = (1−e)/(1+e)                                       half-space: 1
        longitudinal  G k C = (1−ν) [κ(1−e²) + 4q e]/D                          1−ν
        normal        G k C = (1−ν) [κ(1−e²) − 4q e]/D                          1−ν
        cross         G k C = [(1−2ν) κ (1−e)²/2 − 2q² e]/D                     (1−2ν)/2

    from Navier's equation for each wave with u = 0 at the base; tests/fem/test_layer.py solves it by another way.
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
    """Mean displacement of rectangles of a layer's surface per newton spread evenly over others.

    Parameters
    ----------
    targets_mm, loads_mm : arrays, shapes (..., 4)
        x0, y0, x1, y1 [mm]; leading dimensions broadcast. They may overlap, touch or coincide.
    height_mm : float
        Of the layer, infinite along x and y.
    material : Material
        Of the layer.

    Returns
    -------
    array, shape (..., 3, 3)
        Mean displacement along the first axis per force along the second [mm/N]; to 1e-8 of what a half-space would
        answer at that distance.

    Raises
    ------
    HalfspaceError
        If a rectangle is empty or wider than 100 heights, or the height is not above 0.

    Notes
    -----
    The half-space's closed form plus the mean of the smooth rest over both rectangles. Gauss points are as many as the
    nearest singularity of the rest asks for, 2·height away like a mirror image below the base.

    Examples
    --------
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
    felt = np.hypot(*gap.T) < REACH
    x, wx = _differences(target[felt, :, 0], load[felt, :, 0])
    y, wy = _differences(target[felt, :, 1], load[felt, :, 1])
    at_once = max(1, POINTS // (len(wx) * len(wy)))
    rest = np.zeros((int(felt.sum()), 3, 3))
    for first in range(0, len(rest), at_once):
        some = slice(first, first + at_once)
        points = _rest(x[some, :, None], y[some, None, :], material.poisson)
        rest[some] = np.einsum("ijnab,a,b->nij", points, wx, wy)
    _, G = material.lame_mpa
    flat = np.zeros((len(felt), 3, 3))  # what is not felt is 0, not the rounding of two large numbers
    flat[felt] = compliance.reshape(-1, 3, 3)[felt] + rest / (2 * np.pi * G * height_mm)
    return flat.reshape(compliance.shape)


def decay_length_mm(height_mm: float, poisson: float) -> float:
    """Distance over which what a load does to a layer's surface falls by e, far from the load.

    Parameters
    ----------
    height_mm : float
        Of the layer.
    poisson : float
        ν, from 0 to below 0.5.

    Returns
    -------
    float
        λ [mm]: displacements fall as exp(−r/λ)/√r; 1.35 heights as ν → 0.5.

    Notes
    -----
    Far away counts the pole of the spectrum that is nearest the real axis: D = 0 at q = i x, x the root of
    2κ cos 2x = 4x² − 1 − κ², and λ = h/x. As ν → 0.5, κ → 1 it is that of cos x = x. What twists the surface about the
    load (the transverse part) falls faster, with x = π/2.

    Examples
    --------
    >>> round(decay_length_mm(10.0, 0.49), 2)
    13.37
    """
    kappa = 3 - 4 * poisson
    x = brentq(lambda x: 2 * kappa * np.cos(2 * x) - 4 * x**2 + 1 + kappa**2, 0.0, np.pi / 2)
    return float(height_mm / x)


def layer_response(design: SensorDesign) -> ArrayResponse:
    """Response of a sensor taken as an infinite layer of its matrix material on a rigid base.

    Parameters
    ----------
    design : SensorDesign
        Its pillars must be of the matrix's rubber for the answer to mean much: they are not seen.

    Returns
    -------
    ArrayResponse
        As `fem.array.halfspace.halfspace_response`: no mesh, a read-only view of a table of offsets.

    Notes
    -----
    Of the homogeneous sensor it ignores the free sides only. Against finite elements that err by 0.8 %, the paper's
    6 × 6 array differs by 0.7 % for a centre unit under its own pad and 0.6 % under its neighbour's, 2 % and 2 to 7 %
    one ring further out, and 40 to 60 % on the rim: for units at the edge it is no answer.
    """
    height_mm, material = design.unit.height_mm, design.matrix_material
    return response_by_translation(
        design, "layer", lambda targets, loads: layer_mean_compliance(targets, loads, height_mm, material)
    )


def _differences(target: FloatArray, load: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Differences (n_pairs, n) of Gauss points of intervals (n_pairs, 2) on an axis, and their weights (n,), sum 1."""
    (t, wt), (s, ws) = (_gauss(float(np.max(side[:, 1] - side[:, 0], initial=1e-3))) for side in (target, load))
    at, of = (
        side.mean(axis=1, keepdims=True) + (side[:, 1:] - side[:, :1]) / 2 * nodes
        for side, nodes in ((target, t), (load, s))
    )
    return (at[:, :, None] - of[:, None, :]).reshape(len(target), len(t) * len(s)), np.outer(wt, ws).ravel()


def _gauss(size: float) -> tuple[FloatArray, FloatArray]:
    """Gauss rule on −1..1 for an interval of `size` heights; n points err by ρ^(−2n) on Bernstein's ellipse ρ."""
    if not size <= WIDEST:
        raise HalfspaceError(f"a rectangle is {size:.3g} heights wide, at most {WIDEST:g} are allowed: split it.")
    t = 4 / size  # the singularity 2 heights away, in half-intervals
    n = 1 + int(np.ceil(-np.log(GAUSS_ERROR) / (2 * np.arcsinh(t))))
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return nodes, weights / 2


def _rest(x: FloatArray, y: FloatArray, poisson: float) -> FloatArray:
    """Layer minus half-space, 2πG·height times displacement per newton, shape (3, 3, ...); x and y in heights."""
    r = np.hypot(x, y)
    isotropic, shear, cross, normal = np.moveaxis(_radial(poisson)(np.minimum(r, REACH)), -1, 0)
    far = r > REACH  # the layer is still: take the half-space away
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
def _radial(poisson: float) -> CubicSpline:
    """Four functions of r/h: isotropic and deviatoric (over r²) of the tangential block, cross (over r), normal.

    Hankel transforms ∫ Jₙ(q r) δ(q) dq: (δ_l + δ_t)/2 with J0, (δ_l − δ_t)/2 with J2, δ_c with J1, δ_n with J0.
    """
    edges = np.concatenate([[0.0], np.geomspace(0.05, 1.0, 5), np.linspace(1.0, WAVES, 58)[1:]])
    nodes, weights = np.polynomial.legendre.leggauss(16)
    half = np.diff(edges)[:, None] / 2
    q = (edges[:-1, None] + half * (1 + nodes)).ravel()
    dq = (half * weights).ravel()
    transverse, longitudinal, normal, cross = layer_spectrum(q, poisson) * dq
    r = np.linspace(0.0, REACH, 601)
    qr = np.outer(np.maximum(r, 1e-4), q)
    J0, J1 = j0(qr), j1(qr)
    J1_over = J1 / qr
    J2_over = np.where(qr > 0.01, (2 * J1_over - J0) / qr**2, 1 / 8 - qr**2 / 96)  # the difference cancels near 0
    values = [
        J0 @ (longitudinal + transverse) / 2,
        (J2_over @ ((longitudinal - transverse) * q**2)) / 2,
        J1_over @ (cross * q),
        J0 @ normal,
    ]
    return CubicSpline(r, np.stack(values, axis=1))
