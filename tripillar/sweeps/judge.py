"""Judging a design: from its finite-element response to its metrics, without training; runs in worker processes.

Every pillar is judged by the force along which it leans, its own; an upright one by Fz. Definitions with their
equations are in docs/results.md.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import astuple, fields, replace
from time import perf_counter
from typing import Any

import numpy as np

from common.errors import DesignError
from dataset.loads import bearable_mpa, displacements, largest_pressures
from dataset.measurement import ReadingError
from dataset.protocols import PROTOCOLS, forces
from dataset.resistance import largest_factors
from decoupler.data.columns import component_named, force_columns
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from decoupler.touch.limits import touch_limits
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, array_response
from geometry.castability import Castability, castability, conductive_mm3
from geometry.design import SensorDesign, Unit
from geometry.design_file import design_to_toml
from geometry.layout import AXES, FloatArray, pillar_vectors, untold
from geometry.wiring import wires
from hardware.boards.sensor_header import fastest_hz
from tripillar.sweeps.rows import DISTANCES, Row
from tripillar.sweeps.sampling import Sample
from tripillar.sweeps.sweep_file import Judging

Judged = dict[str, float | str]  #: metrics, or why there is none
FAR = "no unit is {} × pitch away"  #: why crosstalk is not known
LOADS = 8  #: draws of the three-axis protocol that the noise-limited error is the mean of
ERRORS = ("error_n", "error_pct", *(f"error_{axis}_n" for axis in AXES), "condition")
SEED = 0  #: of those draws, the same for every design


def row_of(sample: Sample, judging: Judging) -> Row:
    """Judge a sample that has a design. Errors are those of `array_response`, `metrics_of` and `touch_limits`."""
    assert sample.design is not None
    start = perf_counter()
    response, _, reused = array_response(sample.design, ResponseSettings(tolerance=judging.tolerance))
    found = metrics_of(response, judging.noise, judging.bits, judging.cap) | made_of(sample.design)
    if judging.touch_n:
        design, errors = sample.design, ReadingError(noise=judging.noise, bits=judging.bits)
        found |= known(("touch_net_pct", "touch_place_mm"), lambda: touch_limits(design, judging.touch_n, errors))
    found |= {} if reused else {f"seconds_{step}": seconds for step, seconds in response.seconds.items()}
    found |= {"seconds": perf_counter() - start}
    return row_with(
        sample,
        metrics={name: None if isinstance(value, str) else value for name, value in found.items()},
        untold={name: value for name, value in found.items() if isinstance(value, str)},
    )


def row_with(sample: Sample, **found: Any) -> Row:
    """The row of a sample with what was found, or the reason why it could not be judged."""
    design = None if sample.design is None else design_to_toml(sample.design)
    return Row(cache_key=sample.cache_key, values=sample.values, design=design, **found)


def metrics_of(response: ArrayResponse, noise: float, bits: int | None, cap: float) -> Judged:
    """Metrics of a design's response by the names of `metrics_for`; a text says why there is none.

    Parameters
    ----------
    response : ArrayResponse
    noise, bits : float, int or None
        Of the readings, as in `dataset.measurement.ReadingError`.
    cap : float
        Largest strain |l − l₀|/l₀ of a pillar.
    """
    design = replace(response.design, unit=response.design.unit.body)
    forward = SensorModel.of(response, component_named("all"))
    loaded = [*response.design.unit.layout.loaded]
    G = relative_slopes(forward).reshape(design.n_units, -1, forward.n_forces)[:, loaded].reshape(-1, forward.n_forces)
    own, pillars = self_sensitivities(G, design), design.unit.layout.pillar_names
    talk = crosstalk(G, design)
    one, everywhere = largest_pressures(response, cap)
    range_n = bearable_mpa(response, cap) * design.pad.size_mm**2
    return {
        **known(ERRORS, lambda: errors_of(response, noise, bits, cap, range_n)),
        "range_n": range_n,
        "pressure_one_mpa": one,
        "pressure_all_mpa": everywhere,
        **{
            f"sensitivity_{pillar}_pct_per_n": 100 * float(value)
            for pillar, value in zip(pillars, own.mean(axis=0), strict=True)
        },
        "sensitivity_least_pct_per_n": 100 * float(own.min()),
        **{f"crosstalk_{d}": _told(talk[:, k].max(), FAR.format(d)) for k, d in enumerate(DISTANCES)},
        **{
            f"crosstalk_{pillar}_{d}": _told(talk[p, k], FAR.format(d))
            for p, pillar in enumerate(pillars)
            for k, d in enumerate(DISTANCES)
        },
        "error_estimate": _told(response.error_estimate, "the method estimates none"),
        "unknowns": float(response.unknowns),
    }


def known(names: Iterable[str], found: Callable[[], Iterable[float | str]]) -> Judged:
    """Numbers by their names, or for each of these why they are not known."""
    try:
        return dict(zip(names, found(), strict=True))
    except DesignError as refusal:
        return dict.fromkeys(names, str(refusal))


def errors_of(
    response: ArrayResponse, noise: float, bits: int | None, cap: float, range_n: float
) -> Iterator[float | str]:
    """Errors of pad loads and the condition number, of pressure alone where no more is told."""
    said = " and ".join(untold(response.design.unit))
    parts = component_named("fz" if said else "all")
    forward = SensorModel.of(response, parts)
    force_n, _ = loads_at_cap(response, cap, LOADS, SEED)
    reading, array = ReadingError(noise=noise, bits=bits), response.design.array
    force_n = force_columns(force_n, parts)
    errors = noise_limited_errors(forward, force_n, reading, (array.rows, array.cols))
    error = float(np.sqrt((errors**2).mean()))
    by_axis: dict[str, float | str] = dict(zip(parts.axes, map(float, errors), strict=True))
    yield from (error, 100 * error / range_n)
    yield from (by_axis.get(axis, f"pillars do not tell forces along {said} from others") for axis in AXES)
    yield float(np.linalg.cond(relative_slopes(forward)))


def made_of(design: SensorDesign) -> Judged:
    """What a design takes to be built and read: size, rubber, wires and channels, scan rate, how well it casts."""
    (x, y, z), layout = design.slab_mm, design.unit.layout
    channels = design.n_units * len(layout.pillars)
    cast = known([spec.name for spec in fields(Castability)], lambda: astuple(castability(design)))
    return {
        "area_cm2": x * y / 100,
        "volume_cm3": x * y * z / 1000,
        "conductive_cm3": conductive_mm3(design) / 1000,
        "channels": float(channels),
        "wires": float(sum(wires(design.array.rows, design.array.cols, layout))),
        "rate_hz": float(fastest_hz(channels)),
        **{name: "no pillar leans" if value is None else value for name, value in cast.items()},
    }


def relative_slopes(forward: SensorModel) -> FloatArray:
    """G = ∂(ln R)/∂F at rest, shape (n_pillars, n_forces) [1/N]; R ∝ l², so G = 2/l ∂l/∂F."""
    lengths, J = forward.jacobian(np.zeros((1, forward.n_forces)))
    return 2 * J[0] / lengths[0][:, None]


def own_axes(unit: Unit) -> list[int]:
    """Number of each pillar's own force component: along which it leans, of an upright one z.

    >>> own_axes(Unit())
    [2, 0, 1]
    """
    leans = np.abs(pillar_vectors(unit)[:, :2])
    return np.where(leans.any(axis=1), leans.argmax(axis=1), AXES.index("z")).tolist()


def self_sensitivities(G: FloatArray, design: SensorDesign) -> FloatArray:
    """Size of the relative resistance change of every pillar by 1 N of its own component, (n_units, P) [1/N]."""
    own, n_units = own_axes(design.unit), design.n_units
    every = np.arange(n_units)[:, None]
    return np.abs(G.reshape(n_units, len(own), n_units, len(AXES))[every, np.arange(len(own)), every, own])


def crosstalk(G: FloatArray, design: SensorDesign) -> FloatArray:
    """Worst crosstalk of each kind of pillar at each of `DISTANCES`, shape (P, 3); NaN where no unit is so far away.

    Crosstalk is the response of a pillar so many pitches away along a row or a column to a force of its own component,
    over that of the loaded unit's own pillar.
    """
    rows, cols = np.indices((design.array.rows, design.array.cols)).reshape(2, -1)
    apart = [np.abs(place[:, None] - place) for place in (rows, cols)]
    own = own_axes(design.unit)
    by_unit = np.abs(G.reshape(design.n_units, len(own), design.n_units, len(AXES)))
    found = np.full((len(own), len(DISTANCES)), np.nan)
    for p, axis in enumerate(own):
        slopes = by_unit[:, p, :, axis]  # observed, loaded
        ratios = slopes / slopes.diagonal()
        for k, distance in enumerate(DISTANCES):
            neighbours = (np.minimum(*apart) == 0) & (np.maximum(*apart) == distance)
            if neighbours.any():
                found[p, k] = ratios[neighbours].max()
    return found


def noise_limited_errors(
    forward: SensorModel, force_n: FloatArray, errors: ReadingError, shape: tuple[int, int]
) -> FloatArray:
    """Least error of an unbiased estimate of each force component, root mean square over units and loads, (k,) [N].

    `force_n` has shape (n, n_forces). The bound is that of Cramér and Rao, a load at a time: that bounds memory.
    """
    bounds = [cramer_rao(forward, force_n[k : k + 1], errors, shape) for k in range(len(force_n))]
    return np.sqrt((np.concatenate(bounds).reshape(len(force_n) * math.prod(shape), -1) ** 2).mean(axis=0))


def loads_at_cap(response: ArrayResponse, cap: float, n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Loads at the end of the design's range, and the displacements that they cause.

    The loads are draws of the three-axis protocol, all scaled by the one factor with which the most strained pillar is
    at the cap. So every design is judged by loads of the same kind over the range that it has.

    Returns
    -------
    array, shape (n, rows, cols, 3)
        Forces [N], z positive in compression.
    array, shape (n, n_units, n_upper, 3)
        Displacements of the electrodes [mm].
    """
    design = response.design
    traction = PROTOCOLS["three-axis"].draw(np.random.default_rng(seed), n, design)
    moved = displacements(response, traction)
    factor = largest_factors(moved, design.unit, cap).min()
    force_n = forces(traction * factor, design).reshape(n, design.array.rows, design.array.cols, 3)
    return force_n, moved * factor


def _told(value: float, otherwise: str) -> float | str:
    return float(value) if np.isfinite(value) else otherwise
