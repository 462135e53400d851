"""A network whose answers at finite strain are refined by Bayes' rule: see `inverse.posterior`."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from decoupler.inverse.posterior import Posterior
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.decoder import Decoded
from decoupler.model.decoupler import Decoupler
from geometry.layout import FloatArray

Doubts = tuple[NDArray[np.bool_], FloatArray | None]  #: see `DecouplerAtStrain.doubts`


@dataclass(frozen=True, kw_only=True)
class DecouplerAtStrain(Decoupler):
    """A network and the posterior of a sensor at finite strain, whose start and prior its answers are."""

    posterior: Posterior

    @property
    def forward(self) -> SensorModel:
        return self.posterior.forward

    def outputs(self, columns_ohm: FloatArray) -> FloatArray:
        return self.refined(columns_ohm)[0]

    def half_widths_of(self, columns_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        deviation_n = np.sqrt(np.einsum("nii->ni", self.refined(columns_ohm)[1]))
        return deviation_n, 2.0 * deviation_n

    def decoded(self, resistance_ohm: FloatArray, weights: FloatArray, own: FloatArray | None = None) -> Decoded:
        """As of `Decoder`; what readings err by besides moves the most probable forces, too."""
        if own is None:
            return super().decoded(resistance_ohm, weights)

        def ask(by: Self, ohms: FloatArray, which: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
            return by._found(by.columns(ohms), weights, own[which])

        force_n, deviation_n, covariance = self.each(resistance_ohm, ask)
        stated = deviation_n.reshape(self._shape), covariance
        return Decoded(force_n=force_n.reshape(self._shape), stated=stated)

    def _deviations(
        self, columns: FloatArray, weights: FloatArray, own: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        return self._found(columns, weights, own)[1:]

    def _found(
        self, columns: FloatArray, weights: FloatArray, own: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Forces (n, n_out) [N], their deviations, and the covariance of sums of them by `weights`."""
        force_n, covariance = self.refined(columns, None if own is None else self._own_ohm(columns, own))
        return force_n, np.sqrt(np.einsum("nii->ni", covariance)), weights.T @ covariance @ weights

    def refined(
        self, columns_ohm: FloatArray, own_ohm: FloatArray | None = None, doubts: Doubts | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Most probable forces of resistances (n, n_in) [Ω] with deviations `own_ohm` besides, and their covariance."""
        settled, first_n = self.front.resting.settled(columns_ohm), self.first_answers(columns_ohm)
        deviation_ohm, shared_ohm = self.reading_errors(settled, self.posterior.first_states(first_n))
        read, unsure_n = self.doubts(columns_ohm) if doubts is None else doubts
        if own_ohm is not None:
            deviation_ohm = np.hypot(deviation_ohm, own_ohm)
            by_own = self.derivatives(columns_ohm) * (own_ohm * read)[:, None]  # of first answers
            unsure_n = by_own if unsure_n is None else np.concatenate([unsure_n, by_own], axis=2)
        return self.posterior.found(settled, first_n, deviation_ohm, shared_ohm, read, unsure_n)

    def doubts(self, columns_ohm: FloatArray) -> Doubts:
        """Which inputs are read, (n_in,), and what errors of others do to first answers, (n, n_out, k) [N]."""
        by_missing = None
        if self.filling is not None:
            by_missing = self.filling.by_errors(columns_ohm, self.derivatives(columns_ohm))[1]
        return self.readable & ~self._missing, by_missing
