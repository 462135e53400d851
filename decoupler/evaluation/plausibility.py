"""Checks whether readings and forces can belong together and to their sensor, and names the usual mistakes in files.

The response of the sensor says how lengths follow the forces. A data set is doubted if it fits that decidedly better
after one of `MISTAKES` is taken back, or if the readings fit the forces worse than if nothing linked them. Of measured
`Pairs`, few and each of a load that someone put on, every load has to change its readings as it should.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import permutations

import numpy as np

from dataset import Samples
from dataset.measurement import ReadingError
from dataset.protocols import INDENT
from dataset.variables import MAX_N
from decoupler.data.columns import COMPONENTS, MIN_NOISE, Columns, Component, force_columns, load_numbers
from decoupler.data.enough import FALSE_ALARMS
from decoupler.data.pairs import Pairs
from decoupler.inverse.sensor_model import SensorModel
from decoupler.training.suited import residuals
from geometry.layout import AXES, FloatArray, untold

MAX_JUDGED = 500  #: samples, spread over the data; more say no more of such mistakes
CONSTANT = 1e-12  #: range over size of a column that varies by rounding alone
UNSTATED_NOISE = 0.01  #: assumed of readings whose file states no noise: that of a poor board
KILOOHM = (3.0, 30.0)  #: range of readings that are of kΩ: no pillar of a sensor has so few ohms
#: smallest share of the readings' motion that the forces explain once a mistake is taken back: of contacts on bare
#: rubber, which no pad load explains, 0.3 to 0.6 with and without one
MIN_EXPLAINED = 0.7
EDGE = 3.0**0.5  #: deviation of a reading that hops between two steps, over that of one step
KGF_N = 9.80665  #: weight of a kilogram
MAX_TIMES = 2.0  #: largest ratio to the design, or its inverse; real sensors differ by less, wrong units by more
MAX_UNSURE = 0.2  #: largest relative standard deviation of a load as the sensor shows it; above, it cannot be judged

Turn = Callable[[FloatArray], FloatArray]  #: of forces (n, rows, cols, 3), which takes a mistake back

_SIGNS = "z > 0 is compression, x runs along columns, y along rows"
MISTAKES: dict[str, Turn] = {
    "the forces seem to be in kN: multiply them by 1000": lambda F: F * 1e3,
    "the forces seem to be in mN: divide them by 1000": lambda F: F * 1e-3,
    "the forces seem to be in kgf: multiply them by 9.81, unless the rubber is a tenth as stiff": lambda F: F * KGF_N,
    "the forces seem to be taken for kgf: divide them by 9.81, unless the rubber is ten times as stiff": (
        lambda F: F / KGF_N
    ),
    f"all forces seem to have the other sign: {_SIGNS}": lambda F: -F,
    f"Fz seems to have the other sign: {_SIGNS}": lambda F: F * [1.0, 1.0, -1.0],
    f"Fx seems to have the other sign: {_SIGNS}": lambda F: F * [-1.0, 1.0, 1.0],
    f"Fy seems to have the other sign: {_SIGNS}": lambda F: F * [1.0, -1.0, 1.0],
    "rows and columns of the forces seem to be exchanged: rows run along y": lambda F: F.swapaxes(1, 2),
    "rows of the forces seem to stand in reverse order: they begin at −y": lambda F: F[:, ::-1],
    "columns of the forces seem to stand in reverse order: they begin at −x": lambda F: F[:, :, ::-1],
    **{
        f"axes seem to stand in the order {', '.join(AXES[order.index(k)] for k in range(3))}: a file's are "
        f"{', '.join(AXES)}": partial(np.take, indices=order, axis=-1)
        for order in [*permutations(range(3))][1:]
    },
}


def doubt(data: Samples | Pairs, component: Component, forward: SensorModel | None) -> str | None:
    """Name the likely mistake in samples and how to mend it, in a line; None if there seems to be none.

    Parameters
    ----------
    data : Samples or Pairs
        Pairs need the joint sensor and its component, `all`.
    component : Component
        Whose pillars and forces are looked at.
    forward : SensorModel, optional
        Of the sensor that the data are said to be of: joint (`all`), or of the component's own pillars and forces.
        Without it only contacts, forces that are constant and kΩ are noticed.

    Notes
    -----
    A mistake is likelier than none by (S₀/S)^(m/2): S are sums of squares of what the response leaves of the lengths,
    gain and slope of each pillar left free within reason, their errors normal and of unknown size. m is the number of
    loads times that of the directions in which the residuals spread: an error that pillars share counts once. Half of
    `FALSE_ALARMS` each is for readings that do not follow the forces and for all mistakes together. One pair, or
    readings that noise hides, say nothing and are never doubted.
    """
    if isinstance(data, Pairs):
        return None if forward is None else _of_loads(data, component, forward)
    if said := _of_contacts(data):
        return said
    data = _some(data, component)
    own = Columns.of(data, component)
    columns = own.resistance_ohm[:, own.readable]
    if len(own) > 1 and _is_constant(own.force_n) and _scattered(columns, data):
        return f"{_alike(own.force_n)}, though the resistances differ by more than noise: give their loads"
    if forward is None and columns.size and KILOOHM[0] <= columns.min() <= columns.max() <= KILOOHM[1]:
        return f"all resistances are {columns.min():.3g} to {columns.max():.3g}, as in kΩ: give them in Ω, times 1000"
    if forward is None or not columns.size:
        return None
    times = float(np.median(columns) / np.median(forward.at_rest_ohm()))
    if round(math.log10(times) / 3):
        return (
            f"the resistances are {times:.2g} times the design's: give them in Ω, or the design the resistivity_ohm_mm "
            "of this rubber"
        )
    return _mistaken(_Fit(data, component, forward))


def nothing_to_learn(data: Samples, component: Component) -> str | None:
    """Say in a line that all samples are contacts, the same, or of the same load; None if they differ."""
    if said := _of_contacts(data):
        return said
    if len(data.force_n) < 2:
        return None
    own = Columns.of(data, component)
    if _is_constant(own.force_n):
        return f"{_alike(own.force_n)}: nothing can be learnt"
    is_constant = _is_constant(own.resistance_ohm)
    return "every resistance is the same in all samples: nothing can be learnt" if is_constant else None


def disturbance(data: Samples, component: Component, forward: SensorModel | None) -> str | None:
    """Say in a line that forces other than the component's move its pillars; None if they do not.

    `forward` is joint (`all`); without it any such force is one too many.
    """
    acting = [axis for axis in AXES if axis not in component.axes and data.force_n[..., AXES.index(axis)].any()]
    if not acting:
        return None
    share = ""
    if forward is not None:
        by_all = _Fit(_some(data, component), component, forward)
        by_own = by_all.turned(lambda F: F * [float(axis in component.axes) for axis in AXES])
        if not by_all.log_likelier(by_own) > math.log(1.0 / FALSE_ALARMS):
            return None
        share = f" ({1.0 - by_all.energy / by_own.energy:.0%} of what {component.name} leaves unexplained is theirs)"
    tells_all = data.design is None or not untold(data.design.unit)
    mend = "use the component 'all'" if tells_all else "take samples without them, or a layout that tells them"
    return (
        f"forces along {' and '.join(acting)} act as well and move the same pillars{share}: they become errors of "
        f"{component.name}; {mend}"
    )


def explained(data: Samples, component: Component, forward: SensorModel) -> float | None:
    """Share of what the readings do beyond their stated noise that the model foretells; None if noise hides it.

    Of a sensor with another pad, pitch or rubber than the model's it is well below 1, and nothing else may show that.
    """
    return _Fit(_some(data, component), component, forward).explained


def _of_loads(pairs: Pairs, component: Component, forward: SensorModel) -> str | None:
    """Say why loads cannot have acted as stated: by the size of the readings, or what each load changed.

    A load changes them by a multiple of what the model says: 1 if all is as told, 0 if it was not put on.
    """
    modelled_ohm = forward.resistances(force_columns(pairs.force_n, component)).reshape(pairs.resistance_ohm.shape)
    times = float(np.nanmedian(pairs.resistance_ohm / modelled_ohm))
    if not 1.0 / MAX_TIMES < times < MAX_TIMES:
        unit = "; a factor of 1000 is kΩ for Ω" if 300 < max(times, 1.0 / times) < 3000 else ""
        return (
            f"the sensor's resistances are {times:.3g} times those of the design: check the board's SENSE_OHM and the "
            f"design's resistivity{unit}."
        )
    if not (pairs.force_n != pairs.force_n[0]).any():
        return None
    # relative changes from nothing on the sensor, or from the mean of all, fitted by a multiple of the modelled ones
    acts = pairs.force_n.any(axis=(1, 2, 3))
    is_reference = np.ones_like(acts) if acts.all() else ~acts
    change, expected = (
        (ohms / ohms[is_reference].mean(axis=0) - 1.0)[acts] for ohms in (pairs.resistance_ohm, modelled_ohm)
    )
    expected = np.where(np.isnan(change), 0.0, expected)
    size = np.sqrt((expected**2).sum(axis=(1, 2, 3)))
    is_told = math.sqrt(2.0) * pairs.noise < MAX_UNSURE * size
    if not is_told.any():
        times = math.sqrt(2.0) * pairs.noise / (MAX_UNSURE * float(size.max()))
        return (
            f"no load is large enough to be told from the noise of {100 * pairs.noise:.2g} %: take {times:.2g} times "
            "as much, or measure longer (seconds=); loads are in newtons, weights in grams."
        )
    multiple = np.nansum(change * expected, axis=(1, 2, 3))[is_told] / size[is_told] ** 2
    logs = np.log(np.maximum(multiple, 1e-9))
    if np.abs(logs).max() < math.log(MAX_TIMES):
        return None
    worst = int(np.abs(logs).argmax())
    name = pairs.names[int(np.flatnonzero(acts)[is_told][worst])]
    is_kgf = np.abs(np.abs(logs) - math.log(KGF_N)).max() < math.log(MAX_TIMES) and np.ptp(np.sign(logs)) == 0
    kgf = f" All loads seem to be {'too small' if logs[0] > 0 else 'too large'} by 9.8, as kgf are." if is_kgf else ""
    return (
        f"load '{name}' changed the resistances by {100 * max(multiple[worst], 0.0):.0f} % of what it should: is it on "
        f"the sensor, on that pad, and in newtons (grams for a weight)?{kgf}"
    )


def _of_contacts(data: Samples) -> str | None:
    """Say what decodes contacts, if the samples are such."""
    if data.made_from.get("protocol") != INDENT:
        return None
    return f"the protocol '{INDENT}' presses shapes, no loads on pads: 'tripillar train --touch' decodes these"


def _some(data: Samples, component: Component) -> Samples:
    """Samples that do not repeat each other, `MAX_JUDGED` at most."""
    data = data[Columns.of(data, component).distinct()]
    return data[np.linspace(0, len(data) - 1, min(MAX_JUDGED, len(data))).astype(int)]


@dataclass(frozen=True, eq=False)
class _Fit:
    """Samples beside what a model, joint or of the component's own pillars and forces, says of their readings."""

    data: Samples
    component: Component
    forward: SensorModel

    def turned(self, turn: Turn) -> "_Fit":
        """The same under other forces; as it is if the array is not square, or if no sensor bears such."""
        force_n = turn(self.data.force_n)
        possible = force_n.shape == self.data.force_n.shape and np.abs(force_n).max() <= MAX_N
        return replace(self, data=replace(self.data, force_n=force_n)) if possible else self

    @property
    def is_joint(self) -> bool:
        sizes = self.data.resistance_ohm[0].size, self.data.force_n[0].size
        return (self.forward.n_pillars, self.forward.n_forces) == sizes

    @cached_property
    def own(self) -> Columns:
        return Columns.of(self.data, self.component)

    @cached_property
    def moved(self) -> FloatArray:
        """Lengths of the readable pillars about their means, relative, (n, n_readable), as measured."""
        return _about_mean(np.sqrt(self.own.resistance_ohm)[:, self.own.readable])

    @cached_property
    def left(self) -> FloatArray:
        """What a fit of the forces leaves of these."""
        if self.is_joint:
            every, pillars = self.data.resistance_ohm.shape, self.component.pillars(self.data.layout)
            lengths = self.forward.lengths(force_columns(self.data.force_n, COMPONENTS["all"])).reshape(every)
            expected = lengths[..., pillars].reshape(len(lengths), -1)
        else:
            expected = self.forward.lengths(self.own.force_n)
        return residuals(self.moved, _about_mean(expected[:, self.own.readable]))

    @cached_property
    def energy(self) -> float:
        """The sum of squares of what is left, none below what a response is trusted to."""
        return float((self.left**2).sum() + self.left.size * (0.5 * MIN_NOISE) ** 2)

    @cached_property
    def explained(self) -> float | None:
        """As of `explained`."""
        relative = self.own.errors.total(self.own.resistance_ohm, *self.own.shape) / self.own.resistance_ohm
        noise = float((0.25 * relative[:, self.own.readable] ** 2).sum())
        signal = float((self.moved**2).sum()) - noise
        return 1.0 - max(float((self.left**2).sum()) - noise, 0.0) / signal if signal > noise else None

    def log_likelier(self, than: "_Fit") -> float:
        """Log likelihood ratio to another explanation of the same readings."""
        given = than.left
        covariance = given @ given.T if len(given) < given.shape[1] else given.T @ given
        squared = float((covariance**2).sum())
        directions = float(covariance.trace()) ** 2 / squared if squared > 0 else 1.0
        loads = 1 + max(load_numbers(one.data.force_n).max() for one in (self, than))  # some turn all into one
        return 0.5 * loads * directions * math.log(than.energy / self.energy)


