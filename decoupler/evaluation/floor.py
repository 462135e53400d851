"""The PCA floor: what no plain network of a given width can pass, however it is trained."""

from dataclasses import dataclass

import numpy as np

from decoupler.data.components import Component, force_columns
from decoupler.data.scaling import Scaling
from decoupler.evaluation.metrics import ForceErrors, force_errors
from geometry.layout import FloatArray


@dataclass(frozen=True, kw_only=True)
class PcaFloor:
    """Smallest errors of a plain network of one width on given forces."""

    hidden: int
    scaled_mse: float  #: bound on the mean squared error of the outputs scaled to [-1, 1]
    variance_share: float  #: the same as a share of the scaled variance
    rmse_n: float  #: bound on the root mean squared error of all outputs together [N]
    projection: dict[str, ForceErrors]  #: errors of the best projection in newtons: typical, no bounds


def pca_floor(force_n: FloatArray, component: Component, hidden: int) -> PcaFloor:
    """Floor of a plain network with `hidden` nodes for forces of shape (n_samples, rows, cols, 3) [N].

    Notes
    -----
    The outputs W₂ tanh(...) + b of a plain network lie in a plane of `hidden` dimensions. By Eckart and Young
    the mean squared distance of the forces to any such plane is at least the energy of their discarded
    principal components. The bounds hold on these very forces, scaled by their own range; eq. 17 has no such
    bound. A skip net has none at all.
    """
    columns = force_columns(force_n, component)
    scaled = Scaling.fitted(columns).scale(columns)
    discarded, total = _discarded_energy(scaled, hidden)
    best = _projection(columns, hidden)
    shape = (*force_n.shape[:3], len(component.axes))
    return PcaFloor(
        hidden=hidden,
        scaled_mse=discarded,
        variance_share=discarded / total if total > 0 else 0.0,
        rmse_n=float(np.sqrt(_discarded_energy(columns, hidden)[0])),
        projection={
            name: force_errors(best.reshape(shape)[..., axis], columns.reshape(shape)[..., axis])
            for axis, name in enumerate(component.forces)
        },
    )


def _discarded_energy(columns: FloatArray, kept: int) -> tuple[float, float]:
    """Mean square per entry beyond the first `kept` principal components, and of all of them."""
    energy = np.linalg.svd(columns - columns.mean(axis=0), compute_uv=False) ** 2 / columns.size
    return float(energy[kept:].sum()), float(energy.sum())


def _projection(columns: FloatArray, kept: int) -> FloatArray:
    """The nearest points in the plane of the first `kept` principal components."""
    mean = columns.mean(axis=0)
    directions = np.linalg.svd(columns - mean, full_matrices=False)[2][:kept]
    return (columns - mean) @ directions.T @ directions + mean
