"""The elastic half-space in closed form: point forces, uniform tractions on rectangles, means over rectangles.

No mesh and no system to solve, so that it checks the finite elements, and gives a first response of an array in
milliseconds. The sensor is a clamped layer, not a half-space: `fem.array.layer` corrects for that.

The surface is the plane z = 0, z points up and the body lies below it; a force or traction with z < 0 pushes down.
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
from geometry.storage.files import digest

#: the books' z points into the body, ours up: u_z and f_z change sign, which is [i, j] → flip[i] flip[j]
FLIP = np.outer([1.0, 1.0, -1.0], [1.0, 1.0, -1.0])

#: + and − of the corners of a rectangle, and of pairs of edges of two rectangles, in an integral between them
CORNERS = np.array([1.0, -1.0])
EDGE_PAIRS = np.array([1.0, -1.0, -1.0, 1.0])


class HalfspaceError(TriPillarError, ValueError):
    """A place where the half-space has no displacement, or a rectangle without an area."""


def point_compliance(offset_mm: ArrayLike, material: Material) -> FloatArray:
    """Displacement per newton on a point of the surface: Boussinesq's and Cerruti's solutions.

    Parameters
    ----------
    offset_mm : array, shape (..., 3)
        Where, from the point of the force [mm]; z is 0 at the surface and negative in the body.
    material : Material
        Of the half-space.

    Returns
    -------
    array, shape (..., 3, 3)
        Displacement along the first axis per force along the second [mm/N].

    Raises
    ------
    HalfspaceError
        At the point of the force, where displacement is infinite, and above the surface.

    Notes
    -----
    With d = −z the depth, r the distance, G the shear modulus and w = u·4πG, down being positive (Johnson, *Contact
    Mechanics*, eq. 3.18 for the normal force P, section 3.6 for the tangential force Q along x; Q along y likewise):

        P:  w_x = x d/r³ − (1−2ν) x/(r(r+d)),  w_d = d²/r³ + 2(1−ν)/r
        Q:  w_x = 1/r + x²/r³ + (1−2ν) [1/(r+d) − x²/(r(r+d)²)],
            w_y = x y/r³ − (1−2ν) x y/(r(r+d)²),  w_d = x d/r³ + (1−2ν) x/(r(r+d))

    Examples
    --------
    A force of 1 N down sinks the surface 5 mm away by (1−ν)/(2πG r) and draws it near:

    >>> u = point_compliance([5.0, 0.0, 0.0], Material(young_mpa=6.1, poisson=0.49)) @ [0.0, 0.0, -1.0]
    >>> print(u.round(5))
    [-0.00016  0.      -0.00793]
    """
    x, y, depth = _below_surface(offset_mm)
    if not (x**2 + y**2 + depth**2 > 0).all():
        raise HalfspaceError(
            "an offset is 0 or no number: displacement is infinite at a point force; "
            "spread the force over a rectangle with patch_compliance."
        )
    return _compliance(_point_kernels(x, y, depth), material)


def patch_compliance(points_mm: ArrayLike, rectangle_mm: ArrayLike, material: Material) -> FloatArray:
    """Displacement per newton spread evenly over a rectangle of the surface, at any point of the half-space.

    Parameters
    ----------
    points_mm : array, shape (..., 3)
        Where [mm]; z is 0 at the surface and negative in the body. Edges and corners of the rectangle are no exception:
        the displacement is finite and continuous everywhere.
    rectangle_mm : array, shape (..., 4)
        x0, y0, x1, y1 of the load [mm]; leading dimensions broadcast with those of the points.
    material : Material
        Of the half-space.

    Returns
    -------
    array, shape (..., 3, 3)
        Displacement along the first axis per force along the second [mm/N]; times the area [mm²] it is the displacement
        per traction [mm/MPa].

    Raises
    ------
    HalfspaceError
        Above the surface, or if a rectangle is empty.

    Notes
    -----
    The solutions of `point_compliance` are integrated over the rectangle in closed form. An antiderivative F with
    ∂²F/∂X∂Y = kernel, taken at the four corners with alternating signs, is the integral; on the surface those of Love
    (*Phil. Trans. R. Soc. A* 228, 1929) and their tangential twins. Far away they cancel: the relative error grows as
    1e-16 · distance² / area.

    Examples
    --------
    1 MPa down on a square of side a = 2 sinks its centre by 8 ln(1+√2) (1−ν)/(2πG), 1.122 (1−ν²) a/E:

    >>> area_mm2 = 4.0
    >>> per_newton = patch_compliance([0.0, 0.0, 0.0], [-1.0, -1.0, 1.0, 1.0], Material(young_mpa=1.0, poisson=0.0))
    >>> print((area_mm2 * per_newton @ [0.0, 0.0, -1.0]).round(4) + 0.0)
    [ 0.      0.     -2.2444]
    """
    points = np.asarray(points_mm, dtype=float)
    load = _rectangles(rectangle_mm)
    x, y, depth = _below_surface(points)
    X = np.stack([x - load[..., 0], x - load[..., 2]], axis=-1)[..., :, None]
    Y = np.stack([y - load[..., 1], y - load[..., 3]], axis=-1)[..., None, :]
    corners = _patch_kernels(*np.broadcast_arrays(X, Y, depth[..., None, None]))
    total = np.einsum("k...ab,a,b->k...", corners, CORNERS, CORNERS)
    return _compliance(total / _area(load), material)


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
    Exact: the kernels are integrated four times, ∂⁴H/∂X²∂Y² = kernel, and H is summed with signs over the 16
    differences between edges. Far away the sum cancels: the relative error grows as 1e-16 · distance⁴ / (both areas),
    2e-11 for a 12 mm pad and a 2 mm electrode 100 mm apart, 2e-7 at 1 m.
    """
    target, load = np.broadcast_arrays(_rectangles(targets_mm), _rectangles(loads_mm))
    X = _edge_pairs(target[..., 0::2], load[..., 0::2])[..., :, None]
    Y = _edge_pairs(target[..., 1::2], load[..., 1::2])[..., None, :]
    total = np.einsum("k...ab,a,b->k...", _mean_kernels(*np.broadcast_arrays(X, Y)), EDGE_PAIRS, EDGE_PAIRS)
    return _compliance(total / (_area(target) * _area(load)), material)


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
        Name of the body, for the recipe.
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
        mesh_hash="",
        seconds={"closed form": perf_counter() - start},
        recipe=digest(method, 1, replace(design, resistivity_ohm_mm=1.0)),
    )