def _mistaken(given: _Fit) -> str | None:
    """The mistake that explains the data best, if decidedly better than none."""
    unlinked = given.turned(lambda F: 0.0 * F)
    n_orders = math.factorial(len(given.data.layout.pillars)) - 1 if given.is_joint else 0
    others = {said: given.turned(turn) for said, turn in MISTAKES.items()} | (_in_best_order(given) if n_orders else {})
    enough, found = math.log(2.0 / FALSE_ALARMS), {}
    for said, other in others.items():
        likelier = min(other.log_likelier(than) for than in (given, unlinked))
        share = other.explained if likelier > math.log(len(MISTAKES) + n_orders) + enough else 0.0
        if share is None or share > MIN_EXPLAINED:
            found[said] = other.energy
    none = (
        "the readings fit the forces worse than if nothing linked them: give readings of this sensor, each beside its "
        "own load"
    )
    return min(found, key=found.__getitem__, default=none if unlinked.log_likelier(given) > enough else None)


def _in_best_order(given: _Fit) -> dict[str, _Fit]:
    """The order of pillars that explains the readings best, by a joint model; none if it is the stated one."""
    from scipy.optimize import linear_sum_assignment

    data, names, taken = given.data, given.data.layout.pillar_names, given.component.pillars(given.data.layout)
    every, shape = Columns.of(data, COMPONENTS["all"]), (len(data), -1, len(names))
    both = np.sqrt(every.resistance_ohm).reshape(shape), given.forward.lengths(every.force_n).reshape(shape)
    moved, expected = map(_about_mean, both)
    read = every.readable.reshape(shape[1:])
    left = [
        [(residuals(moved[..., k], expected[..., pillar])[:, read[:, k]] ** 2).sum() for k in range(len(names))]
        for pillar in taken
    ]
    found = dict(zip(taken, linear_sum_assignment(left)[1].tolist(), strict=True))
    others = (k for k in range(len(names)) if k not in found.values())
    order = [found[pillar] if pillar in found else next(others) for pillar in range(len(names))]
    if order == sorted(order):
        return {}
    as_read = ", ".join(names[order.index(k)] for k in range(len(names)))
    dead = None if data.dead is None else data.dead[..., order]
    mended = replace(given, data=replace(data, resistance_ohm=data.resistance_ohm[..., order], dead=dead))
    return {f"pillars seem to stand in the order {as_read}: a file's are {', '.join(names)}": mended}


