"""Figures of merit of a design, from its finite-element response alone: nothing is trained.

Definitions with their equations are in docs/sweeps.md. Every force is judged by the pillar named after it, its own.
"""

import numpy as np

from dataset import Samples
from dataset.measurement import measured
from dataset.protocols import PROTOCOLS
from dataset.resistance import largest_factors, pillar_lengths, pillar_resistances
from dataset.simulation import displacements, forces
from decoupler.data.columns import component_named, force_columns
from decoupler.evaluation.metrics import evaluate
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.limits import cramer_rao
from decoupler.model.settings import NetworkConfig, TrainingConfig
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.layout import AXES, PILLARS, FloatArray, pillar_volumes

OWN_AXIS = tuple(AXES.index(pillar) for pillar in PILLARS)  #: the force component that each pillar is named after
DISTANCES = (1, 2, 3)  #: pitches to the neighbours of the crosstalk
LOADS = 8  #: draws of the three-axis protocol that the noise-limited error is the mean of
SEED = 0  #: of those draws, the same for every design
SPLITS = {"train": (3000, 1), "test": (400, 2)}  #: samples and seed of the trained net's data

#: the figures of a row: name for tables and pictures, unit, meaning
FIGURES = {
    "error_n": ("error", "N", "noise-limited error of a force component, root mean square over axes, units and loads"),
    "error_pct": ("error", "%", "the same in % of range_n"),
    **{f"error_{axis}_n": (f"error of F{axis}", "N", f"the same of F{axis} alone") for axis in AXES},
    "range_n": ("range", "N", "force along z that every pad can carry, alone or all together, below the strain cap"),
    "pressure_one_mpa": (
        "pressure on one pad", "MPa", "largest pressure on one pad alone below the strain cap, of the weakest pad"
    ),
    "pressure_all_mpa": (
        "pressure on all pads", "MPa", "largest pressure on all pads at once below the strain cap"
    ),
    **{
        f"sensitivity_{pillar}_pct_per_n": (
            f"sensitivity of {pillar} pillars", "%/N", f"change of a {pillar} pillar by its own force, mean over units"
        )
        for pillar in PILLARS
    },
    "sensitivity_least_pct_per_n": ("least sensitivity", "%/N", "the same of the least sensitive of all pillars"),
    **{
        f"crosstalk_{d}": (f"crosstalk at {d} × pitch", "1", f"worst response {d} pitches away over the loaded unit's")
        for d in DISTANCES
    },
    **{
        f"crosstalk_{pillar}_{d}": (
            f"crosstalk of {pillar} pillars at {d} × pitch", "1", f"the same of {pillar} pillars alone, {d} away"
        )
        for pillar in PILLARS
        for d in DISTANCES
    },
    "condition": (
        "condition number", "1", "condition number of the map from forces to relative resistances, at rest"
    ),
    "area_cm2": ("area", "cm²", "footprint of the slab"),
    "volume_cm3": ("volume", "cm³", "volume of the slab"),
    "error_estimate": ("error of the response", "1", "estimated relative error of the response"),
    "unknowns": ("unknowns", "1", "unknowns of the largest system solved"),
    "seconds": ("time", "s", "time spent on the design, whatever was taken from the cache left out"),
    "seconds_mesh": ("meshing", "s", "of which meshing its cell"),
    "seconds_condense": ("condensing", "s", "of which condensing it"),
    "seconds_couple": ("coupling", "s", "of which coupling the array"),
    "peak_mib": ("memory", "MiB", "largest memory of the worker so far"),
    **{
        f"trained_{axis}_n": (
            f"trained error of F{axis}", "N", f"error of the trained joint net in F{axis}, root mean square"
        )
        for axis in AXES
    },
}  # fmt: skip


def figure_label(name: str) -> str:
    """What people read instead of a figure's key: its name with its unit.

    >>> figure_label("area_cm2"), figure_label("condition")
    ('area [cm²]', 'condition number')
    """
    label, unit, _ = FIGURES[name]
    return label if unit == "1" else f"{label} [{unit}]"


