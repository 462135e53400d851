"""Net force, net moment and centre of pressure of an array, with their deviations.

All are in the frame of the touched surface: its origin is the middle of the array on that surface, x runs along the
columns, y along the rows, z out of the sensor.
"""

from dataclasses import dataclass, replace

import numpy as np

from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray, unit_centres

MIN_NORMAL_N = 1.0  #: smallest net normal force with a centre of pressure
MIN_DEVIATIONS = 3.0  #: smallest number of its deviations
SIGNS = (1.0, 1.0, -1.0)  #: of forces along x, y, z as reported: times these they are a vector on the sensor
NEEDED = ({"x"}, {"y"}, {"z"}, {"z"}, {"z"}, {"x", "y"})  #: components that Fx, Fy, Fz, Mx, My, Mz are made of


def pad_positions(design: SensorDesign, of_units: bool = False) -> FloatArray:
    """Centre of every pad, or unit, in the frame of the touched surface, (rows, cols, 3) [mm]; z is 0.

    >>> pad_positions(SensorDesign())[0, 5].tolist()
    [37.5, -37.5, 0.0]
    """
    offset_mm = [0.0, 0.0] if of_units else [design.pad.offset_x_mm, design.pad.offset_y_mm]
    places = np.pad(unit_centres(design) + offset_mm, ((0, 0), (0, 1)))
    return places.reshape(design.array.rows, design.array.cols, 3)


def on_all_axes(force_n: FloatArray, axes: tuple[str, ...], unknown: float = np.nan) -> FloatArray:
    """Forces (..., k) along some axes as (..., 3) along x, y, z; what is `unknown` along the others.

    >>> on_all_axes(np.array([2.0]), ("z",)).tolist()
    [nan, nan, 2.0]
    """
    found = np.full((*force_n.shape[:-1], len(AXES)), unknown)
    found[..., [AXES.index(axis) for axis in axes]] = force_n
    return found


#: of moments (∫ x p, ∫ y p) of a unit's pressure p about its place and of its torque about z, in Fx, Fy, Fz, Mx, My, Mz
OF_MOMENTS = np.eye(6)[[4, 3, 5]] * [[1.0], [-1.0], [1.0]]


def wrench_weights(position_mm: FloatArray, axes: tuple[str, ...], moments: int = 0) -> FloatArray:
    """Weights of the loads in the net force and moment, (rows·cols·k, 6); NaN in columns that need other axes.

    Positions (rows, cols, 3) are those of the pads; NaN leaves the moment unknown. Axes are the components of each
    force, as a model gives them; two moments of its pressure may follow, or these and its torque, and k counts them.

    Columns are Fx, Fy, Fz as reported (Fz positive in compression) [N] and M = Σ r × f [N mm], with f the vector on the
    sensor, (Fx, Fy, -Fz).

    >>> wrench_weights(np.array([[[10.0, 0.0, 0.0]]]), ("z",)).tolist()
    [[nan, nan, 1.0, 0.0, 10.0, nan]]
    """
    points = position_mm.reshape(-1, 1, 3)
    force = np.broadcast_to(np.eye(3), (len(points), 3, 3))  # (unit, component, sum)
    weights = np.concatenate([force, np.cross(points, np.diag(SIGNS))], axis=2)[:, [AXES.index(axis) for axis in axes]]
    weights[..., [not needed <= set(axes) for needed in NEEDED]] = np.nan
    if moments:
        of_moments = np.broadcast_to(OF_MOMENTS[:moments], (len(points), moments, 6))
        weights = np.concatenate([weights, of_moments], axis=1)
    return weights.reshape(-1, 6) + 0.0  # no -0


#: values of a wrench as recordings and streams name them: the field of `Wrench`, and the unit
NET = {
    "net_force_n": ("force_n", "N"),
    "net_force_deviation_n": ("force_deviation_n", "N"),
    "net_moment_nmm": ("moment_nmm", "N mm"),
    "net_moment_deviation_nmm": ("moment_deviation_nmm", "N mm"),
    "centre_of_pressure_mm": ("centre_mm", "mm"),
    "centre_of_pressure_deviation_mm": ("centre_deviation_mm", "mm"),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Wrench:
    """Net load on the array in each of n scans, or in one, without the axis n.

    Values that need axes which the model does not give are NaN. Deviations are standard deviations, which hold 68 % of
    the errors; they are None if the model knows none.

    The centre of pressure is where the normal forces of all pads act together, Σ r Fz / Σ Fz. There is none, NaN, while
    ΣFz is below `MIN_NORMAL_N` or below `MIN_DEVIATIONS` of its deviations: it would be noise over noise.
    """

    force_n: FloatArray  #: (n, 3): Fx, Fy, Fz summed over the pads, Fz positive in compression
    moment_nmm: FloatArray  #: (n, 3): of the vectors on the sensor, about the middle of the array on its surface
    centre_mm: FloatArray  #: (n, 2): centre of pressure, x and y
    force_deviation_n: FloatArray | None = None  #: (n, 3)
    moment_deviation_nmm: FloatArray | None = None  #: (n, 3)
    centre_deviation_mm: FloatArray | None = None  #: (n, 2)

    @property
    def vector_n(self) -> FloatArray:
        """The net force as a vector on the sensor, (n, 3) [N]: z out of the sensor, below 0 in compression."""
        return self.force_n * SIGNS


def net_wrench(load: FloatArray, weights: FloatArray, covariance: FloatArray | None = None) -> Wrench:
    """Net load of loads (n, rows, cols, k) [N, N mm], or of one scan's, by `wrench_weights` (rows·cols·k, 6).

    The covariance of the six sums, (n, 6, 6) or (1, 6, 6), is as `Decoupler.deviations` gives it.

    Examples
    --------
    >>> corners = np.array([[[-10.0, -5.0, 0.0], [10.0, -5.0, 0.0]], [[-10.0, 5.0, 0.0], [10.0, 5.0, 0.0]]])
    >>> pressed = np.array([[[[0.0, 0.0, 3.0], [0.0, 0.0, 1.0]], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]]])
    >>> found = net_wrench(pressed, wrench_weights(corners, ("x", "y", "z")))
    >>> found.force_n[0].tolist(), found.moment_nmm[0].tolist(), found.centre_mm[0].tolist()
    ([0.0, 0.0, 4.0], [20.0, -20.0, 0.0], [-5.0, -5.0])
    """
    sums = load.reshape(*load.shape[:-3], -1) @ weights
    variance = 0.0 * sums + (0.0 if covariance is None else np.diagonal(covariance, axis1=-2, axis2=-1))
    deviation = np.sqrt(np.maximum(variance, 0.0))
    is_pressed = sums[..., 2] >= np.maximum(MIN_NORMAL_N, MIN_DEVIATIONS * deviation[..., 2])
    normal = np.where(is_pressed, sums[..., 2], np.nan)
    centre = np.stack([sums[..., 4], -sums[..., 3]], axis=-1) / normal[..., None]
    found = Wrench(force_n=sums[..., :3], moment_nmm=sums[..., 3:], centre_mm=centre)
    if covariance is None:
        return found
    by_moment = np.array([1.0, -1.0]) * covariance[..., [4, 3], 2]  # covariance of r Fz with Fz
    centre_variance = variance[..., [4, 3]] - 2.0 * centre * by_moment + centre**2 * variance[..., 2:3]
    return replace(
        found,
        force_deviation_n=deviation[..., :3],
        moment_deviation_nmm=deviation[..., 3:],
        centre_deviation_mm=np.sqrt(np.maximum(centre_variance, 0.0)) / normal[..., None],
    )
