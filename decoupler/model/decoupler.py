"""A trained network with its scaling: ohms in, newtons out. In numpy: a live sensor loads no torch."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dataset.measurement import ReadingError
from dataset.resistance import rest_resistances
from decoupler.data.columns import Columns, Component, Scaling, in_blocks, namespace, pillar_columns
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import ModelInverse, SensorModel
from decoupler.model.baseline import LeastSquares
from decoupler.model.decoder import BEYOND, STRANGE, Decoder
from decoupler.model.ensemble import Ensemble
from decoupler.model.front import Front
from decoupler.model.left_out import LeftOut
from decoupler.model.network import Network
from decoupler.model.settings import NetworkConfig
from decoupler.model.uncertainty import Uncertainty
from decoupler.model.usual import LoadTest, UsualLoads
from geometry.design import SensorDesign
from geometry.layout import FloatArray, Layout

CHUNK_SAMPLES = 512  #: samples worked on together, a thread each
DERIVATIVES = 16  #: samples whose derivatives are worked on together: they stay in the cache of a core
ALIKE = 0.01  #: relative difference of a resistance at rest below which a pillar is as designed


@dataclass(frozen=True, kw_only=True)
class Decoupler(Decoder):
    """A network as trained; never changed, only used."""

    component: Component
    form: NetworkConfig
    front: Front
    network: Network
    output_scaling: Scaling
    usual: UsualLoads  #: loads that it knows
    uncertainty: Uncertainty  #: how far its forces can be trusted
    ensemble: Ensemble  #: draws of the sensor that it was identified as; none if it was trained on one sensor
    least_squares: LeastSquares  #: the baseline to beat, fitted to the same data
    dead: NDArray[np.bool_]  #: (rows, cols, n_pillars): pillars that cannot be read and are not looked at
    layout: Layout

    @classmethod
    def of(
        cls, data: Columns, form: NetworkConfig, front: Front, network: Network, design: SensorDesign | None
    ) -> "Decoupler":
        """A network that was trained on samples, as unsure of forces as before."""
        return Decoupler(
            component=data.component,
            form=form,
            front=front,
            network=network,
            output_scaling=data.force_scaling,
            usual=UsualLoads.of(data),
            uncertainty=Uncertainty.untold(data.force_scaling.half_range, network.output, data.component),
            ensemble=Ensemble.of_none(*(data.resistance_ohm.shape[1], data.force_n.shape[1])),
            least_squares=LeastSquares.fitted(data),
            dead=data.dead,
            design=design,
            errors=data.errors,
            layout=data.layout,
        )

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces on every unit along ``component.axes``, (n, rows, cols, n_axes) [N]; Fz positive in compression.

        Takes resistances of the pillars, (n, rows, cols, n_pillars) [Ω]; those that the component does not take, and
        dead ones, may hold anything. An array of another size, or a resistance that is not finite or not above 0, is a
        `SampleError`. Readings that no strain explains are left out (`Decoder.lost`).

        Notes
        -----
        A sample gives the same bits alone and in any batch.
        """
        return self.each(resistance_ohm, lambda own, ohms, _: (own._forces(own.columns(ohms)),))[0]

    def _forces(self, columns: FloatArray) -> FloatArray:
        n = len(columns)
        outputs = np.empty((n, len(self.output_scaling.centre)))

        def fill(start: int) -> None:
            chunk = columns[start : start + CHUNK_SAMPLES]
            outputs[start : start + CHUNK_SAMPLES] = self.outputs(in_blocks(chunk))[: len(chunk)]

        if 0 < n <= CHUNK_SAMPLES:
            fill(0)  # a live scan starts no threads
        else:
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                list(pool.map(fill, range(0, n, CHUNK_SAMPLES)))
        return outputs.reshape(self._shape)

    def half_widths(self, resistance_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        one, two = self.each(resistance_ohm, lambda own, ohms, _: own.half_widths_of(own.columns(ohms)))
        return one.reshape(self._shape), two.reshape(self._shape)

    def deviations(
        self, resistance_ohm: FloatArray, weights: FloatArray, own: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """As of `Decoder.deviations`; it costs as much as `half_widths`.

        Notes
        -----
        One error of a reading, or of the sensor's model, moves all forces: Wᵀ S (G Gᵀ + D) S W with W the weights, G
        what these errors do (`error_factors`), D the variance that training left, taken to be independent from force
        to force, and S the half-widths' scale.
        """

        def ask(by: Self, ohms: FloatArray, which: Any) -> tuple[FloatArray, FloatArray]:
            return by._deviations(by.columns(ohms), weights, None if own is None else own[which])

        deviation_n, covariance = self.each(resistance_ohm, ask)
        return deviation_n.reshape(self._shape), covariance

    def _deviations(
        self, columns: FloatArray, weights: FloatArray, own: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        found = self.uncertainty
        more_n2: Any = 0.0
        if own is not None:
            slopes = [self.derivatives(columns[k : k + DERIVATIVES]) for k in range(0, len(columns), DERIVATIVES)]
            factors = np.concatenate(slopes) * (self._own_ohm(columns, own) * ~self._missing)[:, None]
            more_n2 = factors @ factors.swapaxes(1, 2)
        own_n2, (scale, two) = self.own_variance(columns)
        # drifts weighed against few heavy contacts leave errors with long tails, which a sum of all forces shows most
        wide = scale if found.drift_factor is None else np.maximum(scale, two / 2.0)
        variance, covariance = own_n2.copy(), np.zeros((len(columns), *weights.shape[1:] * 2))
        for chunk, factors in self.error_factors(columns):
            variance[chunk] += (factors**2).sum(axis=2)
            by_error = (weights[None] * wide[chunk, :, None]).swapaxes(1, 2) @ factors
            covariance[chunk] = by_error @ by_error.swapaxes(1, 2)
        covariance += np.einsum("no,oi,oj->nij", own_n2 * wide**2, weights, weights, optimize=True)
        if own is not None:
            variance += np.einsum("nii->ni", more_n2) / scale**2
            covariance += weights.T @ more_n2 @ weights
        return np.sqrt(variance) * scale, covariance

    def _own_ohm(self, columns: FloatArray, own: FloatArray) -> FloatArray:
        """Deviations (n, n_in) [Ω] of readings that err by relative ones (n, rows, cols, n_pillars) besides."""
        return columns * pillar_columns(own, self.component, self.layout, self.dead)

    @property
    def _shape(self) -> tuple[int, int, int, int]:
        return -1, self.rows, self.cols, len(self.component.axes)

    def consistency(
        self, resistance_ohm: FloatArray, force_n: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray] | None:
        """By how far forces are outside the usual loads, or readings outside theirs (`LoadTest`)."""
        if (test := self.load_test) is None:
            return None
        told_n = self.forces(resistance_ohm) if force_n is None else force_n

        def ask(by: Self, ohms: FloatArray, which: Any) -> tuple[FloatArray, FloatArray]:
            if by.is_blind:
                return np.full(len(ohms), STRANGE), np.full(len(ohms), test.limit)
            assert by.load_test is not None
            return by.load_test.tested(told_n[which].reshape(len(ohms), -1), lambda: by.columns(ohms))

        chi2, limit = self.each(resistance_ohm, ask)
        return chi2, limit

    def read_by(self, errors: ReadingError) -> Self:
        drifts = ("drift", "drift_tilt", "drift_offset_ohm")
        same = all((getattr(errors, name) > 0) == (getattr(self.errors, name) > 0) for name in drifts)
        known = self.uncertainty if same else replace(self.uncertainty, drift_factor=None)  # of other drifts
        return replace(self, errors=errors, uncertainty=known)

    @cached_property
    def load_test(self) -> LoadTest | None:
        """The test whether a usual load explains a reading; None if nobody knows rest."""
        return LoadTest.of(self)

    def half_widths_of(self, columns_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half-widths for columns of resistances, (n, n_in) [Ω] -> twice (n, n_out) [N]."""
        own_n2, (one, two) = self.own_variance(columns_ohm)
        deviation_n = np.sqrt(own_n2 + self.noise_variance(columns_ohm))
        return deviation_n * one, deviation_n * two

    def own_variance(self, columns_ohm: FloatArray) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
        """`Uncertainty.own_variance` for columns of resistances, (n, n_in) [Ω]."""
        A = self.activations(columns_ohm)
        force_n = self.output_scaling.unscale(A @ self.network.output.T)
        return self.uncertainty.own_variance(A, force_n, self.output_scaling.half_range)

    def noise_variance(self, columns_ohm: FloatArray) -> FloatArray:
        """Variance of forces (n, n_out) [N²] that errors of readings (n, n_in) [Ω] and of the sensor's model cause."""
        found = np.zeros((len(columns_ohm), len(self.output_scaling.centre)))
        for chunk, factors in self.error_factors(columns_ohm):
            found[chunk] = (factors**2).sum(axis=2)
        return found

    def reading_errors(
        self, columns_ohm: FloatArray, state_n: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Deviations (n, n_in) [Ω] of what readings err by alone, and what they err by together, (n, n_in, m) [Ω].

        That is by one deviation of each drift, then by draws of the sensor in states (n, Q) [N], by default those of
        the inverse if there is one. Also of tensors of torch.
        """
        errors, shared = self.errors, columns_ohm[:, :, None][..., :0]
        if errors.has_drift:
            shared = errors.shared(columns_ohm, self.rows, self.cols)
        if len(self.ensemble) and (forward := self.forward) is not None:
            if state_n is None and self.inverse is not None:
                state_n = self.inverse.values(columns_ohm)
            draws = [] if state_n is None else [self.ensemble.factors(forward, state_n)]
            shared = namespace(columns_ohm).concat([shared, *draws], axis=2)
        return errors.deviation(columns_ohm), shared

    def error_factors(self, columns_ohm: FloatArray) -> Iterator[tuple[slice, FloatArray]]:
        """Change of the forces by each independent error, chunk by chunk: (c, n_out, n_errors) [N].

        Errors are those of `reading_errors`, drifts as far as forces err along them. Where nothing errs there is no
        chunk.
        """
        drift_factor = self.uncertainty.drift_factor
        if self.errors.is_exact and not len(self.ensemble) and self.filling is None:
            return
        for start in range(0, len(columns_ohm), DERIVATIVES):
            chunk = slice(start, start + DERIVATIVES)
            columns = columns_ohm[chunk]
            slopes, by_missing = self.derivatives(columns), list[FloatArray]()
            if self.filling is not None:
                slopes, *by_missing = self.filling.by_errors(columns, slopes)
            own, shared = self.reading_errors(columns)
            common = [slopes @ shared] if shared.shape[2] else []
            if drift_factor is not None and self.errors.has_drift:
                common[0][..., : len(drift_factor)] = common[0][..., : len(drift_factor)] @ drift_factor
            yield chunk, np.concatenate([slopes * own[:, None], *common, *by_missing], axis=2)

    @cached_property
    def _missing(self) -> NDArray[np.bool_]:
        """Which inputs are left out, (n_in,)."""
        return (False if self.left_out is None else self.left_out.reshape(-1)[self.places]) & self.readable

    @cached_property
    def filling(self) -> LeftOut | None:
        """What stands in the places of readings that are left out; None if none is, or nobody knows them."""
        return LeftOut.of(self, self._missing)

    @property
    def inverse(self) -> ModelInverse | None:
        """The response turned around, where that is the feature."""
        return self.front.feature if isinstance(self.front.feature, ModelInverse) else None

    @property
    def forward(self) -> SensorModel | None:
        """The response that it knows; None if none."""
        return None if self.inverse is None else self.inverse.forward

    @property
    def is_identified(self) -> bool:
        """It knows gain and offset of one sensor's pillars, from measured pairs or from training data of that sensor.

        Training fits them too, and of a sensor as designed finds 1 and 0 but for noise: that is no knowledge of one.
        """
        if "identified_on" in self.made_from:
            return True
        if self.inverse is None or self.design is None:
            return False
        designed = np.tile(rest_resistances(self.design)[self.pillars], self.rows * self.cols)
        return bool(np.abs(self.inverse.forward.at_rest_ohm() / designed - 1.0).max() > ALIKE)

    @cached_property
    def pillars(self) -> list[int]:
        """Numbers of the pillars of a unit whose resistances it takes."""
        return self.component.pillars(self.layout)

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Places of its inputs in one sample's (rows, cols, n_pillars) resistances laid flat, (n_in,)."""
        return np.arange(self.dead.size).reshape(self.dead.shape)[..., self.pillars].reshape(-1)

    @cached_property
    def readable(self) -> NDArray[np.bool_]:
        """Which inputs can be read, (n_in,); the others have `DEAD_OHM` in their place."""
        return ~self.dead[..., self.pillars].reshape(-1)

    @cached_property
    def usual_ohm(self) -> FloatArray | None:
        """Those of the mean load of training, else at rest."""
        ohms = self.rest_resistances()
        if self.usual.log_ohm is not None:
            ohms = np.ones(self.dead.shape) if ohms is None else ohms.copy()
            ohms.reshape(-1)[self.places] = np.exp(self.usual.log_ohm)
        return ohms

    @cached_property
    def _reach(self) -> tuple[FloatArray, FloatArray]:
        """Where no design says how far readings go, twice as far as in training, too."""
        low, high = super()._reach
        if self.design is None and self.inverse is None:
            ends = self.front.scaling.centre + np.outer([-1.0, 1.0], self.front.scaling.half_range)
            least, most = self.front.feature.resistances(ends)
            low.flat[self.places] = np.minimum(low.flat[self.places], least / BEYOND)
            high.flat[self.places] = np.maximum(high.flat[self.places], BEYOND * most)
        return low, high

    @property
    def usual_readings(self) -> tuple[FloatArray, FloatArray] | None:
        return self.usual.readings(self.places, self.dead.size)

    def rest_resistances(self) -> FloatArray | None:
        if self.design is None:
            stated = self.made_from.get("rest_ohm")  # of samples without a load
            return None if stated is None else np.reshape(stated, self.dead.shape).astype(np.float64)
        rest_ohm = np.tile(rest_resistances(self.design), (self.rows, self.cols, 1))
        if self.forward is not None:
            rest_ohm[..., self.pillars] = self.forward.at_rest_ohm().reshape(self.rows, self.cols, -1)
        return rest_ohm

    def untrusted(self) -> list[tuple[int, int, str]]:
        """Forces (row, col, name) that dead pillars leave unsure; empty if all can be trusted or nothing is known."""
        limit_n = None
        if self.inverse is not None and self.dead.any():
            errors, shape = self.errors.without_drifts(), (self.rows, self.cols)
            limit_n = cramer_rao(self.inverse.forward, self.inverse.centre_n[None], errors, shape)[0]
        lost = self.uncertainty.untrusted(self.output_scaling.half_range, limit_n)
        places = np.argwhere(lost.reshape(self.rows, self.cols, -1))
        return [(int(row), int(col), self.component.forces[axis]) for row, col, axis in places]

    def columns(self, resistance_ohm: FloatArray) -> FloatArray:
        """The resistances that are taken, (n, n_in) [Ω], with what is left out filled in."""
        columns = self.taken(resistance_ohm)
        return columns if self.filling is None else self.filling.filled(columns)

    def outputs(self, columns_ohm: FloatArray) -> FloatArray:
        """Forces of resistances, (n, n_in) [Ω] -> (n, n_out) [N]."""
        return self.first_answers(columns_ohm)

    def first_answers(self, columns_ohm: FloatArray) -> FloatArray:
        """Forces by the network alone, (n, n_in) [Ω] -> (n, n_out) [N]; also of tensors of torch."""
        return self.output_scaling.unscale(self.network.outputs(self.front.inputs(columns_ohm)))

    def activations(self, columns_ohm: FloatArray) -> FloatArray:
        """Inputs of the last layer for resistances (n, n_in) [Ω], (n, n_activations)."""
        return self.network.activations(self.front.inputs(columns_ohm))

    def derivatives(self, columns_ohm: FloatArray) -> FloatArray:
        """Derivatives of the forces by the resistances, (n, n_in) [Ω] -> (n, n_out, n_in) [N/Ω]."""
        by_ohm, slopes = self.front.derivatives(columns_ohm), self.network.slopes(self.front.inputs(columns_ohm))
        return self.output_scaling.half_range[:, None] * (slopes @ by_ohm)