def merits(response: ArrayResponse, noise: float, bits: int | None, cap: float) -> dict[str, float | None]:
    """Figures of a design by the names of `FIGURES`; None where the array is too small for one.

    Parameters
    ----------
    response : ArrayResponse
    noise, bits : float, int or None
        Of the readings, as `dataset.measurement.reading_deviation` takes them.
    cap : float
        Largest strain |l − l₀|/l₀ of a pillar.
    """
    design = response.design
    forward = ForwardModel.of(response, component_named("all"))
    G = relative_slopes(forward)
    own = self_sensitivities(G, design.n_units)
    talk = crosstalk(G, design)
    errors = noise_limited_errors(forward, loads_at_cap(response, cap, LOADS, SEED), noise, bits)
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


def relative_slopes(forward: ForwardModel) -> FloatArray:
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

    Of a force on one pad: what it does to the pillar of its name in a unit so many pitches away along a row or a column
    of the array, over what it does to that of the loaded unit.
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


def noise_limited_errors(forward: ForwardModel, force_n: FloatArray, noise: float, bits: int | None) -> FloatArray:
    """Least error of an unbiased estimate of each force component, root mean square over units and loads, (3,) [N].

    `force_n` has shape (n, n_forces). The Cramér-Rao bound of
    `decoupler.inverse.limits`, a load at a time: that bounds memory.
    """
    bounds = [cramer_rao(forward, force_n[k : k + 1], noise, bits) for k in range(len(force_n))]
    return np.sqrt((np.concatenate(bounds).reshape(-1, len(AXES)) ** 2).mean(axis=0))


def loads_at_cap(response: ArrayResponse, cap: float, n: int, seed: int) -> FloatArray:
    """Forces (n, n_units·3) [N] of draws of the three-axis protocol, scaled together to the end of the design's range.

    All draws are scaled by one factor, with which the most strained pillar of all is at the cap. So every design is
    judged by loads of the same kind over the range that it has.
    """
    return force_columns(_capped(response, cap, n, seed)[0], component_named("all"))


def labelled_at_cap(response: ArrayResponse, cap: float, n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """The same forces (n, rows, cols, 3) [N] with the exact resistances (n, rows, cols, 3) [Ω] that they cause."""
    force_n, moved = _capped(response, cap, n, seed)
    design = response.design
    lengths = pillar_lengths(moved, design.unit).reshape(force_n.shape)
    return force_n, pillar_resistances(lengths, pillar_volumes(design.unit), design.resistivity_ohm_mm)


def _capped(response: ArrayResponse, cap: float, n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Forces (n, rows, cols, 3) [N] at the end of the range, and displacements (n, n_units, 2, 3) [mm]."""
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


def training_errors(response: ArrayResponse, noise: float, bits: int | None, cap: float) -> dict[str, float | None]:
    """Errors of the joint decoupler, trained and tested on noisy samples of loads as those of the noise-limited error.

    Raises
    ------
    DesignError
        If the converter cannot tell the design's resistances.
    """
    from decoupler import train  # loads torch: only where something is trained

    samples = {}
    for split, (count, seed) in SPLITS.items():
        force_n, exact_ohm = labelled_at_cap(response, cap, count, seed)
        ohm = measured(exact_ohm, noise, bits, np.random.default_rng([seed, 1]))
        samples[split] = Samples(
            resistance_ohm=ohm,
            force_n=force_n,
            design=response.design,
            noise=noise,
            bits=bits,
        )
    network = NetworkConfig(feature="inverse")
    model = train(samples["train"], "all", network, TrainingConfig(), response=response)
    errors = evaluate(model, samples["test"])
    return {f"trained_{axis}_n": errors[f"f{axis}"].rmse_n for axis in AXES}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
