"""Training of a causal filter on histories that a rubber may have: its numbers as well as they are known, and errors.

Strips differ from their rubber, and may be of another one; gains and slow errors are drawn; some histories begin in the
middle, and some have gaps.
"""

import logging
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import Generator

from common.storage.cache import kept_value
from common.storage.files import digest
from dataset.memory import PillarMemory, broken_contacts, log_rise
from decoupler.rubber.causal import FARTHEST, LOG_SPREADS, CausalFilter
from decoupler.rubber.law import NAMES, Rubber
from geometry.design import Memory
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from torch import Tensor

SESSIONS = 0.12  #: deviation of a strip's ln R between two mountings of it, relative
SLOW = 0.03  #: slow error of its ln R, at least
ONE_SIDED = 0.1  #: of a specimen's largest strain: less the other way is none
VERSION = 4  #: of what training does; filters of others are trained anew
RATES_S = (0.05, 0.3)  #: between readings
SPEEDS = (0.004, 0.3)  #: of strain [1/s]
HOLDS_S = (1.0, 300.0)
WAVES_HZ = (0.01, 0.5)
AT_REST = 0.55  #: share of histories that begin at rest
GAPS = 0.4  #: share of groups with a gap
GAP_S = (1.5, 40.0)
OTHER = 0.6  #: deviation of the logarithms of another rubber's numbers
OTHER_SLOPES = (0.8, 1.0)  #: of its g₁ and g₂
CUT = 2.0  #: deviations beyond which nothing is drawn
KEPT = (0.9, 0.999)  #: of the means of slopes and of their squares, in a step of training


@dataclass(frozen=True, kw_only=True)
class Histories:
    """What histories are trained on. A filter of the same is the same."""

    numbers: tuple[float, ...]  #: the rubber's, in the order of `law.NAMES`
    covariance: tuple[tuple[float, ...], ...] = ((0.0,) * len(NAMES),) * len(NAMES)
    noise: float = 0.01  #: slow error of ln R
    correlation_s: float = 20.0  #: over which it is alike
    fast: float = 0.002  #: error of single readings
    spread: float = 0.15  #: of pillars' numbers about their rubber's, relative
    gain: float = 0.03  #: of ln R, relative
    other: float = 0.2  #: share of pillars of another rubber
    strains: tuple[float, float] = (-0.3, 0.3)
    groups: int = 10  #: of histories that are read at the same times
    pillars: int = 192  #: of a group; sessions that are unlike others are learned from many
    readings: int = 1600  #: of each
    every: int = 8  #: of which one is learned from
    steps: int = 3000  #: of training
    hidden: int = 48
    nets: int = 3  #: trained on the same; their mean hangs less on how each began
    seed: int = 0


def of_rubber(rubber: Rubber, **others: Any) -> Histories:
    """Histories of a rubber as a bench series showed it."""
    rows = tuple(tuple(float(f"{value:.6g}") for value in row) for row in rubber.covariance)
    numbers = tuple(float(f"{value:.6g}") for value in rubber.numbers)
    largest = max(0.3, min(0.6, 1.05 * rubber.max_strain))
    known: dict[str, Any] = {"noise": rubber.noise, "correlation_s": rubber.correlation_s, "strains": (-0.3, largest)}
    return Histories(numbers=numbers, covariance=rows, **(known | others))


def of_strip(rubber: Rubber) -> Histories:
    """Histories of a specimen like that of a bench series: strained as it was, of a gain that differs by session."""
    sides = 1.05 * min(rubber.min_strain, 0.0), 1.05 * max(rubber.max_strain, 0.0)
    strains = tuple(each * (abs(each) > ONE_SIDED * max(map(abs, sides))) for each in sides)
    return of_rubber(rubber, strains=strains, gain=SESSIONS, noise=max(SLOW, rubber.noise))


def trained(histories: Histories, memory: Memory) -> CausalFilter:
    """A filter from the cache, or trained in a minute and kept there."""
    key = digest({"version": VERSION, **asdict(histories)})

    def make() -> CausalFilter:
        logging.getLogger("tripillar").warning("training what follows this rubber's memory: a minute, once")
        return train(histories, memory)

    return kept_value(CausalFilter, "causal.npz", key, make, memory=memory)[0]