def _about_mean(lengths: FloatArray) -> FloatArray:
    """Lengths (n, ...) about their means, relative."""
    return lengths / lengths.mean(axis=0) - 1.0


def _scattered(columns: FloatArray, data: Samples) -> bool:
    """Check whether readings (n, n_columns) of one load scatter more than noise; drifts may scatter them anyhow.

    The sum of N squared normal errors passes x N with a probability of exp(−N (x − 1 − ln x)/2) at most (Chernoff).
    """
    if data.errors.has_drift:
        return False
    size = columns.mean(axis=0)
    noise = ReadingError(noise=data.noise or UNSTATED_NOISE).deviation(size)
    steps = ReadingError(bits=data.bits).deviation(size)
    N = (len(columns) - 1) * columns.shape[1]
    x = float((((columns - size) / np.hypot(noise, EDGE * steps)) ** 2).sum()) / max(N, 1)
    return x > 1.0 and 0.5 * N * (x - 1.0 - math.log(x)) > math.log(1.0 / FALSE_ALARMS)


def _is_constant(columns: FloatArray) -> bool:
    return bool((np.ptp(columns, axis=0) <= CONSTANT * np.abs(columns).max(axis=0)).all())


def _alike(force_n: FloatArray) -> str:
    return "every force is the same in all samples" if force_n.any() else "every force is 0 N"