def _compliance(kernels: FloatArray, material: Material) -> FloatArray:
    """Compliance (..., 3, 3) from the kernels (12, ...): the one place where z turns from down to up."""
    one, xx, yy, xy, xz, yz, zz, gx, gy, hxx, hyy, hxy = kernels
    nu, (_, G) = material.poisson, material.lame_mpa
    m = 1 - 2 * nu
    down = [
        [one + xx + m * hxx, xy + m * hxy, xz - m * gx],
        [xy + m * hxy, one + yy + m * hyy, yz - m * gy],
        [xz + m * gx, yz + m * gy, zz + 2 * (1 - nu) * one],
    ]
    return FLIP * np.moveaxis(np.array(down), (0, 1), (-2, -1)) / (4 * np.pi * G)


def _point_kernels(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Kernels at depth z, shape (12, ...): 1/r, the xx, yy, xy, xz, yz and zz of x x/r³, and derivatives of logarithms.

    These are the x and y of ∇ ln(r+z), then ∂x(x/(r+z)), ∂y(y/(r+z)) and ∂y(x/(r+z)).
    """
    r = np.sqrt(x**2 + y**2 + z**2)
    s = r + z
    second = [x * x / r**3, y * y / r**3, x * y / r**3, x * z / r**3, y * z / r**3, z * z / r**3]
    first = [x / (r * s), y / (r * s)]
    return np.array(
        [1 / r, *second, *first, 1 / s - x * x / (r * s**2), 1 / s - y * y / (r * s**2), -x * y / (r * s**2)]
    )


def _patch_kernels(X: FloatArray, Y: FloatArray, z: FloatArray) -> FloatArray:
    """F with ∂²F/∂X∂Y = each of `_point_kernels`, up to functions of X or of Y alone; shape (12, ...).

    Logarithms are written asinh(Y/√(X²+z²)) for ln(Y + r): no cancellation where Y < 0. Where one is infinite, its
    factor is zero and so is the product.
    """
    r = np.sqrt(X**2 + Y**2 + z**2)
    log_y = _asinh_ratio(Y, np.hypot(X, z))
    log_x = _asinh_ratio(X, np.hypot(Y, z))
    solid = z * np.arctan2(X * Y, z * r)
    # atan(Y/X) − atan(Y z/(X r)) in one, and its twin; r − z without cancellation
    gap = np.divide(X**2 + Y**2, r + z, out=np.zeros_like(r), where=r > 0)
    turn_y = np.arctan2(Y * gap * np.abs(X), X**2 * r + Y**2 * z) * np.sign(X)
    turn_x = np.arctan2(X * gap * np.abs(Y), Y**2 * r + X**2 * z) * np.sign(Y)
    xx, yy = Y * log_x - solid, X * log_y - solid
    return np.array([
        X * log_y + Y * log_x - solid, xx, yy, -r, -z * log_y, -z * log_x, solid,
        xlogy(Y, r + z) + z * log_y + X * turn_y,
        xlogy(X, r + z) + z * log_x + Y * turn_x,
        X * log_y - z * turn_y, Y * log_x - z * turn_x, r - xlogy(z, r + z),
    ])  # fmt: skip


def _mean_kernels(X: FloatArray, Y: FloatArray) -> FloatArray:
    """H with ∂⁴H/∂X²∂Y² = each of `_point_kernels` at z = 0, up to what the sum over edges cancels; shape (12, ...)."""
    r = np.hypot(X, Y)
    log_y, log_x = _asinh_ratio(Y, np.abs(X)), _asinh_ratio(X, np.abs(Y))
    xx = X * Y**2 / 2 * log_x + X**2 * r / 2 - r**3 / 3
    yy = Y * X**2 / 2 * log_y + Y**2 * r / 2 - r**3 / 3
    xy = -(X * Y * r / 3 + X**3 / 6 * log_y + Y**3 / 6 * log_x)
    turn_y, turn_x = np.arctan2(Y, np.abs(X)), np.arctan2(X, np.abs(Y))
    gx = xlogy(X * Y**2 / 2 - X**3 / 6, r) + np.abs(Y) ** 3 / 6 * turn_x + X * np.abs(X) * Y / 2 * turn_y
    gy = xlogy(Y * X**2 / 2 - Y**3 / 6, r) + np.abs(X) ** 3 / 6 * turn_y + Y * np.abs(Y) * X / 2 * turn_x
    none = np.zeros_like(r)
    return np.array([xx + yy, xx, yy, xy, none, none, none, gx, gy, yy, xx, -xy])  # 1/r − x²/r³ = y²/r³


def _asinh_ratio(a: FloatArray, b: FloatArray) -> FloatArray:
    """asinh(a/b), 0 where b = 0."""
    return np.arcsinh(np.divide(a, b, out=np.zeros_like(a), where=b > 0))


def _edge_pairs(target: FloatArray, load: FloatArray) -> FloatArray:
    """Differences of edges (..., 2), in the order of EDGE_PAIRS: t1 − l0, t0 − l0, t1 − l1, t0 − l1."""
    return (target[..., None, ::-1] - load[..., :, None]).reshape(*target.shape[:-1], 4)


def _below_surface(points_mm: ArrayLike) -> FloatArray:
    """x, y and depth of points (..., 3), shape (3, ...)."""
    points = np.asarray(points_mm, dtype=float)
    if points.shape[-1:] != (3,):
        raise HalfspaceError(f"points have shape {points.shape}, expected (..., 3): x, y and z in mm.")
    if not (points[..., 2] <= 0).all():
        raise HalfspaceError(
            f"a point at z={np.max(points[..., 2]):g} lies above the surface z = 0: measure z up from the surface."
        )
    x, y, z = np.moveaxis(points, -1, 0)
    return np.array([x, y, np.abs(z)])


def _rectangles(rectangles_mm: ArrayLike) -> FloatArray:
    rectangles = np.asarray(rectangles_mm, dtype=float)
    if rectangles.shape[-1:] != (4,):
        raise HalfspaceError(f"rectangles have shape {rectangles.shape}, expected (..., 4): x0, y0, x1, y1 in mm.")
    if not (rectangles[..., 2:] > rectangles[..., :2]).all():
        raise HalfspaceError("a rectangle is empty: x1 must be above x0 and y1 above y0.")
    return rectangles


def _area(rectangles: FloatArray) -> FloatArray:
    return (rectangles[..., 2] - rectangles[..., 0]) * (rectangles[..., 3] - rectangles[..., 1])
