"""Judging a design: from its finite-element response to its metrics, without training; runs in worker processes.

Every force is judged by the pillar named after it, its own. Definitions with their equations are in docs/results.md.
"""

from dataclasses import replace
from time import perf_counter

import numpy as np

from dataset import Samples
from dataset.measurement import ReadingError, measured
from dataset.protocols import PROTOCOLS, forces
from dataset.resistance import effective_lengths, largest_factors, pillar_resistances
from dataset.simulation import displacements
from decoupler.data.columns import component_named, force_columns
from decoupler.evaluation.metrics import evaluate
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.touch.limits import touch_limits
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, array_response
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml
from geometry.errors import TriPillarError
from geometry.layout import AXES, PILLARS, FloatArray, pillar_volumes
from tripillar.sweep.memory import peak_mib
from tripillar.sweep.rows import DISTANCES, Metrics, Row
from tripillar.sweep.sampling import Sample
from tripillar.sweep.sweep_file import Judging

OWN_AXIS = tuple(AXES.index(pillar) for pillar in PILLARS)  #: the force component that each pillar is named after
LOADS = 8  #: draws of the three-axis protocol that the noise-limited error is the mean of
SEED = 0  #: of those draws, the same for every design
SPLITS = {"train": (3000, 1), "test": (400, 2)}  #: samples and seed of the trained net's data
FAILURES = (TriPillarError, MemoryError, ArithmeticError, np.linalg.LinAlgError)  #: errors that a design may fail by


def row_of(sample: Sample, judging: Judging) -> Row:
    """Judge a design; one that fails gives a row with the reason."""
    unjudged = Row(cache_key=sample.cache_key, values=sample.values, design=None, reason=sample.reason)
    if sample.design is None:
        return unjudged
    row = replace(unjudged, design=design_to_toml(sample.design))
    start = perf_counter()
    try:
        response, _, reused = array_response(sample.design, ResponseSettings(tolerance=judging.tolerance))
        metrics = metrics_of(response, judging.noise, judging.bits, judging.cap)
        if judging.touch_n:
            errors = ReadingError(noise=judging.noise, bits=judging.bits)
            net, place = touch_limits(sample.design, judging.touch_n, errors)
            metrics |= {"touch_net_pct": net, "touch_place_mm": place}
        row = replace(row, sensitivity_per_n=sensitivities(response))
    except FAILURES as error:
        return replace(row, reason=f"{type(error).__name__}: {error}", metrics=_cost(start))
    if judging.train:
        try:
            metrics |= training_errors(response, judging.noise, judging.bits, judging.cap)
        except FAILURES as error:
            row = replace(row, note=f"not trained: {error}")
    spent = {} if reused else {f"seconds_{step}": seconds for step, seconds in response.seconds.items()}
    return replace(row, metrics=metrics | spent | _cost(start))


def failed_row(sample: Sample, error: BaseException, more: str = "") -> Row:
    """The row of a design that ended its worker, or failed by an unforeseen error."""
    reason = f"{type(error).__name__}: {error}".splitlines()[0] + more
    return Row(cache_key=sample.cache_key, values=sample.values, design=None, reason=reason)


def sensitivities(response: ArrayResponse) -> list[list[list[float]]]:
    """Relative resistance change of every pillar by 1 N of its own force, (rows, cols, 3) as lists [1/N]."""
    design = response.design
    G = relative_slopes(SensorModel.of(response, component_named("all")))
    by_unit = self_sensitivities(G, design.n_units).reshape(design.array.rows, design.array.cols, -1)
    found: list[list[list[float]]] = by_unit.tolist()
    return found


def _cost(start: float) -> Metrics:
    return {"seconds": perf_counter() - start, "peak_mib": peak_mib()}


def metrics_of(response: ArrayResponse, noise: float, bits: int | None, cap: float) -> Metrics:
    """Metrics of a design by the names of `METRICS`; None where the array is too small for one.

    Parameters
    ----------
    response : ArrayResponse
    noise, bits : float, int or None
        Of the readings, as `dataset.measurement.reading_deviation` takes them.
    cap : float
        Largest strain |l − l₀|/l₀ of a pillar.
    """
    design = response.design
    joint = component_named("all")
    forward = SensorModel.of(response, joint)
    G = relative_slopes(forward)
    own = self_sensitivities(G, design.n_units)
    talk = crosstalk(G, design)
    force_n, _ = loads_at_cap(response, cap, LOADS, SEED)
    errors = noise_limited_errors(forward, force_columns(force_n, joint), noise, bits)
    error = float(np.sqrt((errors**2).mean()))
    one, everywhere = largest_pressures(response, cap)
    area_mm2 = design.pad.size_mm**2
    range_n = min(one, everywhere) * area_mm2
    x, y, z = design.slab_mm
    return {
        "error_n": error,
        "error_pct": 100 * error / range_n,
        **{f"error_{axis}_n": float(value) for axis, value in zip(AXES, errors, strict=True)},
        "range_n": range_n,
        "pressure_one_mpa": one,
        "pressure_all_mpa": everywhere,
        **{
            f"sensitivity_{pillar}_pct_per_n": 100 * float(value)
            for pillar, value in zip(PILLARS, own.mean(axis=0), strict=True)
        },
        "sensitivity_least_pct_per_n": 100 * float(own.min()),
        **{f"crosstalk_{d}": _number(talk[:, k].max()) for k, d in enumerate(DISTANCES)},
        **{
            f"crosstalk_{pillar}_{d}": _number(talk[p, k])
            for p, pillar in enumerate(PILLARS)
            for k, d in enumerate(DISTANCES)
        },
        "condition": float(np.linalg.cond(G)),
        "area_cm2": x * y / 100,
        "volume_cm3": x * y * z / 1000,
        "error_estimate": _number(response.error_estimate),
        "unknowns": float(response.unknowns),
    }


