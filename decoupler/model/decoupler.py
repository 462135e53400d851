"""A trained network with its scaling: ohms in, newtons out. In numpy: a live sensor loads no torch."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from dataset.imperfections import PAPERS
from dataset.measurement import ReadingError
from dataset.resistance import rest_resistances
from dataset.samples import SampleError
from decoupler.data.columns import (
    DEAD_OHM,
    Columns,
    Component,
    Resting,
    Scaling,
    in_blocks,
    namespace,
    pillar_columns,
    readable_columns,
    rowwise,
)
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.posterior import Found, Posterior
from decoupler.inverse.sensor_model import MIN_WHOLE_OHM, ModelInverse
from decoupler.model.baseline import LeastSquares
from decoupler.model.decoder import MANY, Decoder
from decoupler.model.ensemble import Ensemble
from decoupler.model.settings import NetworkConfig
from decoupler.model.uncertainty import Uncertainty
from decoupler.model.usual import Foretold, LoadTest, UsualLoads
from decoupler.solve import descended
from geometry.design import SensorDesign
from geometry.layout import FloatArray, Layout

CHUNK = 512  #: samples worked on together, a thread each
DERIVATIVES = 16  #: samples whose derivatives are worked on together: they stay in the cache of a core
MIN_DEVIATION_N = 1e-3  #: that a force is trusted to by the test of loads
MOST = 0.5  #: change of the logarithm of a reading that is filled in, by one of them
REFINED = 6  #: steps by the response towards readings that are left out; two are usual
GAINED = 1e-2  #: fall of what is minimised, below which a scan has ended
DRAWN = 200  #: loads by which those are trusted
DIFFERENCE = 1e-4  #: of the logarithm of a reading, for slopes
MIN_NOISE = 1e-5  #: relative, of readings by which those are found
ALIKE = 0.01  #: relative difference of a resistance at rest below which a pillar is as designed


@dataclass(frozen=True, kw_only=True)
class Decoupler(Decoder):
    """A network as trained; never changed, only used."""

    component: Component
    rows: int
    cols: int
    network: NetworkConfig
    input_scaling: Scaling
    output_scaling: Scaling
    hidden_weights: FloatArray  #: (n_hidden, n_in + 1), bias last
    output_weights: FloatArray  #: (n_out, n_hidden + n_in + 1); without skip (n_out, n_hidden + 1); bias last
    design: SensorDesign | None  #: the sensor of the training data; None if they did not say
    layout: Layout = PAPERS  #: the design's, if it is known
    inverse: ModelInverse | None = None  #: the response turned around; with the feature `inverse`
    posterior: Posterior | None = None  #: of a sensor at finite strain: the network's answer is its start and prior
    resting: Resting | None = None  #: readings at rest; None without a converter
    dead: np.ndarray | None = None  #: (rows, cols, n_pillars): pillars that cannot be read and are not looked at
    uncertainty: Uncertainty | None = None  #: how far its forces can be trusted
    usual: UsualLoads | None = None  #: loads that it knows; None in files of before
    ensemble: Ensemble | None = None  #: draws of the sensor that it was identified as; None if trained on one sensor
    least_squares: LeastSquares | None = None  #: the baseline to beat, fitted to the same data
    left_out: NDArray[np.bool_] | None = None  #: (rows, cols, n_pillars): that say nothing; see `Decoder.without`
    made_from: dict[str, Any] = field(default_factory=dict)  #: cache key, data hash, settings, how training ended

    def __post_init__(self) -> None:
        if self.design is not None:
            object.__setattr__(self, "layout", self.design.unit.layout)

    @classmethod
    def untrained(
        cls, data: Columns, network: NetworkConfig, design: SensorDesign | None, inverse: ModelInverse | None = None
    ) -> Self:
        """A decoupler with scaling and features for samples like these; a hidden layer of no nodes, outputs its inputs.

        Its weights are for the inputs of the inverse, where there is one; else they have no shape yet.
        """
        output_scaling = Scaling.fitted(data.force_n)
        if inverse is not None:
            n_in, input_scaling = data.force_n.shape[1], output_scaling
            resting = Resting.read_with(inverse.forward.at_rest_ohm(), data.errors.bits)
        else:
            n_in, resting = data.resistance_ohm.shape[1], None
            root = network.feature == "root"
            input_scaling = Scaling.fitted(np.sqrt(data.resistance_ohm) if root else data.resistance_ohm)
        return cls(
            component=data.component,
            rows=data.shape[0],
            cols=data.shape[1],
            network=network,
            input_scaling=input_scaling,
            output_scaling=output_scaling,
            hidden_weights=np.empty((0, n_in + 1)),
            output_weights=np.eye(data.force_n.shape[1], n_in + 1),
            design=design,
            layout=data.layout,
            inverse=inverse,
            resting=resting,
            dead=data.dead if data.dead is not None and data.dead.any() else None,
            usual=UsualLoads.of(data),
        )

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces on every unit along ``component.axes``, (n, rows, cols, n_axes) [N]; Fz positive in compression.

        Takes resistances of the pillars, (n, rows, cols, n_pillars) [Ω]; those that the component does not take, and
        dead ones, may hold anything. An array of another size, or a resistance that is not finite or not above 0, is a
        `SampleError`. Readings that no strain explains are left out (`Decoder.lost`).

        Notes
        -----
        output = linear(input) + W₂ tanh(W₁ input) with skip, constant + W₂ tanh(W₁ input) without. At finite strain
        that is the first answer, which the posterior refines. A sample gives the same bits alone and in any batch.
        """
        resistance_ohm = np.asarray(resistance_ohm, dtype=np.float64)
        return self.each(resistance_ohm, lambda own, ohms, _: (own._forces(own.columns(ohms)),))[0]

    def _forces(self, columns: FloatArray) -> FloatArray:
        n = len(columns)
        outputs = np.empty((n, len(self.output_weights)))

        def fill(start: int) -> None:
            chunk = columns[start : start + CHUNK]
            outputs[start : start + CHUNK] = self.outputs(in_blocks(chunk))[: len(chunk)]

        if 0 < n <= CHUNK:
            fill(0)  # a live scan starts no threads
        else:
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                list(pool.map(fill, range(0, n, CHUNK)))
        return outputs.reshape(self._shape)

    def half_widths(self, resistance_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % and 95 % of the errors of `forces`, of the same shape [N].

        A model that was written without its uncertainty is a `SampleError`, too.
        """
        resistance_ohm = np.asarray(resistance_ohm, dtype=np.float64)
        one, two = self.each(resistance_ohm, lambda own, ohms, _: own.half_widths_of(own.columns(ohms)))
        return one.reshape(self._shape), two.reshape(self._shape)

    def deviations(
        self, resistance_ohm: FloatArray, weights: FloatArray, own: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % of the errors of `forces` [N], and the covariance (n, m, m) of m sums of forces.

        `weights` (rows·cols·n_axes, m) are those of the forces in each sum. `own` are relative deviations that each
        reading has besides, of the shape of the resistances. It costs as much as `half_widths`.

        Notes
        -----
        One error of a reading, or of the sensor's model, moves all forces: Wᵀ S (G Gᵀ + D) S W with W the weights, G
        what these errors do (`_error_factors`), D the variance that training left, taken to be independent from force
        to force, and S the half-widths' scale.
        """
        resistance_ohm = np.asarray(resistance_ohm, dtype=np.float64)

        def ask(by: Self, ohms: FloatArray, which: Any) -> tuple[FloatArray, FloatArray]:
            return by._deviations(by.columns(ohms), weights, None if own is None else own[which])

        deviation_n, covariance = self.each(resistance_ohm, ask)
        return deviation_n.reshape(self._shape), covariance

    def _deviations(
        self, columns: FloatArray, weights: FloatArray, own: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        found = self._known
        more_n2: Any = 0.0
        own_ohm = None
        if own is not None:
            own_ohm = columns * pillar_columns(own, self.component, self.layout, self.dead)
        if self.posterior is not None:
            covariance = self.refined(columns, own_ohm).covariance_n2
            return np.sqrt(np.einsum("nii->ni", covariance)), weights.T @ covariance @ weights
        if own_ohm is not None:
            slopes = [self.by_read(columns[k : k + DERIVATIVES]) for k in range(0, len(columns), DERIVATIVES)]
            factors = np.concatenate(slopes) * own_ohm[:, None]
            more_n2 = factors @ factors.swapaxes(1, 2)
        own_n2, (scale, two) = self._own_variance(columns)
        # drifts weighed against few heavy contacts leave errors with long tails, which a sum of all forces shows most
        wide = scale if found.drift_factor is None else np.maximum(scale, two / 2.0)
        variance, covariance = own_n2.copy(), np.zeros((len(columns), *weights.shape[1:] * 2))
        for chunk, factors in self._error_factors(columns, found.errors, found.drift_factor):
            variance[chunk] += (factors**2).sum(axis=2)
            by_error = (weights[None] * wide[chunk, :, None]).swapaxes(1, 2) @ factors
            covariance[chunk] = by_error @ by_error.swapaxes(1, 2)
        covariance += np.einsum("no,oi,oj->nij", own_n2 * wide**2, weights, weights, optimize=True)
        if own is not None:
            variance += np.einsum("nii->ni", more_n2) / scale**2
            covariance += weights.T @ more_n2 @ weights
        return np.sqrt(variance) * scale, covariance

    @property
    def _known(self) -> Uncertainty:
        if self.uncertainty is None:
            raise SampleError("this model knows no uncertainty: train it again.")
        return self.uncertainty

    @property
    def _shape(self) -> tuple[int, int, int, int]:
        """Of forces, of as many samples as there are."""
        return -1, self.rows, self.cols, len(self.component.axes)

    def consistency(
        self, resistance_ohm: FloatArray, force_n: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray] | None:
        """By how far forces are outside the usual loads (`LoadTest`)."""
        if self.load_test is None:
            return None
        told_n = self.forces(resistance_ohm) if force_n is None else force_n

        def ask(by: Self, _: FloatArray, which: Any) -> tuple[FloatArray, FloatArray]:
            assert by.load_test is not None
            found = by.load_test.chi2(told_n[which].reshape(len(which), -1))
            return found, np.full_like(found, by.load_test.limit)

        chi2, limit = self.each(resistance_ohm, ask)
        return chi2, limit

    @cached_property
    def load_test(self) -> LoadTest | None:
        """The test whether a usual load explains a reading; None if loads, deviations or rest are unknown."""
        if self.usual is None or self.uncertainty is None or (self.inverse is None and self.design is None):
            return None
        if self.inverse is None:
            rest_ohm = self.rest_resistances()
            assert rest_ohm is not None
            rest = self.columns(rest_ohm[None])
        else:
            centre = self.output_scaling.centre
            rest, pressed = self.inverse.forward.resistances(np.stack([np.zeros_like(centre), centre]))[:, None]
        errors = self.uncertainty.errors
        by_error = self.derivatives(rest)[0] @ np.hstack(
            [np.diag(errors.deviation(rest)[0]), errors.shared(rest, self.rows, self.cols)[0]]
        )
        covariance = by_error @ by_error.T
        deviation_n = np.maximum(self.half_widths_of(rest)[0][0], MIN_DEVIATION_N)
        covariance.flat[:: len(covariance) + 1] = np.maximum(deviation_n**2, covariance.diagonal())
        if self.inverse is not None:
            deviation_n = np.maximum(deviation_n, self.half_widths_of(pressed)[0][0])
        return LoadTest.by(self.usual, covariance, deviation_n)

    def half_widths_of(self, columns_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half-widths for columns of resistances, (n, n_in) [Ω] -> twice (n, n_out) [N]."""
        found = self._known
        if self.posterior is not None:
            deviation_n = np.sqrt(np.einsum("nii->ni", self.refined(columns_ohm).covariance_n2))
            return deviation_n, 2.0 * deviation_n
        own_n2, (one, two) = self._own_variance(columns_ohm)
        deviation_n = np.sqrt(own_n2 + self.noise_variance(columns_ohm, found.errors, found.drift_factor))
        return deviation_n * one, deviation_n * two

    def _own_variance(self, columns_ohm: FloatArray) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
        A = self.activations(columns_ohm)
        force_n = self.output_scaling.unscale(A @ self.output_weights.T)
        return self._known.own_variance(A, force_n, self.output_scaling.half_range)

    def noise_variance(
        self, columns_ohm: FloatArray, errors: ReadingError, drift_factor: FloatArray | None = None
    ) -> FloatArray:
        """Variance of forces (n, n_out) [N²] that errors of readings (n, n_in) [Ω] and of the sensor's model cause."""
        found = np.zeros((len(columns_ohm), len(self.output_weights)))
        for chunk, factors in self._error_factors(columns_ohm, errors, drift_factor):
            found[chunk] = (factors**2).sum(axis=2)
        return found

    def _error_factors(
        self, columns_ohm: FloatArray, errors: ReadingError, drift_factor: FloatArray | None
    ) -> Iterator[tuple[slice, FloatArray]]:
        """Change of the forces by each independent error, chunk by chunk: (c, n_out, n_errors) [N].

        Errors are one standard deviation of each reading, of each drift that pillars share, and each draw of the
        ensemble over the root of their number. Where nothing errs there is no chunk.
        """
        if errors.is_exact and self.ensemble is None and self.left_out is None:
            return
        for start in range(0, len(columns_ohm), DERIVATIVES):
            chunk = slice(start, start + DERIVATIVES)
            slopes, columns = self.by_read(columns_ohm[chunk]), columns_ohm[chunk]
            factors = slopes * errors.deviation(columns)[:, None]
            common = []
            if errors.has_drift:
                shared = slopes @ errors.shared(columns, self.rows, self.cols)
                common.append(shared if drift_factor is None else shared @ drift_factor)
            if self.ensemble is not None:
                assert self.inverse is not None
                common.append(slopes @ self.ensemble.factors(self.inverse.forward, self.inverse.forces(columns)))
            if self.left_out is not None:
                common.append(self._by_missing(columns))
            yield chunk, np.concatenate([factors, *common], axis=2) if common else factors

    def by_read(self, columns_ohm: FloatArray) -> FloatArray:
        """`derivatives` by those that are read, which move what is left out as well; 0 by those."""
        slopes, known = self.derivatives(columns_ohm), self.foretold
        if known is None:
            return slopes
        by_read = np.where(self._missing, 0.0, slopes)
        if self._agreement is not None:
            by_missed = self._steps(columns_ohm, self._missed(columns_ohm))[0] @ self._agreement[2]
            by_read += (slopes[:, :, known.which] * columns_ohm[:, None, known.which]) @ by_missed @ by_read
        return by_read

    def without(self, pillars: NDArray[np.bool_]) -> Self:
        """The same decoder of scans in which some pillars (rows, cols, n_pillars) say nothing.

        In their places stands what the others foretell of usual loads; where the response is known, that is moved
        towards what it shows under the forces that come out, as far as these tell it.

        Notes
        -----
        Of k readings, as logarithms, with the mean y₀ and the covariance V that the others leave: the most probable
        y₀ + δ if those under the decoded forces, H δ away as they are put there, agree with them up to errors N of the
        readings that are read. δ minimises δᵀ V⁻¹ δ + mᵀ N⁻¹ m, m what those still are away, by `REFINED` steps of
        Gauss and Newton with the slopes A = 1 − H. One pillar of three that sense three forces has
        H = 1, and is where usual loads have it; of six pillars the forces alone place it.
        """
        return replace(self, left_out=pillars if self.left_out is None else pillars | self.left_out)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.cols

    @cached_property
    def _missing(self) -> NDArray[np.bool_]:
        """Which inputs are left out, (n_in,)."""
        if self.left_out is None:
            return np.zeros(len(self.places), dtype=bool)
        return self.left_out.reshape(-1)[self.places] & self.readable

    @cached_property
    def foretold(self) -> Foretold | None:
        """What stands in the places of readings that are left out; None if none is, or nobody knows them."""
        if not self._missing.any() or self.usual is None:
            return None
        usual = self.usual
        if usual.log_ohm is None:
            return None
        return Foretold.by(usual, self._missing, self.readable, self._relative(np.exp(usual.log_ohm)))

    def _relative(self, ohm: FloatArray) -> FloatArray:
        """What independent errors of readings and of the sensor's model do to logarithms of resistances, (n_in, m)."""
        errors = self.errors or ReadingError()
        found = [np.diag(np.maximum(errors.deviation(ohm), MIN_NOISE * ohm)), errors.shared(ohm[None], *self.shape)[0]]
        if self.ensemble is not None and self.inverse is not None:
            found.append(self.ensemble.factors(self.inverse.forward, self.inverse.forces(ohm[None]))[0])
        return np.concatenate(found, axis=1) / ohm[:, None]

    @cached_property
    def _agreement(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """V⁻¹ and N⁻¹, (k, k), and slopes of ln R of what is left out by forces (k, Q), at the mean load.

        None if nobody knows the response, and of `MANY` readings and more: then loads are too far from the usual ones.
        N is what m is under drawn loads, with every reading there: by errors, and as the decoder is not exact.
        """
        known, inverse = self.foretold, self.inverse
        if known is None or inverse is None or self.usual is None or len(known.which) >= MANY:
            return None
        generator, forward = np.random.default_rng(0), inverse.forward
        ohm = forward.resistances(self.usual.drawn(DRAWN, len(self.output_weights), generator))
        by_error = self._relative(np.exp(known.mean))
        ohm = ohm * np.exp(generator.standard_normal((DRAWN, by_error.shape[1])) @ by_error.T)
        m = self._missed(np.where(self.readable, ohm, DEAD_OHM))
        lengths, J = forward.jacobian(inverse.centre_n[None])
        by_force = (2.0 * J / lengths[..., None])[0, known.which]
        by_force *= 1.0 - (forward.offset_ohm / forward.resistances(inverse.centre_n[None])[0])[known.which, None]
        least = MIN_NOISE**2 * np.eye(len(known.which))
        usual, agree = (np.asarray(np.linalg.inv(each + least)) for each in (known.covariance, m.T @ m / DRAWN))
        return usual, agree, by_force

    def _missed(self, columns_ohm: FloatArray) -> FloatArray:
        """m: ln R under the decoded forces less as it stands in readings (n, n_in) [Ω], of what is left out, (n, k)."""
        assert self.foretold is not None
        assert self.inverse is not None
        which = self.foretold.which
        shown_ohm = self.inverse.forward.resistances(self.first_answers(columns_ohm))[:, which]
        return np.log(np.maximum(shown_ohm, MIN_WHOLE_OHM)) - np.log(columns_ohm[:, which])

    def _steps(
        self, columns_ohm: FloatArray, missed: FloatArray, damping: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Steps of δ by m and by δ itself, (n, k, k) each: (V⁻¹ + Aᵀ N⁻¹ A)⁻¹ times Aᵀ N⁻¹ and times V⁻¹."""
        assert self.foretold is not None
        assert self._agreement is not None
        usual, agree, _ = self._agreement
        which, A = self.foretold.which, np.empty((*missed.shape, missed.shape[1]))
        for k, place in enumerate(which):
            there = columns_ohm.copy()
            there[:, place] *= np.exp(DIFFERENCE)
            A[:, :, k] = (missed - self._missed(there)) / DIFFERENCE
        told = A.swapaxes(1, 2) @ agree
        H = usual + told @ A
        if damping is not None:
            H += (damping[:, None] * np.einsum("nii->ni", H))[:, :, None] * np.eye(len(usual))
        covariance = np.linalg.inv(H)
        return covariance @ told, covariance @ usual

    def _with_foretold(self, columns_ohm: FloatArray) -> FloatArray:
        """Readings (n, n_in) [Ω] with what is left out filled in."""
        known = self.foretold
        if known is None:
            return columns_ohm
        here = known.filled(columns_ohm)
        if self._agreement is None:
            return here
        usual, agree, _ = self._agreement
        first = np.log(here[:, known.which])

        def filled(delta: FloatArray, on: NDArray[np.intp]) -> FloatArray:
            there = here[on]
            there[:, known.which] = np.exp(first[on] + delta)
            return there

        def at(delta: FloatArray, on: NDArray[np.intp]) -> _Missed:
            m = self._missed(filled(delta, on))
            return _Missed((rowwise(m, agree) * m + rowwise(delta, usual) * delta).sum(axis=1), m, delta)

        def step(now: _Missed, damping: FloatArray, on: NDArray[np.intp]) -> FloatArray:
            by_missed, by_delta = self._steps(filled(now.delta, on), now.m, damping)
            found = (by_missed @ now.m[..., None] - by_delta @ now.delta[..., None])[..., 0]
            return np.clip(found, -MOST, MOST)

        every = np.arange(len(here))
        delta, _ = descended(np.zeros_like(first), at, step, REFINED, gained=GAINED)
        return filled(delta, every)

    def _by_missing(self, columns_ohm: FloatArray) -> FloatArray:
        """Changes of the forces by errors of what was filled in, (n, n_out, k) [N]."""
        known = self.foretold
        assert known is not None
        slopes = self.derivatives(columns_ohm)[:, :, known.which] * columns_ohm[:, None, known.which]
        if self._agreement is not None:
            slopes = slopes @ self._steps(columns_ohm, self._missed(columns_ohm))[1]
        return np.asarray(slopes @ np.linalg.cholesky(known.covariance + MIN_NOISE**2 * np.eye(len(known.which))))

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
        n_units = self.rows * self.cols
        return np.arange(n_units * len(self.layout.pillars)).reshape(n_units, -1)[:, self.pillars].reshape(-1)

    @cached_property
    def readable(self) -> NDArray[np.bool_]:
        """Which inputs can be read, (n_in,); the others have `DEAD_OHM` in their place."""
        return readable_columns(self.component, self.layout, self.dead, len(self.places))

    @property
    def errors(self) -> ReadingError | None:
        """Of the readings that its deviations are for; None if it knows none."""
        return None if self.uncertainty is None else self.uncertainty.errors

    @cached_property
    def usual_ohm(self) -> FloatArray | None:
        """Those of the mean load of training, else at rest."""
        ohms = self.rest_resistances()
        if self.usual is not None and self.usual.log_ohm is not None:
            ohms = np.ones((self.rows, self.cols, len(self.layout.pillars))) if ohms is None else ohms.copy()
            ohms.reshape(-1)[self.places] = np.exp(self.usual.log_ohm)
        return ohms

    def read_by(self, errors: ReadingError) -> Self:
        """The model with half-widths for readings that err so."""
        return self if self.uncertainty is None else replace(self, uncertainty=replace(self.uncertainty, errors=errors))

    def rest_resistances(self) -> FloatArray | None:
        """Resistances with nothing on the sensor, (rows, cols, n_pillars) [Ω]; None if its design is unknown."""
        if self.design is None:
            return None
        rest_ohm = np.tile(rest_resistances(self.design), (self.rows, self.cols, 1))
        known = self.inverse or self.posterior
        if known is not None:
            rest_ohm[..., self.pillars] = known.forward.at_rest_ohm().reshape(self.rows, self.cols, -1)
        return rest_ohm

    def untrusted(self) -> list[tuple[int, int, str]]:
        """Forces (row, col, name) that dead pillars leave unsure; empty if all can be trusted or nothing is known."""
        if self.uncertainty is None:
            return []
        limit_n = None
        if self.inverse is not None and self.dead is not None:
            errors = ReadingError(noise=self.uncertainty.errors.noise, bits=self.uncertainty.errors.bits)
            shape = self.rows, self.cols
            limit_n = cramer_rao(self.inverse.forward, self.inverse.centre_n[None], errors, shape)[0]
        lost = self.uncertainty.untrusted(self.output_scaling.half_range, limit_n)
        places = np.argwhere(lost.reshape(self.rows, self.cols, -1))
        return [(int(row), int(col), self.component.forces[axis]) for row, col, axis in places]

    def columns(self, resistance_ohm: FloatArray) -> FloatArray:
        """The resistances that are taken, (n, rows, cols, n_pillars) -> (n, n_in) [Ω]; refuses what `forces` does."""
        resistance_ohm = np.asarray(resistance_ohm, dtype=np.float64)
        columns = pillar_columns(resistance_ohm, self.component, self.layout, self.dead)
        if resistance_ohm.shape[1:3] != (self.rows, self.cols):
            given = " × ".join(map(str, resistance_ohm.shape[1:3]))
            raise SampleError(
                f"resistances are of {given} units, the model's sensor has {self.rows} × {self.cols}: "
                "train a model on data of this sensor."
            )
        return self._with_foretold(columns)

    def require(self, resistance_ohm: FloatArray) -> None:
        self.columns(resistance_ohm)

    def outputs(self, columns_ohm: FloatArray) -> FloatArray:
        """Forces of resistances, (n, n_in) [Ω] -> (n, n_out) [N]."""
        return self.first_answers(columns_ohm) if self.posterior is None else self.refined(columns_ohm).force_n

    def refined(
        self,
        columns_ohm: FloatArray,
        own_ohm: FloatArray | None = None,
        left_out: tuple[NDArray[np.bool_], FloatArray | None] | None = None,
    ) -> Found:
        """Most probable forces by the posterior, of resistances (n, n_in) [Ω] and the network's answers to them.

        `own_ohm` (n, n_in) are deviations that the readings have besides; `left_out` is of `doubts`, default: its own.
        """
        assert self.posterior is not None
        settled = columns_ohm if self.resting is None else self.resting.settled(columns_ohm)
        first_n, errors = self.first_answers(columns_ohm), self._known.errors
        shared_ohm = errors.shared(settled, self.rows, self.cols)
        if self.ensemble is not None:
            unsure_ohm = self.ensemble.factors(self.posterior.forward, self.posterior.first_states(first_n))
            shared_ohm = namespace(columns_ohm).concat([shared_ohm, unsure_ohm], axis=2)
        deviation_ohm = errors.deviation(settled)
        if own_ohm is not None:
            deviation_ohm = np.hypot(deviation_ohm, own_ohm)
        doubts = self.doubts(columns_ohm) if left_out is None else left_out
        return self.posterior.found(settled, first_n, deviation_ohm, shared_ohm, *doubts)

    def doubts(self, columns_ohm: FloatArray) -> tuple[NDArray[np.bool_], FloatArray | None]:
        """Which inputs are read, (n_in,), and what errors of others do to first answers, (n, n_out, k) [N]."""
        return self.readable & ~self._missing, None if self.foretold is None else self._by_missing(columns_ohm)

    def first_answers(self, columns_ohm: FloatArray) -> FloatArray:
        """Forces by the network alone, (n, n_in) [Ω] -> (n, n_out) [N]."""
        return self.output_scaling.unscale(rowwise(self.activations(columns_ohm), self.output_weights.T))

    def activations(self, columns_ohm: FloatArray) -> FloatArray:
        """Inputs of the output layer for resistances (n, n_in) [Ω], shape (n, n_hidden + n_linear)."""
        xp, inputs = namespace(columns_ohm), self.inputs(columns_ohm)
        X = xp.concat([inputs, xp.ones_like(inputs[:, :1])], axis=1)
        if not self.network.hidden:
            return X
        hidden = xp.tanh(rowwise(X, self.hidden_weights.T))
        return xp.concat([hidden, X if self.network.net == "skip" else X[:, -1:]], axis=1)

    def inputs(self, columns_ohm: FloatArray) -> FloatArray:
        """Inputs of the hidden layer for resistances, each (n, n_in): the feature, scaled."""
        if self.resting is not None:
            columns_ohm = self.resting.settled(columns_ohm)
        if self.inverse is not None:
            return self.input_scaling.scale(self.inverse.forces(columns_ohm))
        root = self.network.feature == "root"
        return self.input_scaling.scale(namespace(columns_ohm).sqrt(columns_ohm) if root else columns_ohm)

    def derivatives(self, columns_ohm: FloatArray) -> FloatArray:
        """Derivatives of the forces by the resistances, (n, n_in) [Ω] -> (n, n_out, n_in) [N/Ω]."""
        if self.inverse is not None:
            by_ohm = self.inverse.derivatives(columns_ohm)  # (n, n_forces, n_in)
        else:
            slope = 0.5 / np.sqrt(columns_ohm) if self.network.feature == "root" else np.ones_like(columns_ohm)
            by_ohm = slope[:, None, :] * np.eye(slope.shape[1])
        by_ohm = self.input_scaling.scale_differences(by_ohm.swapaxes(1, 2)).swapaxes(1, 2)
        n_hidden, n_in = self.network.hidden, by_ohm.shape[1]
        s = 1.0 - self.activations(columns_ohm)[:, :n_hidden] ** 2
        network = (self.output_weights[:, :n_hidden] * s[:, None, :]) @ self.hidden_weights[:, :-1]
        if self.network.net == "skip":
            network = network + self.output_weights[:, n_hidden : n_hidden + n_in]
        return self.output_scaling.half_range[:, None] * (network @ by_ohm)


class _Missed(NamedTuple):
    """Readings of n scans that are filled in."""

    cost: FloatArray  #: (n,)
    m: FloatArray  #: (n, k)
    delta: FloatArray  #: (n, k)