def train(histories: Histories, memory: Memory) -> CausalFilter:
    """A filter that has learned histories by heart as little as it can: deviations are those of histories held out."""
    generator = np.random.default_rng(histories.seed)
    blank = CausalFilter(
        memory=memory, strains=histories.strains, centre=np.zeros(0), width=np.zeros(0), hidden=np.zeros(0),
        second=np.zeros(0), output=np.zeros(0), skip=np.zeros(0), unit=1.0,
    )  # fmt: skip
    inputs, by_law, strains, ends = [], [], [], 0
    for k, (y, strain, seconds) in enumerate(drawn(histories, generator)):
        follower = blank.start(y.shape[1])
        seen = [follower.seen(*each) for each in zip(y, seconds.tolist(), strict=True)]
        seen, strain = seen[:: histories.every], strain[:: histories.every]
        inputs.append(np.stack([x for x, _ in seen], axis=2).astype(np.float32))
        by_law.append(np.stack([found for _, found in seen], axis=2))
        strains.append(strain.T)
        ends += (k < histories.groups - max(1, histories.groups // 8)) * strain.size
    x = np.concatenate([each.reshape(len(each), -1) for each in inputs], axis=1).T
    laws = np.concatenate([each.reshape(len(each), -1) for each in by_law], axis=1).T
    strain = np.concatenate([each.ravel() for each in strains])
    found = _fitted(blank, x[:ends], laws[:ends], strain[:ends], histories)
    mean, deviation = found.judged(x[ends:].T, laws[ends:].T)
    held = np.abs(mean - strain[ends:]) / deviation
    return replace(found, widening=float(max(1.0, np.quantile(held, 0.95) / 1.96)))


def drawn(histories: Histories, generator: Generator) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Groups of histories: ln R/R₀ and strains (time, n), and seconds (time,) since the reading before."""
    values, directions = np.linalg.eigh(np.array(histories.covariance))
    spread = directions * np.sqrt(np.maximum(values, 0.0))
    for _ in range(histories.groups):
        yield _group(histories, np.array(histories.numbers), spread, generator)


def _group(
    histories: Histories, numbers: FloatArray, spread: FloatArray, generator: Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n, m = histories.readings, histories.pillars
    apart_s = _between(generator, RATES_S)
    past = int(generator.uniform(0, 150) / apart_s)
    rested = generator.random(m) < AT_REST
    moved = [_motion(generator, n if each else past + n, apart_s, histories.strains, each) for each in rested]
    strain = np.stack([np.r_[np.zeros(past + n - len(each)), each] for each in moved], axis=1)
    memory = _memories(histories, numbers, spread, generator)
    broken = broken_contacts(strain, apart_s, memory)
    y = 2 * np.log1p(strain) + np.asarray(log_rise(strain, broken, memory))
    y *= np.exp(histories.gain * generator.standard_normal(m))
    keep = np.exp(-apart_s / histories.correlation_s)
    size = histories.noise * np.exp(0.5 * generator.standard_normal(m))
    y += _wandering(generator, len(y), m, keep) * size + histories.fast * generator.standard_normal(y.shape)
    y, strain, seconds = y[past:], strain[past:], np.full(n, apart_s)
    if generator.random() < GAPS:
        first = int(generator.integers(n // 4, n - 10))
        last = min(n - 2, first + int(_between(generator, GAP_S) / apart_s))
        there = np.r_[0:first, last:n]
        seconds[last] = (last - first + 1) * apart_s
        y, strain, seconds = y[there], strain[there], seconds[there]
    return y, strain, seconds


def _memories(histories: Histories, numbers: FloatArray, spread: FloatArray, generator: Generator) -> PillarMemory:
    m = histories.pillars
    drawn = numbers[:, None] + spread @ np.clip(generator.standard_normal((len(numbers), m)), -CUT, CUT)
    is_other = generator.random(m) < histories.other
    own = np.where(is_other, OTHER, histories.spread) * generator.standard_normal((6, m))
    g1, g2 = drawn[:2] + is_other * np.array(OTHER_SLOPES)[:, None] * generator.standard_normal((2, m))
    a1, a2 = drawn[2:4] * np.exp(own[:2])
    lengthen, shorten, tau1, tau2 = np.exp(np.clip(drawn[4:] + own[2:], -12.0, 12.0))
    return PillarMemory(a=(a1, a2), b_lengthen=lengthen, b_shorten=shorten, tau_s=(tau1, tau2), g1=g1, g2=g2)


def _wandering(generator: Generator, n: int, m: int, keep: float) -> FloatArray:
    """Errors (n, m) of deviation 1, each like the one before."""
    from scipy.signal import lfilter

    noise = np.sqrt(1 - keep**2) * generator.standard_normal((n, m))
    noise[0] /= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], noise, axis=0))


def _motion(generator: Generator, n: int, apart_s: float, strains: tuple[float, float], is_rested: bool) -> FloatArray:
    """Strains (n,) of ramps, holds and waves, mostly of one sign; from rest, or as they come."""
    low, high = strains
    size = generator.uniform(0.1, 1.0)
    signs = [each for each in strains if each]
    sign = signs[int(generator.random() < 0.4) if len(signs) == 2 else 0]
    is_mixed = len(signs) == 2 and generator.random() < 0.25

    def level() -> float:
        limit = (low if generator.random() < 0.5 else high) if is_mixed else sign
        return float(size * limit * generator.random())

    parts, count, now = [], 0, 0.0 if is_rested else level()
    if is_rested:
        parts.append(np.zeros(int(generator.uniform(1.0, 20.0) / apart_s) + 1))
        count = len(parts[0])
    while count < n:
        kind = generator.random()
        if kind < 0.5:
            to = 0.0 if generator.random() < 0.35 else level()
            parts.append(_ramp(now, to, _between(generator, SPEEDS) * apart_s))
        elif kind < 0.75:
            parts.append(np.full(int(_between(generator, HOLDS_S) / apart_s) + 1, now))
        else:
            wave = _wave(generator, int(generator.uniform(10.0, 100.0) / apart_s) + 2, apart_s)
            first, second = level(), level()
            wave = first + (second - first) * wave
            parts += [_ramp(now, float(wave[0]), 0.05 * apart_s), wave]
        now = float(parts[-1][-1])
        count = sum(map(len, parts))
    return np.concatenate(parts)[:n]


def _ramp(start: float, end: float, step: float) -> FloatArray:
    return np.linspace(start, end, max(1, int(abs(end - start) / step)) + 1)[1:]


def _wave(generator: Generator, n: int, apart_s: float) -> FloatArray:
    """Four sines, from 0 to 1."""
    time_s = apart_s * np.arange(1, n + 1)[:, None]
    slowest, quickest = np.log(WAVES_HZ)
    hertz = np.exp(generator.uniform(slowest, quickest, 4))
    waves = np.sin(2 * np.pi * (hertz * time_s + generator.random(4))) @ generator.standard_normal(4)
    return np.asarray((waves - waves.min()) / (np.ptp(waves) + 1e-9))


def _between(generator: Generator, limits: tuple[float, float]) -> float:
    return float(np.exp(generator.uniform(*np.log(limits))))


def _fitted(blank: CausalFilter, x: FloatArray, laws: FloatArray, strain: FloatArray, asked: Histories) -> CausalFilter:
    """Nets that give what happened the greatest likelihood."""
    import torch

    centre, width, unit = x.mean(axis=0), x.std(axis=0) + 1e-6, float(strain.std())
    scaled = np.clip((x - centre) / width, -FARTHEST, FARTHEST)
    given, by_law, wanted = (torch.from_numpy(each.astype(np.float32)) for each in (scaled, laws / unit, strain / unit))
    with torch.random.fork_rng():
        torch.manual_seed(asked.seed)
        nets = [_net(given, by_law, wanted, asked) for _ in range(asked.nets)]
    hidden, second, output, skip = (np.stack(each) for each in zip(*nets, strict=True))
    return replace(blank, centre=centre, width=width, unit=unit, hidden=hidden, second=second, output=output, skip=skip)


def _net(x: "Tensor", by_law: "Tensor", wanted: "Tensor", asked: Histories) -> list[FloatArray]:
    """Weights of a net, of a mixture of both answers: of its layers, bias last, and from inputs to its own answer.

    AdamW, on all of them as one vector: `torch.optim` takes 1.3 s to load, and then 16 % of every step instead of 4 %
    (process time, one thread).
    """
    import torch

    n, h = x.shape[1], asked.hidden
    layers = [torch.nn.Linear(n, h), torch.nn.Linear(h, h), torch.nn.Linear(h, 5)]
    skip = torch.nn.Linear(n, 1, bias=False)
    torch.nn.init.zeros_(skip.weight)
    parameters = [p for each in (*layers, skip) for p in each.parameters()]
    weights = torch.nn.utils.parameters_to_vector(parameters).detach()
    torch.nn.utils.vector_to_parameters(weights, parameters)
    slopes, mean, square = torch.zeros(3, len(weights))
    for parameter, slope in zip(parameters, slopes.split([p.numel() for p in parameters]), strict=True):
        parameter.grad = slope.view_as(parameter)
    for step in range(asked.steps):
        batch = torch.randint(0, len(x), (2048,))
        given, law, true = (each.index_select(0, batch) for each in (x, by_law, wanted[:, None]))
        out = layers[2](torch.relu(layers[1](torch.relu(layers[0](given)))))
        log_belief, log_spread = torch.log_softmax(out[:, :2], 1), out[:, 2:4].clamp(*LOG_SPREADS)
        answers = torch.cat([law, out[:, 4:] + skip(given)], dim=1)
        miss = (answers - true) / torch.exp(log_spread)
        loss = -torch.logsumexp(log_belief - log_spread - 0.5 * miss**2, dim=1).mean()
        slopes.zero_()
        loss.backward()
        rate = 4e-3 * min(1.0, (step + 1) / 50) * (1 - 0.98 * step / asked.steps)
        mean.lerp_(slopes, 1 - KEPT[0])
        square.mul_(KEPT[1]).addcmul_(slopes, slopes, value=1 - KEPT[1])
        of_mean, of_square = (1 - kept ** (step + 1) for kept in KEPT)  # what a start from zero has left of them
        weights.mul_(1 - 1e-4 * rate).addcdiv_(mean, (square.sqrt() / of_square**0.5).add_(1e-8), value=-rate / of_mean)
    own = [torch.cat([each.weight, each.bias[:, None]], dim=1) for each in layers]
    return [each.detach().numpy() for each in (*own, skip.weight)]
