"""Errors of decoupled forces: the paper's relative error (eq. 17), in newtons, and in % of full scale.

`pca_floor` gives the least errors that a plain network of a given width can reach, however it is trained.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from common.errors import require_type
from common.threads import one_blas_thread
from dataset import Samples
from dataset.samples import ENOUGH, AnySamples, SampleError, require_samples
from decoupler.data.columns import Component, Scaling, force_columns
from decoupler.model.decoupler import Decoupler
from geometry.layout import FloatArray

BOUNDED_AWAY = 1e-3  #: eq. 17 is given only if every |F| is above this share of full scale


@dataclass(frozen=True, kw_only=True)
class ForceErrors:
    """Errors of one force component over all samples and units."""

    rel_err: float | None  #: eq. 17 as a fraction; None where a force is too near 0 for it to mean anything
    rmse_n: float  #: root mean squared error [N]
    full_scale_pct: float | None  #: the same in % of full scale, the largest |F| in the data; None if it is 0


def force_errors(predicted_n: FloatArray, actual_n: FloatArray) -> ForceErrors:
    """Errors of predicted forces of one component; both arrays of the same shape, whatever it is.

    Notes
    -----
    Eq. 17 of Song et al., Micromachines 2018, 9(5), 236: mean of |F' − F| / |F|. It explodes as F nears 0, so
    it is given only if the smallest |F| is above 1e-3 of the largest.

    Examples
    --------
    >>> force_errors(np.array([99.0, 202.0]), np.array([100.0, 200.0])).rel_err
    0.01
    """
    return _errors([_sums(predicted_n, actual_n)])


def _sums(predicted_n: FloatArray, actual_n: FloatArray) -> tuple[float, ...]:
    """Of a block of forces: their number, sums of squared and of relative errors, smallest and largest |F|."""
    if predicted_n.shape != actual_n.shape or not actual_n.size:
        raise SampleError(
            f"predicted_n has shape {predicted_n.shape}, actual_n {actual_n.shape}: give both alike, with samples."
        )
    error, size = np.abs(predicted_n - actual_n), np.abs(actual_n)
    with np.errstate(all="ignore"):  # of forces near 0 the relative errors are not given
        return error.size, np.sum(error**2), np.sum(error / size), size.min(), size.max()


def _errors(blocks: Iterable[tuple[float, ...]]) -> ForceErrors:
    """Errors over all blocks, of `_sums`."""
    n, squares, ratios, smallest, largest = zip(*blocks, strict=True)
    rmse_n, full_n = float(np.sqrt(sum(squares) / sum(n))), float(max(largest))
    return ForceErrors(
        rel_err=float(sum(ratios) / sum(n)) if min(smallest) > BOUNDED_AWAY * full_n else None,
        rmse_n=rmse_n,
        full_scale_pct=100.0 * rmse_n / full_n if full_n > 0 else None,
    )


def component_errors(predicted_n: FloatArray, data: Samples, component: Component) -> dict[str, ForceErrors]:
    """Errors of every force of a component; `predicted_n` has shape (n_samples, rows, cols, n_axes)."""
    return errors_over([data], lambda _: predicted_n, component)


def errors_over(
    blocks: Iterable[Samples], forces: Callable[[FloatArray], FloatArray], component: Component
) -> dict[str, ForceErrors]:
    """Errors over blocks of samples of what gives forces (n, rows, cols, n_axes) [N] for resistances [Ω]."""
    sums = []
    for data in blocks:
        predicted_n = forces(data.resistance_ohm)
        actual_n = force_columns(data.force_n, component).reshape(*data.force_n.shape[:3], -1)
        sums.append([_sums(predicted_n[..., axis], actual_n[..., axis]) for axis in range(len(component.axes))])
    return {name: _errors(own) for name, own in zip(component.forces, zip(*sums, strict=True), strict=True)}


@one_blas_thread()  # `forces` has a thread a core of its own
def evaluate(decoupler: Decoupler, data: AnySamples) -> dict[str, ForceErrors]:
    """Errors of a model on data, of every force it gives; of more than `ENOUGH` samples block by block.

    An argument of another type is an `ArgumentError`, data of another array are a `SampleError`.
    """
    require_type("decoupler", decoupler, Decoupler, "train one, or read a model file")
    require_samples("data", data, AnySamples)
    return errors_over(data.blocks(ENOUGH), decoupler.forces, decoupler.component)


class PcaFloor(NamedTuple):
    """Smallest errors of a plain network of one width on given forces."""

    scaled_mse: float  #: bound on the mean squared error of the outputs scaled to [-1, 1]
    projection: dict[str, ForceErrors]  #: errors of the best projection in newtons: typical, no bounds


def pca_floor(force_n: FloatArray, component: Component, hidden: int) -> PcaFloor:
    """Floor of a plain network with `hidden` nodes for forces of shape (n_samples, rows, cols, 3) [N].

    Notes
    -----
    The outputs W₂ tanh(...) + b of a plain network lie in a plane of `hidden` dimensions. By Eckart and Young the mean
    squared distance of these very forces, scaled by their own range, to any such plane is at least the energy of their
    discarded principal components.
    """
    columns = force_columns(force_n, component)
    scaled = Scaling.fitted(columns).scale(columns)
    best, n_axes = _projection(columns, hidden), len(component.axes)
    return PcaFloor(
        scaled_mse=float(((scaled - _projection(scaled, hidden)) ** 2).mean()),
        projection={
            name: force_errors(best[:, axis::n_axes], columns[:, axis::n_axes])
            for axis, name in enumerate(component.forces)
        },
    )


def _projection(columns: FloatArray, kept: int) -> FloatArray:
    """The nearest points in the plane of the first `kept` principal components."""
    mean = columns.mean(axis=0)
    directions = np.linalg.svd(columns - mean, full_matrices=False)[2][:kept]
    return (columns - mean) @ directions.T @ directions + mean
