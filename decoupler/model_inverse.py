"""Forces that a known response gives for resistances, nearly: the input feature `inverse`.

A fixed number of chord steps costs little and always ends; what it leaves, the network learns. `limits.py` has the
inverse iterated to the end.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from dataset import LabelledData
from decoupler.components import Component, force_columns, pillar_columns, readable_columns
from decoupler.errors import SampleError
from decoupler.forward_model import ForwardModel
from decoupler.rowwise import rowwise
from decoupler.settings import Feature, Net
from fem.response import ArrayResponse
from geometry.layout import FloatArray

#: share of the lengths' variance, below which a response is held to be of another sensor: with pads a quarter smaller
#: it explains 0.87 and the chord steps run away, a sixth smaller 0.96 and they do not; a noise of 3 % leaves 0.85
LEAST_EXPLAINED = 0.9
STEPS = 3  #: a step more halves the error of bells and divides that of independent loads by four


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelInverse:
    """A forward model with its linear inverse about some forces."""

    forward: ForwardModel
    centre_n: FloatArray  #: (n_forces,)
    centre_mm: FloatArray  #: (n_pillars,): lengths there
    chord: FloatArray  #: (n_pillars, n_forces) [N/mm]: inverse of the lengths' derivatives at the centre, transposed

    @classmethod
    def about(cls, forward: ForwardModel, force_n: FloatArray, readable: np.ndarray, noise: float = 0.0) -> Self:
        """The inverse about the mean of training forces, shape (n, n_forces) [N].

        `readable` (n_pillars,) says which pillars can be read; the others get no weight. With fewer pillars than
        forces the chord is the linear estimate of least mean square under the forces' own covariance.
        """
        centre = force_n.mean(axis=0)
        lengths, J = forward.jacobian(centre[None])
        J = J[0][readable]
        chord = np.zeros((forward.n_pillars, forward.n_forces))
        if readable.all() and forward.n_pillars == forward.n_forces:
            chord[:] = np.linalg.inv(J).T
        else:
            covariance = np.cov(force_n.T, bias=True).reshape(forward.n_forces, -1)
            spread = J @ covariance @ J.T
            floor = max(noise / 2.0, 1e-4) * lengths[0][readable]
            chord[readable] = np.linalg.solve(spread + np.diag(floor**2), J @ covariance)
        return cls(forward=forward, centre_n=centre, centre_mm=lengths[0], chord=chord)

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces after a linear estimate and `STEPS` chord steps, (n, n_pillars) [Ω] -> (n, n_forces) [N]."""
        lengths = self.forward.lengths_of(resistance_ohm)
        forces = rowwise(lengths - self.centre_mm, self.chord)
        forces += self.centre_n
        for _ in range(STEPS):
            forces += rowwise(lengths - self.forward.lengths(forces), self.chord)
        return forces

    def derivatives(self, resistance_ohm: FloatArray) -> FloatArray:
        """Derivatives of `forces` by the resistances, (n, n_pillars) [Ω] -> (n, n_forces, n_pillars) [N/Ω]."""
        lengths = self.forward.lengths_of(resistance_ohm)
        forces = rowwise(lengths - self.centre_mm, self.chord) + self.centre_n
        by_length = np.broadcast_to(self.chord, (len(lengths), *self.chord.shape))  # (n, n_pillars, n_forces)
        for _ in range(STEPS):
            modelled, J = self.forward.jacobian(forces)
            by_length = by_length + self.chord - (by_length @ J.swapaxes(1, 2)) @ self.chord
            forces = forces + rowwise(lengths - modelled, self.chord)
        return (by_length * (0.5 * lengths / resistance_ohm)[:, :, None]).swapaxes(1, 2)


def explaining(
    response: ArrayResponse | None,
    component: Component,
    columns_ohm: FloatArray,
    force_n: FloatArray,
    readable: np.ndarray,
) -> ForwardModel:
    """The forward model of a response, if it explains the lengths of training samples up to a pillar's own gain.

    Raises
    ------
    SampleError
        If there is no response, or it is of an array of another size or explains too little: other loads act than the
        component's own, or the sensor is another.
    """
    if response is None:
        raise SampleError("the feature 'inverse' needs the array's response, and none is known: use 'root'.")
    forward = ForwardModel.of(response, component)
    if (forward.n_pillars, forward.n_forces) != (columns_ohm.shape[1], force_n.shape[1]):
        raise SampleError(
            f"the response is of {forward.n_pillars} pillars, the samples of {columns_ohm.shape[1]}: "
            "give the response of this array, or use the feature 'root'."
        )
    share = _explained(forward.lengths_of(columns_ohm)[:, readable], forward.lengths(force_n)[:, readable])
    if share < LEAST_EXPLAINED:
        raise SampleError(
            f"the response explains {max(share, 0.0):.0%} of the resistances' variance, too little to start from: "
            "use the feature 'root', or the component that holds all loads ('all')."
        )
    return forward


def suited_feature(data: LabelledData, component: Component, net: Net, response: ArrayResponse | None) -> Feature:
    """`inverse` for a skip net if the response explains the data, else `root`."""
    if net != "skip" or response is None:
        return "root"
    columns = pillar_columns(data.resistance_ohm, component, data.dead)
    forces = force_columns(data.force_n, component)
    try:
        explaining(response, component, columns, forces, readable_columns(component, data.dead, columns.shape[1]))
    except SampleError:
        return "root"
    return "inverse"


def _explained(measured: FloatArray, modelled: FloatArray) -> float:
    """Share of the variance of all columns together that a line per column through `modelled` explains."""
    measured, modelled = measured - measured.mean(axis=0), modelled - modelled.mean(axis=0)
    both, own = (measured * modelled).sum(axis=0), (modelled**2).sum(axis=0)
    total = (measured**2).sum()
    explained = np.divide(both * np.abs(both), own, out=np.zeros_like(own), where=own > 0).sum()
    return float(explained / total) if total > 0 else 1.0
