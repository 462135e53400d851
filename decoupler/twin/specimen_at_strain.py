"""A specimen at finite strain from measured pairs: the same unknowns as of a linear one, on the maps of its design."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dataset.changed_designs import ChangedDesigns
from dataset.measurement import ReadingError
from dataset.samples import SampleError
from decoupler.data.pairs import Pairs
from decoupler.data.usual_loads import images_of
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.posterior import Posterior
from decoupler.inverse.specimen import SHARED, Specimen
from decoupler.inverse.strain_maps import FEW, N_AXES
from decoupler.training.finite_strain import DRAWS, drawn_samples, refined, states_of, trained_on
from decoupler.twin.expectation import Widths
from decoupler.twin.identification import Twin, readings_of
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from geometry.tolerances import changed, nearest, usual_deviations, value_of

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse
    from fem.array.sensitivities import ResponseSensitivities

HELD = 40  #: loads that other designs are solved under
RIDGE = 3e-4  #: of the changes by parameters, per row, of features of root mean square 1
YOUNG = ("rubber.young_mpa", "matrix_material.young_mpa")  #: the modulus that loads are in proportion to
REFINEMENTS = 2  #: times that the design which was found is solved itself
ROUNDS = 4  #: of Gauss-Newton over the unknowns
SHARED_WIDTHS = (3e-4, 1e-3, 3e-3)  #: of corrections that all units share, over the square at rest, at full scale
MISFITS = (3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2)  #: of a reading beyond what is known, over its rest
EXACT = 1e-9  #: deviation of a modulus that is exactly known, relative
FOLDED = 3.0  #: change of a reading over its rest by one deviation of an unknown, beyond which a pair is near a fold


class NearDesigns:
    """Changes of the maps' weights of `FEW` by other designs, from answers under some loads.

    Parameters
    ----------
    designed : ForwardModel
        Of the design as meant, at finite strain.
    response : ArrayResponse
        Of the same.
    sensitivities : ResponseSensitivities
        Its derivatives.
    force_n : array, shape (m, 3 k)
        Loads that other designs are solved under [N]; z positive presses.
    """

    def __init__(
        self,
        designed: ForwardModel,
        response: "ArrayResponse",
        sensitivities: "ResponseSensitivities",
        force_n: FloatArray,
    ) -> None:
        maps = designed.maps
        assert maps is not None
        self._designed, self._maps, self._shape = designed, maps, (len(force_n), len(maps.near), -1)
        self._designs = ChangedDesigns(response, sensitivities, force_n.reshape(self._shape) * (1.0, 1.0, -1.0))
        self._own = self._designs.answers(response.design)
        y, _, self._force_n, _ = designed.at_states(states_of(self._own.displacement_mm, maps.influence))
        self._missed = self._own.squares_mm2.reshape(y.shape) - y

    def change(self, other: SensorDesign) -> FloatArray:
        """Change of the weights that makes the maps those of another design, (292, 3 + p).

        Notes
        -----
        χ changes by the forces that the design as meant would bear in the other's state, ρ by the squares that it would
        not show. Both are fitted less what the maps miss of the design as meant under the same loads.
        """
        answers = self._designs.answers(other)
        state_n = states_of(answers.displacement_mm, self._maps.influence)
        y, _, force_n, _ = self._designed.at_states(state_n)
        sound = answers.settled & self._own.settled
        squares = answers.squares_mm2.reshape(y.shape) - y - self._missed
        parts = [(self._force_n - force_n).reshape(self._shape), squares.reshape(self._shape)]
        targets = np.concatenate(parts, axis=2)[sound].reshape(-1, self._maps.weights.shape[1])
        A = self._maps.few(state_n)[sound].reshape(-1, len(FEW))
        size = np.sqrt((A**2).mean(axis=0))
        usable = np.where(size > 0, size, 1.0)  # no pad of small arrays has some neighbours
        A = A / usable
        weights = np.linalg.solve(A.T @ A + RIDGE * len(A) * np.eye(len(FEW)), A.T @ targets)
        return np.where(size[:, None] > 0, weights / usable[:, None], 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Inferred:
    """A specimen as its pairs show it."""

    specimen: Specimen
    misfit: float  #: of a reading beyond what is known, over its rest
    excess: float  #: χ² of the readings over their number


def infer_specimen(
    designed: ForwardModel,
    changes: FloatArray,
    shift: FloatArray,
    widths: Widths,
    young: float,
    resistance_ohm: FloatArray,
    force_n: FloatArray,
    unknown_n: FloatArray,
    pair: NDArray[np.int64],
    errors: ReadingError,
    size: tuple[int, int],
) -> Inferred:
    """The most probable specimen, and the covariance of its unknowns.

    Parameters
    ----------
    designed : ForwardModel
    changes, shift : arrays
        As `Specimen` has them.
    widths : Widths
        Of resistivity, gain and offset.
    young : float
        Standard deviation of the modulus, relative.
    resistance_ohm : array, shape (n, P)
        Readings [Ω]; NaN where not read.
    force_n : array, shape (n, 3 k)
        Forces [N], z positive presses.
    unknown_n : array, shape (m, 3 k)
        Directions in which the forces of pair `pair` (m,) may differ, a standard deviation each [N].
    errors : ReadingError
        Of the readings; what pillars share of them is taken for what they have of their own.
    size : tuple
        Rows and columns of the array.

    Raises
    ------
    SampleError
        If no pair has a state.

    Notes
    -----
    Everything normal, linearised anew in each round. The widths of shared corrections and of the misfit are those of
    the greatest evidence.
    """
    n, P = resistance_ohm.shape
    rest = np.sqrt((designed.linear.lengths(np.zeros((1, designed.n_forces)))[0]) ** 4)
    measured = resistance_ohm / designed.ohm_per_mm2 / rest
    read = np.isfinite(measured)
    reading = errors.total(np.where(read, resistance_ohm, 1.0), *size) / designed.ohm_per_mm2 / rest
    best: tuple[float, Specimen, float, float] | None = None
    for shared in SHARED_WIDTHS:
        specimen = Specimen.as_designed(changes, P, shift)
        U = len(specimen.unknowns)
        prior = _prior(specimen, widths, young, shared, P)
        root = np.linalg.cholesky(prior)
        latent = np.zeros(len(pair))
        for _ in range(ROUNDS):
            gain, offset, *_ = specimen.parts
            model = specimen.model(designed)
            acting = force_n.copy()
            np.add.at(acting, pair, latent[:, None] * unknown_n)
            assert model.maps is not None
            state_n, there_are = model.maps.nearest_states(acting)
            state_n[~there_are] = 0.0
            y, by_state, _, by_force = model.at_states(state_n)
            by_n = np.linalg.solve(by_force.swapaxes(1, 2), by_state.swapaxes(1, 2)).swapaxes(1, 2)
            X = specimen.derivatives(model, state_n) * (1.0 + gain)[:, None] / rest[:, None]
            Z = np.zeros((n, P, len(pair)))
            Z[pair, :, np.arange(len(pair))] = (by_n[pair] @ unknown_n[..., None])[..., 0] * (1.0 + gain) / rest
            there_are &= np.abs(X).max(axis=(1, 2)) < FOLDED
            if not there_are.any():
                raise SampleError("no pair has forces that this design bears at finite strain: are they in newtons?")
            some = read & there_are[:, None]
            A = np.concatenate([X @ root, Z], axis=2)[some]
            x = np.concatenate([np.linalg.solve(root, specimen.unknowns), latent])
            z = (measured - (1.0 + gain) * y / rest - offset)[some] + A @ x
            maps_variance = model.maps.misfit_variance(state_n)[..., N_AXES:].reshape(n, P) / rest**2
            known = (reading**2 + maps_variance)[some]
            found = max((_solved(A, z, known + misfit**2, misfit) for misfit in MISFITS), key=lambda one: one[0])
            evidence, x, covariance, misfit, excess = found
            mean = root @ x[:U]
            spread = root @ covariance[:U, :U] @ root.T
            factor = np.linalg.cholesky(spread + 1e-12 * np.diag(np.diag(prior))).astype(np.float64)
            specimen, latent = replace(specimen, unknowns=mean, factor=factor), x[U:]
        if best is None or evidence > best[0]:
            best = evidence, specimen, misfit, excess
    assert best is not None
    return Inferred(specimen=best[1], misfit=best[2], excess=best[3])


def _prior(specimen: Specimen, widths: Widths, young: float, shared: float, n_pillars: int) -> FloatArray:
    """Covariance of the unknowns before any pair."""
    deviation = np.ones(len(specimen.unknowns))
    deviation[:n_pillars] = widths.gain
    deviation[n_pillars : 2 * n_pillars] = widths.offset
    deviation[2 * n_pillars] = young
    deviation[len(deviation) - len(SHARED) * (specimen.changes.shape[2] - N_AXES) :] = shared
    prior = np.diag(deviation**2)
    prior[:n_pillars, :n_pillars] += widths.resistivity**2
    return prior


def _solved(
    A: FloatArray, z: FloatArray, variance: FloatArray, misfit: float
) -> tuple[float, FloatArray, FloatArray, float, float]:
    """Evidence, mean and covariance of x in z = A x + errors, x of variance 1 before; misfit; χ² over the number."""
    whitened = A / np.sqrt(variance)[:, None]
    target = z / np.sqrt(variance)
    M = whitened.T @ whitened + np.eye(A.shape[1])
    L = np.linalg.cholesky(M)
    half = np.linalg.solve(L, whitened.T @ target)
    x = np.linalg.solve(L.T, half)
    cost = target @ target - half @ half
    evidence = -0.5 * cost - np.log(L.diagonal()).sum() - 0.5 * np.log(variance).sum()
    inverse = np.linalg.inv(M).astype(np.float64)
    return float(evidence), x.astype(np.float64), inverse, misfit, float(cost / len(z))


def identify_at_strain(
    pairs: Pairs,
    response: "ArrayResponse",
    sensitivities: "ResponseSensitivities",
    designed: Posterior,
    loads_n: FloatArray | None = None,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> Twin:
    """Identify a sensor at finite strain from measured pairs.

    Parameters
    ----------
    pairs : Pairs
    response : ArrayResponse
        Of the sensor as designed.
    sensitivities : ResponseSensitivities
        Its derivatives, and the deviations of parameters before anything is measured.
    designed : Posterior
        Of the design at finite strain: that of a decoder which was trained on its samples.
    loads_n : array, shape (n, rows, cols, 3), optional
        Loads like those that the sensor will meet [N]; default: images of those that the design has seen.
    seed : int
    progress : callable
        Takes each share of the work as it is done.

    Raises
    ------
    SampleError
        If the pairs are of another array, or no pair has forces that the design bears.
    """
    design = response.design
    rows, cols = design.array.rows, design.array.cols
    if pairs.force_n.shape[1:3] != (rows, cols):
        raise SampleError("the pairs are of another array than the design: give this array's design.")
    readings = readings_of(pairs, [0, 1, 2], [0, 1, 2])
    errors = ReadingError(noise=pairs.noise, bits=pairs.bits).with_drifts_of(design.electrics)
    usual = usual_deviations(design)
    stated = dict(zip(sensitivities.parameters, sensitivities.deviation.tolist(), strict=True))
    near = NearDesigns(designed.forward, response, sensitivities, designed.loads_n[:HELD])
    young = next(name for name in YOUNG if name in usual)
    names = [name for name in stated if name != young]
    share = 0.6 / (len(names) + REFINEMENTS)
    by_deviation = []
    for name in names:
        by_deviation.append(near.change(changed(design, name, usual[name])) * stated[name] / usual[name])
        progress(share)
    changes, shift = np.array(by_deviation), np.zeros_like(by_deviation[0])
    P = designed.forward.n_pillars
    with threadpool_limits(1, "blas"):
        for refinement in range(REFINEMENTS + 1):
            found = infer_specimen(
                designed.forward,
                changes,
                shift,
                Widths(),
                max(stated.get(young, 0.0) / value_of(design, young), EXACT),
                np.where(readings.read, readings.resistance_ohm, np.nan),
                readings.force_n,
                readings.unknown_n,
                readings.pair,
                errors,
                (rows, cols),
            )
            if refinement < REFINEMENTS:  # about the design that was found, changes by single parameters add up
                of_parameters = found.specimen.parts[3]
                wanted = {
                    name: value_of(design, name) + stated[name] * float(by)
                    for name, by in zip(names, of_parameters, strict=True)
                }
                other = nearest(design, wanted)
                made = [(value_of(other, name) - value_of(design, name)) / stated[name] for name in names]
                shift = near.change(other) - np.tensordot(made, changes, axes=1)
                progress(share)
        specimen = found.specimen
        gain, offset, modulus, parameters, _ = specimen.parts
        rest_ohm, model = designed.forward.linear.at_rest_ohm(), specimen.model(designed.forward)
        model = replace(model, ohm_per_mm2=(1.0 + gain) * model.ohm_per_mm2, offset_ohm=offset * rest_ohm)
        own = replace(designed, forward=model, specimen=specimen, misfit=found.misfit)
        if loads_n is None:
            loads_n = images_of(designed.loads_n.reshape(-1, rows, cols, 3), [0, 1, 2], DRAWS)
        draws = drawn_samples(own, loads_n.reshape(len(loads_n), -1), design, errors, seed)
        progress(0.1)
        decoder = refined(trained_on(draws), own, draws)
    dead = ~readings.read.any(axis=0).reshape(rows, cols, -1)
    decoder = replace(
        decoder,
        dead=dead if dead.any() else None,
        made_from={"identified_on": pairs.content_hash, "pairs": len(pairs)},
    )
    covariance = specimen.factor @ specimen.factor.T
    at = [2 * P, *range(2 * P + 1, 2 * P + 1 + len(names))]
    deviation = np.sqrt(covariance.diagonal())
    young_mpa = value_of(design, young)
    values = {young: (young_mpa * float(np.exp(modulus[0])), young_mpa * float(deviation[2 * P]))}
    for place, name in enumerate(names):
        by = stated[name] * np.array([parameters[place], deviation[2 * P + 1 + place]])
        values[name] = value_of(design, name) + float(by[0]), float(by[1])
    common = 1.0 + float(gain.mean())
    progress(0.3)
    return Twin(
        design=design,
        decoder=decoder,
        n_pairs=len(pairs),
        parameters=values,
        covariance=covariance[np.ix_(at, at)],
        resistivity=common,
        gain=(1.0 + gain) / common,
        gain_deviation=deviation[:P],
        offset_ohm=offset * rest_ohm,
        offset_deviation_ohm=deviation[P : 2 * P] * rest_ohm,
        excess=found.excess,
    )
