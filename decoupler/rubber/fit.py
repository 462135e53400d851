"""From a bench series to its rubber: the memory of its resistance, the law of its force, and what stays unknown.

The priors are what was published of silicones filled with carbon black: after a release their resistance comes back in
6 to 12 and 76 to 120 s, of which shortening breaks 4 to 8 times as many contacts as lengthening.
"""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from dataset.memory import relaxed_forces
from decoupler.rubber.law import LINEAR, Elastic, Rubber, memory_of, settled_stress
from decoupler.rubber.separable import Fit, fitted
from decoupler.rubber.series import Series
from decoupler.rubber.unknown import unknown_of
from geometry.design import SECOND_RATIO, Memory, Prony
from geometry.layout import FloatArray

#: mean and deviation of g1, g2, a1, a2
LINEAR_PRIOR = np.array([[1.5, 2.0], [-5.0, 5.0], [0.25, 0.2], [0.25, 0.2]])
#: of the logarithms of b_lengthen, of b_shorten over it, and of both times
OTHER_PRIOR = np.log([[1.5, 2.5], [5.7, 3.0], [9.0, 2.0], [120.0, 2.5]])
STATE = 0.2  #: deviation of what a run begins with, if not at rest: of ln R, and of a force over its range
LEAST_STIFFNESS_N = 1e-9  #: stiffness of a force that falls as strain rises [N]
ANY = 30.0  #: deviation of ln R₀, and of a force over its range: nothing is known
TIMES = ((1.0, 1.0), (0.35, 0.3), (1.5, 3.0))  #: that both times begin with, over the prior's
RELAXING = np.log([[0.05, 4.0], [0.05, 4.0], [1.0, 3.0], [60.0, 4.0]])  #: prior of shares and times of relaxation
ROWS = 3000  #: that a force's law is found from
#: laws of forces: (stiffening, second) of each of their parts; the first part's number is the stiffness
LAWS = {"neo-hookean": [(0.0, 0.0)], "mooney-rivlin": [(0.0, SECOND_RATIO)], "yeoh": [(0.0, 0.0), (1.0, 0.0)]}

#: from fitted numbers to those of `law.NAMES`: ln b of shortening is that of lengthening and of their ratio
STATED = np.eye(8)
STATED[5, 4] = 1.0
PRIOR_COVARIANCE = STATED @ np.diag(np.r_[LINEAR_PRIOR, OTHER_PRIOR][:, 1] ** 2) @ STATED.T  #: of these, (8, 8)


def identified(
    series: Series,
    wires: int = 4,
    section_mm2: float | None = None,
    electrodes_mm: float | None = None,
    length_mm: float | None = None,
) -> Rubber:
    """The rubber of a series; with the specimen's section, and the distance of its electrodes, in ohms and MPa too.

    A series read by two wires as well, between the clamps `length_mm` apart, tells what its contacts are.
    """
    elastic, force_noise_n = fit_elastic(series)
    strains = float(series.strain.min()), float(series.strain.max())
    covariance, told = PRIOR_COVARIANCE, dict[str, Any](memory=Memory(), noise=0.0, correlation_s=0.0)
    if series.resistance_ohm is not None:
        fit, own = fit_memory(series), np.r_[:LINEAR, -4:0]  # what a series begins with is no rubber's
        covariance = STATED @ fit.covariance[np.ix_(own, own)] @ STATED.T
        told = {"memory": memory_of(STATED @ fit.numbers[own]), "rest_ohm": float(np.exp(fit.numbers[LINEAR]))}
        told |= {"noise": fit.noise, "correlation_s": fit.correlation_s}
    if series.two_wire_ohm is not None and electrodes_mm and length_mm:
        contacts_ohm = (series.two_wire_ohm - series.resistance_ohm * length_mm / electrodes_mm) / 2
        told["contact_ohm"] = contact_ohm = max(float(np.median(contacts_ohm)), 0.0)
        told["contact_spread"] = float(np.std(contacts_ohm)) / contact_ohm if contact_ohm else 0.0
    return Rubber(
        covariance=covariance, elastic=elastic, force_noise_n=force_noise_n, min_strain=strains[0],
        max_strain=strains[1], wires=wires, section_mm2=section_mm2, electrodes_mm=electrodes_mm,
        unknown=tuple(unknown_of(covariance, PRIOR_COVARIANCE, strains)), **told,
    )  # fmt: skip


