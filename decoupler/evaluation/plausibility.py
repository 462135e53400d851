"""Checks whether readings and forces can belong together and to their sensor, and names the usual mistakes in files.

A data set is doubted if it fits the sensor's response decidedly better after a mistake is taken back, of `MISTAKES`,
in the order of pads or pillars, or in the size of forces, of all, an axis, a pad or some samples; or worse than if
nothing linked readings and forces. Of measured `Pairs` every load has to change its readings as it should.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import permutations

import numpy as np

from dataset import Samples
from dataset.measurement import ReadingError
from dataset.protocols import INDENT
from dataset.samples import FALSE_ALARMS
from dataset.variables import MAX_N
from decoupler.data.columns import COMPONENTS, MIN_NOISE, Columns, Component, force_columns, load_numbers
from decoupler.data.pairs import Pairs
from decoupler.inverse.sensor_model import SensorModel
from decoupler.training.suited import residuals, without_stuck
from geometry.layout import AXES, FloatArray, untold

MAX_JUDGED = 500  #: samples, spread over the data; more say no more of such mistakes
CONSTANT = 1e-12  #: range over size of a column that varies by rounding alone
UNSTATED_NOISE = 0.01  #: assumed of readings whose file states no noise: that of a poor board
KILOOHM = (3.0, 30.0)  #: range of readings that are of kΩ: no pillar of a sensor has so few ohms
#: smallest share of the readings' motion that the forces explain once a mistake is taken back: of contacts on bare
#: rubber, which no pad load explains, 0.3 to 0.6 with and without one
MIN_EXPLAINED = 0.7
OWN_EXPLAINED = 0.97  #: the same of a sensor as made, 0.985 and more; with pads of the other kind 0.92 to 0.95
EDGE = 3.0**0.5  #: deviation of a reading that hops between two steps, over that of one step
KGF_N = 9.80665  #: weight of a kilogram
MAX_TIMES = 2.0  #: largest ratio to the design, or its inverse; real sensors differ by less, wrong units by more
MAX_UNSURE = 0.2  #: largest relative standard deviation of a load as the sensor shows it; above, it cannot be judged
#: (unsure, sure): what the readings say of all forces, or of an axis', over what is stated; as made 0.76 to 1.33
OF_AXES = (1.38, 1.6)
OF_PAD = 1.2  #: the same of one pad beside the others, as made 0.95 to 1.08
MAX_PADS = 64  #: pads that are looked at one by one
PROBE_N, ROUNDS = 1.0, 5  #: change of forces by which the model is differentiated; of a search for multiples
STUCK = 0.03  #: most motion of a broken pillar over the expected one; under forces in kgf all have a tenth
CLEAR = (1.5, 100.0)  #: times the noise: what is left is less, what moved is more, where no mistake hides
TARE = 0.03  #: least size of what is added to all Fz, or of a pull, over their mean
OWN_NOISE = 1.15  #: largest energy that a sensor's own response leaves over that of noise; of one 2 % higher 1.3
#: newtons of what may have been written for one
UNITS = {"kN": 1e3, "mN": 1e-3, "grams": 1e-3 * KGF_N, "kgf": KGF_N, "taken for kgf": 1 / KGF_N, "lbf": 4.44822}
UNITS |= {"ounces": 0.278014, "halved": 2.0, "doubled": 0.5}
NOT_LINKED = (
    "the readings fit the forces worse than if nothing linked them: give readings of this sensor, each with its load"
)
Turn = Callable[[FloatArray], FloatArray]  #: of forces (n, rows, cols, 3), which takes a mistake back

PLACES: dict[str, Turn] = {  #: of pads, in forces or in readings as well
    "rows and columns of the {} seem to be exchanged: rows run along y": lambda F: F.swapaxes(1, 2),
    "rows of the {} seem to stand in reverse order: they begin at −y": lambda F: F[:, ::-1],
    "columns of the {} seem to stand in reverse order: they begin at −x": lambda F: F[:, :, ::-1],
}
MISTAKES: dict[str, Turn] = {said.format("forces"): turn for said, turn in PLACES.items()} | {
    f"axes seem to stand in the order {', '.join(AXES[order.index(k)] for k in range(3))}: a file's are "
    f"{', '.join(AXES)}": partial(np.take, indices=order, axis=-1)
    for order in [*permutations(range(3))][1:]
}


def doubt(data: Samples | Pairs, component: Component, forward: SensorModel | None) -> str | None:
    """Name the likely mistake in samples and how to mend it, in a line; None if there seems to be none.

    The model is of the sensor that the data are said to be of: joint (`all`), as pairs need, or of the component's own
    pillars and forces. Without it only contacts, forces that are constant and kΩ are noticed.

    Notes
    -----
    A mistake is likelier than none by (S₀/S)^(m/2): S are sums of squares of what the response leaves of the lengths,
    gain and slope of each pillar left free within reason, their errors normal and of unknown size. m is the number of
    loads times that of the directions in which the residuals spread: an error that pillars share counts once. Half of
    `FALSE_ALARMS` each is for readings that do not follow the forces and for all mistakes together. One pair, or
    readings that noise hides, say nothing and are never doubted.
    """
    if isinstance(data, Pairs):
        said = None if forward is None else _mistaken(_Fit.of_all(data, component, forward))
        return (
            said if forward is None or said not in (None, NOT_LINKED) else _of_loads(data, component, forward) or said
        )
    if said := _of_contacts(data):
        return said
    own = Columns.of(data := _some(data, component), component)
    columns = own.resistance_ohm[:, own.readable]
    if len(own) > 1 and _is_constant(own.force_n) and _scattered(columns, data):
        return f"{_alike(own.force_n)}, though the resistances differ by more than noise: give their loads"
    if forward is None and columns.size and KILOOHM[0] <= columns.min() <= columns.max() <= KILOOHM[1]:
        return f"all resistances are {columns.min():.3g} to {columns.max():.3g}, as in kΩ: give them in Ω, times 1000"
    if forward is None or not columns.size:
        return None
    times = float(np.median(columns) / np.median(forward.at_rest_ohm()))
    if round(math.log10(times) / 3):
        return f"the resistances are {times:.2g} times the design's: give them in Ω, or it the right resistivity_ohm_mm"
    return _mistaken(_Fit.of_all(data, component, forward))


def suspicion(data: Samples | Pairs, component: Component, forward: SensorModel | None) -> str | None:
    """Say in a line what looks wrong in samples that are not doubted, though a sensor may read so; None if nothing."""
    fit = None if forward is None else _Fit.of_all(data, component, forward)
    if fit is None or fit.explained is None:
        return None
    said = fit.of_axes(OF_AXES[0])
    if (share := (fit.scaled if said else fit).explained or 0.0) < OWN_EXPLAINED:
        more = f"{OWN_EXPLAINED:.0%} and more: are they of another? So read large strains, and contacts ('--touch')"
        return f"the design's response explains {max(share, 0.0):.0%} of these readings, of its own sensor's {more}"
    return said or fit.of_tare()


def nothing_to_learn(data: Samples, component: Component) -> str | None:
    """Say in a line that all samples are contacts, the same, or of the same load; None if they differ."""
    if said := _of_contacts(data):
        return said
    own = Columns.of(data, component)
    if len(own) > 1 and _is_constant(own.force_n):
        return f"{_alike(own.force_n)}: nothing can be learnt"
    is_constant = len(own) > 1 and _is_constant(own.resistance_ohm)
    return "every resistance is the same in all samples: nothing can be learnt" if is_constant else None


def disturbance(data: Samples, component: Component, forward: SensorModel | None) -> str | None:
    """Say in a line that forces other than the component's move its pillars; None if they do not.

    `forward` is joint (`all`); without it any such force is one too many.
    """
    acting = [axis for axis in AXES if axis not in component.axes and data.force_n[..., AXES.index(axis)].any()]
    if not acting:
        return None
    share, by_all = "", None if forward is None else _Fit(_some(data, component), component, forward)
    if by_all is not None and by_all.is_joint:
        by_own = by_all.turned(lambda F: F * [float(axis in component.axes) for axis in AXES])
        if not by_all.log_likelier(by_own) > math.log(1.0 / FALSE_ALARMS):
            return None
        share = f" ({1.0 - by_all.energy / by_own.energy:.0%} of what {component.name} leaves unexplained is theirs)"
    tells_all = data.design is None or not untold(data.design.unit)
    mend = "use the component 'all'" if tells_all else "take samples without them, or a layout that tells them"
    said = f"forces along {' and '.join(acting)} act as well and move the same pillars{share}"
    return f"{said}: they become errors of {component.name}; {mend}"


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
            f"design's resistivity{unit}"
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
        times = math.sqrt(2.0) * pairs.noise / (MAX_UNSURE * max(float(size.max()), 1e-15))
        return (
            f"no load is large enough to be told from the noise of {100 * pairs.noise:.2g} %: take {times:.2g} times "
            "as much, or measure longer (seconds=); loads are in newtons, weights in grams"
        )
    multiple = np.nansum(change * expected, axis=(1, 2, 3))[is_told] / size[is_told] ** 2
    logs = np.log(np.maximum(multiple, 1e-9))
    if np.abs(logs).max() < math.log(MAX_TIMES):
        return None
    worst = int(np.abs(logs).argmax())
    name = pairs.names[int(np.flatnonzero(acts)[is_told][worst])]
    is_kgf = np.abs(np.abs(logs) - math.log(KGF_N)).max() < math.log(MAX_TIMES) and np.ptp(np.sign(logs)) == 0
    kgf = f"; all loads seem to be {'too small' if logs[0] > 0 else 'too large'} by 9.8, as kgf are" if is_kgf else ""
    return (
        f"load '{name}' changed the resistances by {100 * max(multiple[worst], 0.0):.0f} % of what it should: put it "
        f"on the sensor, on that pad, and state it in newtons, weights in grams{kgf}"
    )


def _of_contacts(data: Samples) -> str | None:
    """Say what decodes contacts, if the samples are such."""
    said = f"the protocol '{INDENT}' presses shapes, no loads on pads: 'tripillar train --touch' decodes these"
    return said if data.made_from.get("protocol") == INDENT else None


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

    @classmethod
    def of_all(cls, data: Samples | Pairs, component: Component, forward: SensorModel) -> "_Fit":
        """Of all pillars that move, where the model is joint: those that the component does not take tell more."""
        data = _some(data.labelled(MAX_UNSURE) if isinstance(data, Pairs) else data, component)
        fit = cls(data, component, forward)
        still = ~(np.ptp(data.resistance_ohm, axis=0) > 0)
        still[..., component.pillars(data.layout)] = False
        data, named = replace(data, dead=still | data.is_dead), COMPONENTS["all"] if fit.is_joint else component
        stuck = without_stuck(Columns.of(data, named), forward, STUCK).dead
        whole = replace(data, dead=data.is_dead | (stuck & ~stuck.all(axis=(0, 1))))  # one in all units is misplaced
        return replace(fit, data=whole, component=named)

    def turned(self, turn: Turn, place: Turn = lambda R: R) -> "_Fit":
        """The same under other forces, of readings in other places; as it is if no array or sensor bears such."""
        data, force_n = self.data, turn(self.data.force_n)
        if force_n.shape != data.force_n.shape or np.abs(force_n).max() > MAX_N:
            return self
        dead = place(data.is_dead[None].astype(float))[0] > 0.0
        return replace(self, data=replace(data, force_n=force_n, resistance_ohm=place(data.resistance_ohm), dead=dead))

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
    def labels(self) -> FloatArray:
        """The forces that the model takes, (n, n_forces) [N]."""
        return force_columns(self.data.force_n, COMPONENTS["all"]) if self.is_joint else self.own.force_n

    def lengths(self, force_n: FloatArray) -> FloatArray:
        """Lengths of the readable pillars under such forces, (n, n_readable) [mm]."""
        lengths = self.forward.lengths(force_n)
        if self.is_joint:
            every, pillars = self.data.resistance_ohm.shape[1:], self.component.pillars(self.data.layout)
            lengths = lengths.reshape(-1, *every)[..., pillars].reshape(len(lengths), -1)
        return lengths[:, self.own.readable]

    @cached_property
    def left(self) -> FloatArray:
        """What a fit of the forces leaves of these."""
        return residuals(self.moved, _about_mean(self.lengths(self.labels)))

    @cached_property
    def energy(self) -> float:
        """The sum of squares of what is left, none below what a response is trusted to."""
        return float((self.left**2).sum() + self.left.size * (0.5 * MIN_NOISE) ** 2)

    @cached_property
    def noise(self) -> float:
        """The sum of squares that the stated noise leaves."""
        relative = self.own.errors.total(self.own.resistance_ohm, *self.own.shape) / self.own.resistance_ohm
        return float((0.25 * relative[:, self.own.readable] ** 2).sum())

    @cached_property
    def explained(self) -> float | None:
        """Share of what the readings do beyond their stated noise that the model foretells; None if noise hides it."""
        signal = float((self.moved**2).sum()) - self.noise
        left = max(float((self.left**2).sum()) - self.noise, 0.0)
        return 1.0 - left / signal if signal > self.noise else None

    def log_likelier(self, than: "_Fit") -> float:
        """Log likelihood ratio to another explanation of the same readings."""
        given = than.left
        covariance = given @ given.T if len(given) < given.shape[1] else given.T @ given
        squared = float((covariance**2).sum())
        directions = float(covariance.trace()) ** 2 / squared if squared > 0 else 1.0
        loads = 1 + max(load_numbers(one.data.force_n).max() for one in (self, than))  # some turn all into one
        return 0.5 * loads * directions * math.log(than.energy / self.energy)

    def multiples(self, groups: FloatArray) -> FloatArray:
        """Multiples of k groups of forces (k, n_forces) that the readings show, (k,); 1 of groups that do not vary."""
        change = self.labels - self.labels.mean(axis=0)
        step = PROBE_N / max(float(np.abs(change).max()), 1e-9)
        apart = [self.lengths(step * change * group) / self.lengths(-step * change * group) for group in groups]
        E = (np.log(apart) / (2.0 * step)).reshape(len(groups), -1)
        G, found = E @ E.T, np.zeros(len(E))
        tells = np.diag(G) > CONSTANT * np.diag(G).max()
        to_found = np.linalg.pinv(G[np.ix_(tells, tells)]) @ E[tells]
        for _ in range(ROUNDS):  # from rest on, where forces of any unit find their size
            left = self.moved - _about_mean(self.lengths(self.labels * (found @ groups)))
            found[tells] += to_found @ left.ravel()
        return np.where(tells, found, 1.0)

    @cached_property
    def times(self) -> FloatArray:
        """Multiples of the forces along x, y and z that the readings show, (3,)."""
        axes, times = AXES if self.is_joint else self.component.axes, np.ones(len(AXES))
        of_all = self.multiples(np.tile(np.eye(len(axes)), self.labels.shape[1] // len(axes)))
        times[[axis in axes for axis in AXES]] = of_all
        return times

    @cached_property
    def scaled(self) -> "_Fit":
        """The same under these multiples of its forces."""
        return self.turned(lambda F: F * self.times)

    def of_axes(self, limit: float) -> str | None:
        """Name the axes whose forces, or all whose forces, are another multiple than a limit allows."""
        acts, times = np.ptp(self.data.force_n, axis=(0, 1, 2)) > 0, self.times
        off = acts & (np.abs(times) > CONSTANT) & ((times < 1.0 / limit) | (times > limit))  # 0: none shows
        if off.sum() == acts.sum() > 0 and np.ptp(times[acts]) < (OF_PAD - 1.0) * np.abs(times[acts]).max():
            return self.said("all forces", times[acts].mean())
        return "; ".join(self.said(f"forces along {AXES[k]}", times[k]) for k in np.flatnonzero(off)) or None

    def said(self, what: str, times: float) -> str:
        """What forces are beside what readings say, `times` as much, and how to mend it."""
        if times < 0 and 1.0 / OF_AXES[0] < -times < OF_AXES[0]:
            return f"{what} seem to have the other sign: z > 0 is compression, x runs along columns, y along rows"
        units = UNITS if self.data.design is None else UNITS | {"MPa": self.data.design.pad.size_mm**2}
        name = min(units, key=lambda unit: abs(math.log(units[unit] / max(abs(times), CONSTANT))))
        is_near = 1.0 / OF_PAD < abs(times) / units[name] < OF_PAD
        by, guess = (math.copysign(units[name], times), f" {name}?") if is_near else (times, "")
        unless = f", or give the design rubber {1.0 / times:.2g} times as stiff" if what == "all forces" else ""
        return f"{what} are {1.0 / times:.3g} of what the readings say:{guess} multiply by {by:.4g}{unless}"

    def by_pads(self) -> "dict[str, _Fit]":
        """Without other multiples of single pads' forces than the others', said."""
        rows, cols = self.data.shape
        groups = np.repeat(np.eye(rows * cols), self.labels.shape[1] // (rows * cols), axis=1)
        times = self.scaled.multiples(groups).reshape(rows, cols, 1)
        times /= np.sort(times, axis=None)[times.size // 2]  # the mean of two kinds is of neither
        off = (times < 1.0 / OF_PAD) | (times > OF_PAD)
        said = "; ".join(self.said(f"forces of pad {i}/{j} (row/col)", times[i, j, 0]) for i, j, _ in np.argwhere(off))
        return {said: self.scaled.turned(lambda F: F * np.where(off, times, 1.0))} if said else {}

    def by_samples(self) -> "dict[str, _Fit]":
        """Without another multiple of the forces of some samples, which are all alike, said."""
        rest, lengths = self.lengths(0.0 * self.labels[:1]), np.sqrt(self.own.resistance_ohm[:, self.own.readable])
        moved = self.lengths(self.labels) / rest - 1.0
        size, usual, alike = (moved**2).sum(axis=1), 1.0, np.ones(len(moved), dtype=bool)
        for _ in range(ROUNDS):
            at_rest = np.median((lengths / (1.0 + usual * moved))[alike], axis=0)
            times = ((lengths / at_rest - 1.0) * moved).sum(axis=1) / np.maximum(size, CONSTANT)
            usual = float(np.sort(times)[len(times) // 2])  # of one sample: the mean of two kinds is of neither
            alike = np.abs(times - usual) <= 0.3 * abs(usual)
        more = times**2 > np.percentile(times, [2, 98]).prod()
        if times.min() <= 0.0 or more.all() or not more.any():  # or noise, a sign or rest hides how much
            return {}
        ratio = float(np.median(times[more]) / np.median(times[~more]))
        mended = self.turned(lambda F: F * np.where(more, ratio, 1.0)[:, None, None, None])
        wrong, by = (more, ratio) if mended.of_axes(OF_AXES[1]) is None else (~more, 1.0 / ratio)
        said = self.said(f"forces of {wrong.mean():.0%} of the samples", by)
        return {said: mended.scaled} if ratio > OF_AXES[1] else {}

    def of_tare(self) -> str | None:
        """Say what was added to all Fz, if it pulls most pads, or if without it no more than noise is left."""
        fz, was_tared = self.data.force_n[..., 2], "was the load cell tared under load?"
        typical, lowest, highest = np.abs(fz).mean(), np.median(fz.min(axis=0)), np.median(fz.max(axis=0))
        if lowest < -TARE * typical and not 0.5 < highest / -lowest < 2.0:
            return f"Fz falls to {lowest:.3g} N on most pads, which pulls them: {was_tared}"
        added, step, mended = 0.0, TARE * typical, self.scaled
        for _ in range(ROUNDS if np.ptp(fz) else 0):
            mended, more = (self.turned(partial(np.add, [0.0, 0.0, n])).scaled for n in (added, added + step))
            slope = (more.left - mended.left) / step
            added -= (mended.left * slope).sum() / max((slope**2).sum(), CONSTANT)
        is_own = mended.energy < OWN_NOISE * (mended.energy - (mended.left**2).sum() + mended.noise)
        is_own &= mended.log_likelier(self.scaled) > math.log(1.0 / FALSE_ALARMS)
        said = f"{-added:.3g} N seem to be added to all Fz, unless pads or rubber differ: {was_tared}"
        return said if is_own and abs(added) > step else None


def _mistaken(given: _Fit) -> str | None:
    """The mistake that explains the data best, if decidedly better than none; none is sought in noise."""
    if (given.left**2).sum() <= CLEAR[0] * given.noise <= (given.moved**2).sum() * CLEAR[0] / CLEAR[1]:
        return None
    unlinked, n_pads = given.turned(lambda F: 0.0 * F), math.prod(given.data.shape)
    others = {said: given.turned(turn) for said, turn in MISTAKES.items()}
    others |= {said.format("readings and forces"): given.turned(turn, turn) for said, turn in PLACES.items()}
    if said := given.of_axes(OF_AXES[1]):
        others[said] = given.scaled
    others |= given.by_samples()
    kinds, names = [(others, len(others))], given.data.layout.pillar_names  # mended fits, and of how many
    if given.is_joint:
        kinds.append((_in_best_order(given, 2, names), math.factorial(len(names))))
    if 1 < n_pads <= MAX_PADS:
        names = tuple(f"{row}/{col}" for row, col in np.ndindex(given.data.shape))
        kinds.append((given.by_pads() | _in_best_order(given, 1, names), math.factorial(n_pads)))
    enough, found = math.log(2.0 / FALSE_ALARMS), {}
    for others, number in kinds:
        for said, other in others.items():
            likelier = min(other.log_likelier(than) for than in (given, unlinked))
            share = other.explained if likelier > math.log(number) + enough else 0.0
            if share is None or share > MIN_EXPLAINED:
                found[said] = other.energy
    return min(found, key=found.__getitem__, default=NOT_LINKED if unlinked.log_likelier(given) > enough else None)


def _in_best_order(given: _Fit, axis: int, names: Sequence[str]) -> dict[str, _Fit]:
    """The order of pads (axis 1) or pillars (2) that explains the readings best; none if it is the stated one."""
    from scipy.optimize import linear_sum_assignment

    readable = given.own.readable
    pads = readable.reshape(math.prod(given.data.shape), -1)
    both = np.zeros((2, len(given.data), *pads.shape))
    both.reshape(*both.shape[:2], -1)[..., readable] = given.moved, _about_mean(given.lengths(given.labels))
    (moved, expected), told = np.moveaxis(both, axis + 1, 1), np.moveaxis(pads, axis - 1, 0)
    left = [[(residuals(m, e)[:, t] ** 2).sum() for m, t in zip(moved, told, strict=True)] for e in expected]
    order = linear_sum_assignment(left)[1].tolist()
    wrong = [k for k in range(len(names)) if order[k] != k]
    mended = given.turned(lambda F: F, lambda R: R.reshape(len(R), len(pads), -1).take(order, axis).reshape(R.shape))
    as_read, meant = (", ".join(names[k] for k in each) for each in ((order.index(k) for k in wrong), wrong))
    what = "pads" if axis == 1 else "pillars"
    return {f"{what} seem to stand in the order {as_read}: a file's are {meant}": mended} if wrong else {}


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