def relative_slopes(forward: SensorModel) -> FloatArray:
    """G = ∂(ln R)/∂F at rest, shape (n_pillars, n_forces) [1/N]; R ∝ l², so G = 2/l ∂l/∂F."""
    lengths, J = forward.jacobian(np.zeros((1, forward.n_forces)))
    return 2 * J[0] / lengths[0][:, None]


def self_sensitivities(G: FloatArray, n_units: int) -> FloatArray:
    """Size of the relative resistance change of every pillar by 1 N of its own component, (n_units, 3) [1/N]."""
    by_unit = G.reshape(n_units, len(PILLARS), n_units, len(AXES))
    every = np.arange(n_units)
    return np.abs(by_unit[every[:, None], np.arange(len(PILLARS)), every[:, None], OWN_AXIS])


def crosstalk(G: FloatArray, design: SensorDesign) -> FloatArray:
    """Worst crosstalk of each kind of pillar at each of `DISTANCES`, shape (3, 3); NaN where no unit is so far away.

    Crosstalk is the response of a pillar so many pitches away along a row or a column to a force of its name, over that
    of the loaded unit's own pillar.
    """
    rows, cols = np.indices((design.array.rows, design.array.cols)).reshape(2, -1)
    apart = [np.abs(place[:, None] - place) for place in (rows, cols)]
    by_unit = np.abs(G.reshape(design.n_units, len(PILLARS), design.n_units, len(AXES)))
    found = np.full((len(PILLARS), len(DISTANCES)), np.nan)
    for p, axis in enumerate(OWN_AXIS):
        slopes = by_unit[:, p, :, axis]  # observed, loaded
        ratios = slopes / slopes.diagonal()
        for k, distance in enumerate(DISTANCES):
            neighbours = (np.minimum(*apart) == 0) & (np.maximum(*apart) == distance)
            if neighbours.any():
                found[p, k] = ratios[neighbours].max()
    return found


def noise_limited_errors(forward: SensorModel, force_n: FloatArray, noise: float, bits: int | None) -> FloatArray:
    """Least error of an unbiased estimate of each force component, root mean square over units and loads, (3,) [N].

    `force_n` has shape (n, n_forces). The bound is that of Cramér and Rao, a load at a time: that bounds memory.
    """
    bounds = [cramer_rao(forward, force_n[k : k + 1], noise, bits) for k in range(len(force_n))]
    return np.sqrt((np.concatenate(bounds).reshape(-1, len(AXES)) ** 2).mean(axis=0))


def loads_at_cap(response: ArrayResponse, cap: float, n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Loads at the end of the design's range, and the displacements that they cause.

    The loads are draws of the three-axis protocol, all scaled by the one factor with which the most strained pillar is
    at the cap. So every design is judged by loads of the same kind over the range that it has.

    Returns
    -------
    array, shape (n, rows, cols, 3)
        Forces [N], z positive in compression.
    array, shape (n, n_units, 2, 3)
        Displacements of the electrodes [mm].
    """
    design = response.design
    traction = PROTOCOLS["three-axis"].draw(np.random.default_rng(seed), n, design)
    moved = displacements(response, traction)
    factor = largest_factors(moved, design.unit, cap).min()
    force_n = forces(traction * factor, design).reshape(n, design.array.rows, design.array.cols, 3)
    return force_n, moved * factor


def largest_pressures(response: ArrayResponse, cap: float) -> tuple[float, float]:
    """Largest pressure [MPa] on one pad alone, the weakest, and on all pads at once, with strains below the cap."""
    n_units = response.design.n_units
    down = -np.array([*np.eye(n_units), np.ones(n_units)])
    traction = np.zeros((n_units + 1, n_units, 3))
    traction[..., AXES.index("z")] = down
    factors = largest_factors(displacements(response, traction, ("z",)), response.design.unit, cap)
    return float(factors[:-1].min()), float(factors[-1])


def training_errors(response: ArrayResponse, noise: float, bits: int | None, cap: float) -> Metrics:
    """Errors of the joint network, trained and tested on noisy samples of loads like those of the noise-limited error.

    Raises
    ------
    DesignError
        If the converter cannot tell the design's resistances.
    """
    from decoupler import train  # loads torch: only where something is trained

    design, samples = response.design, {}
    for split, (count, seed) in SPLITS.items():
        force_n, moved = loads_at_cap(response, cap, count, seed)
        newtons = force_n.reshape(len(force_n), -1, 3) * np.array([1.0, 1.0, -1.0])
        lengths = effective_lengths(response, moved, newtons).reshape(force_n.shape)
        exact_ohm = pillar_resistances(lengths, pillar_volumes(design.unit), design.resistivity_ohm_mm)
        ohm = measured(exact_ohm, noise, bits, np.random.default_rng([seed, 1]))
        samples[split] = Samples(resistance_ohm=ohm, force_n=force_n, design=design, noise=noise, bits=bits)
    network = NetworkConfig(feature="inverse")
    model = train(samples["train"], "all", network, TrainingConfig(), response=response)
    errors = evaluate(model, samples["test"])
    return {f"trained_{axis}_n": errors[f"f{axis}"].rmse_n for axis in AXES}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