def fit_memory(series: Series) -> Fit:
    """g₁, g₂, a₁, a₂, ln R₀, logarithms of b, of the ratio of both b, and of both times τ.

    Of each run that does not begin at rest there are two more after ln R₀: what it has of both q then.
    """
    strain, seconds = series.strain, series.seconds
    states = [[0.0, STATE]] * (2 * len(series.unsettled))
    prior = np.array([*LINEAR_PRIOR, [np.log(series.resistance_ohm).mean(), ANY], *states, *OTHER_PRIOR])
    bare = np.stack([strain, strain**2, np.ones_like(strain)], axis=1)
    moved = np.diff(strain)

    def columns(others: FloatArray) -> FloatArray:
        memory = memory_of(np.r_[np.zeros(LINEAR), STATED[LINEAR:, LINEAR:] @ others])
        parts = [bare[:, :2], series.broken(memory).T, bare[:, 2:]]
        if states:
            rate = memory.b_lengthen * moved.clip(min=0.0) - memory.b_shorten * moved.clip(max=0.0)
            parts.append(_left(series, [rate + seconds / tau_s for tau_s in memory.tau_s]))
        return np.concatenate(parts, axis=1)

    starts = OTHER_PRIOR[:, 0] + np.log([(1.0, 1.0, *times) for times in TIMES])
    return fitted(columns, np.log(series.resistance_ohm) - 2 * np.log1p(strain), seconds, prior, starts)


def _left(series: Series, decays: Sequence[FloatArray]) -> FloatArray:
    """What is left (n, runs · decays) of states 1 that runs begin with, that decay so much in each step (n − 1,)."""
    found = np.zeros((len(series), len(series.unsettled) * len(decays)))
    for column, (begin, decay) in enumerate(product(series.unsettled, decays)):
        found[begin:, column] = np.exp(-np.r_[0.0, np.cumsum(decay[begin:])])
    return found


def fit_elastic(series: Series) -> tuple[Elastic, float]:
    """The law of the force that a series tells best, and the standard deviation of forces about it [N].

    Of neo-Hookean, Mooney and Rivlin's and Yeoh's law that of the least −2 ln likelihood with k ln n for its numbers.
    """
    series = series.averaged(max(1, len(series) // ROWS))
    size = max(float(np.ptp(series.force_n)), 1e-12)
    fits = {name: _fit_force(series, parts, size) for name, parts in LAWS.items()}
    count = min(fit.count for fit in fits.values())
    costs = {name: count * np.log(fit.noise**2) + len(LAWS[name]) * np.log(count) for name, fit in fits.items()}
    model = min(costs, key=lambda name: costs[name])
    fit, n = fits[model], len(LAWS[model])
    stiffness, *more = fit.numbers[:n] * size
    shares, times = np.exp(fit.numbers[-4:]).reshape(2, 2)
    elastic = Elastic(
        model=model, stiffness_n=max(float(stiffness), LEAST_STIFFNESS_N),
        stiffening=float(more[0] / stiffness) if more else 0.0,
        second=LAWS[model][0][1], prony=Prony(share=tuple(shares), tau_s=tuple(times)),
    )  # fmt: skip
    return elastic, fit.noise * size


def _fit_force(series: Series, parts: list[tuple[float, float]], size: float) -> Fit:
    """Stiffnesses and an offset over `size`, logarithms of the shares and the times of relaxation."""
    first, *others = (settled_stress(series.strain, *part) for part in parts)
    settled = np.stack([first, *(other - first for other in others)], axis=1)
    seconds, ones = series.seconds, np.ones((len(series), 1))

    def columns(others: FloatArray) -> FloatArray:
        shares, times = np.exp(np.clip(others, -20, 20)).reshape(2, 2)
        prony = Prony(share=tuple(np.minimum(shares, 10.0)), tau_s=tuple(times))
        left = _left(series, [seconds / tau_s for tau_s in prony.tau_s])
        return np.concatenate([relaxed_forces(settled, seconds, prony), ones, left], axis=1)

    prior = np.array([*[[0.0, ANY]] * (len(parts) + 1), *[[0.0, STATE]] * (2 * len(series.unsettled)), *RELAXING])
    return fitted(columns, series.force_n / size, seconds, prior, RELAXING[None, :, 0])
