"""Which load to measure next: the one after which forces are expected to err least (Bayesian A-optimal design).

Linear and normal about the most probable sensor. Unknown are the parameters of the design, the resistivity, and gain
and offset of each pillar. Corrections of the influence, which few pairs can tell, count as noise of the readings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.linalg import solve_triangular

from common.errors import FileFormatError
from common.threads import one_blas_thread
from dataset.measurement import ReadingError
from decoupler.data.columns import Component, force_columns
from decoupler.data.load_table import NOISE as READ_NOISE
from decoupler.data.load_table import UNITS_N, KnownLoad, known_forces, quantity_of
from decoupler.data.pairs import Pairs
from decoupler.twin.expectation import Expectation, State
from geometry.design import SensorDesign
from geometry.layout import FloatArray

MIN_NOISE = 1e-5  #: of readings to come, relative
USUAL = 24  #: usual loads over which the expected error is taken
#: what a kitchen has, see docs/decoder.md: buckets of water, one who stands on a lever, a pulley, a vacuum bag
KITCHEN = "pad:5kg,pad:15kg,pad:60kg,plate:20kg,plate:60kg,plate:120kg,string:3kg,string:12kg,air:30kPa,air:80kPa"
MEANS = {"pad": UNITS_N, "plate": UNITS_N, "string": UNITS_N | {"%": 0.01}, "air": {"kpa": 1.0}}
HAVE = "write kind:size such as pad:15kg, plate:20kg, string:3kg or string:20% and air:30kPa, separated by commas"


@dataclass(frozen=True, kw_only=True, eq=False)
class Knowledge:
    """Covariance of a sensor's u unknowns, each in standard deviations of its prior, about its most probable state."""

    expected: Expectation
    state: State
    covariance: FloatArray  #: (u, u)
    errors: ReadingError  #: of the readings to come

    @classmethod
    def before(cls, expected: Expectation, state: State, errors: ReadingError) -> Self:
        """Before any pair; linear about a state, the most probable one by all that is known."""
        covariance = np.eye(len(expected.names) + 1 + 2 * expected.n_pillars)
        return cls(expected=expected, state=state, covariance=covariance, errors=errors)

    def derivatives(self, force_n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives of the readings under a load (Q,) [N] by unknowns (P, u) [Ω] and by forces (P, Q) [Ω/N].

        And deviations of noise, converter's steps and what the unknowns do not explain, (P,) [Ω].
        """
        expected, widths, gain = self.expected, self.expected.widths, self.expected.gain(self.state)
        at = expected.sensor(self.state).under(force_n[None])
        c, ohms = at.sensor.ohm_per_mm2, at.resistance_ohm[0]
        shared, by_force = (
            c[:, None] * expected.by_parameters(at)[0],
            c[:, None] * at.along(np.eye(len(force_n))[None])[0],
        )
        own = np.diag(widths.gain * c * at.squares[0] / gain), np.diag(widths.offset * expected.rest_ohm)
        corrected_mm = np.hypot(widths.own, widths.shared) * np.linalg.norm(expected.sizes * at.state_n, axis=1)
        by_correction = c * np.linalg.norm(at.by_vector[0], axis=1) * corrected_mm * expected.reached
        misfit = widths.misfit * (ohms - at.sensor.linear.at_rest_ohm())
        deviation = np.sqrt(self.errors.deviation(ohms) ** 2 + by_correction**2 + misfit**2)
        return np.column_stack([shared, *own]), by_force, deviation

    def fall(self, force_n: FloatArray, unknown_n: FloatArray) -> FloatArray:
        """K, (u, P): a pair of a load (Q,), known but for directions (k, Q) [N], takes K Kᵀ off the covariance."""
        by_unknown, by_force, deviation = self.derivatives(force_n)
        H, J = by_unknown / deviation[:, None], (by_force @ unknown_n.T) / deviation[:, None]
        HC = H @ self.covariance
        S = HC @ H.T + J @ J.T
        S.flat[:: len(S) + 1] += 1.0
        return np.asarray(solve_triangular(np.linalg.cholesky(S), HC, lower=True, check_finite=False).T)

    def after(self, force_n: FloatArray, unknown_n: FloatArray) -> "Knowledge":
        """The same after a pair of that load."""
        K = self.fall(force_n, unknown_n)
        return replace(self, covariance=self.covariance - K @ K.T)

    def error_matrix(self, usual_n: FloatArray) -> FloatArray:
        """T, (u, u): tr(T · covariance) is the mean square error of the forces under usual loads (n, Q) [N].

        Errors of each axis are over the spread of its usual forces; needs as many pillars as forces at least.
        """
        usual_n = usual_n[np.linspace(0, len(usual_n) - 1, min(USUAL, len(usual_n))).astype(int)]
        n_axes = usual_n.shape[1] // self.expected.n_units
        size_n = np.sqrt((usual_n.reshape(-1, n_axes) ** 2).mean(axis=0))
        weight = np.tile(1.0 / np.maximum(size_n, 1e-9 * size_n.max()), self.expected.n_units)
        T = np.zeros_like(self.covariance)
        for force_n in usual_n:
            by_unknown, by_force, deviation = self.derivatives(force_n)
            if by_force.shape[0] == by_force.shape[1]:
                E = np.linalg.solve(by_force, by_unknown) * weight[:, None]
            else:
                E = np.linalg.lstsq(by_force / deviation[:, None], by_unknown / deviation[:, None])[0] * weight[:, None]
            T += E.T @ E / E.size * E.shape[1]
        return T / len(usual_n)


def choose(
    known: Knowledge, candidates: Sequence[tuple[FloatArray, FloatArray]], usual_n: FloatArray, count: int = 1
) -> tuple[list[int], list[float]]:
    """Candidates to measure, one after another, each once: every time that of the largest fall of the expected error.

    Candidates are forces (Q,) [N], and directions (k, Q) in which they may differ; usual loads are (n, Q) [N]. Given
    are numbers of candidates, and expected errors before the first and after each: root mean square over the forces,
    relative to the usual forces of their axis, of not knowing the sensor alone.
    """
    T = known.error_matrix(usual_n)
    numbers: list[int] = []
    errors = [float(np.sqrt(np.sum(T * known.covariance)))]
    for _ in range(count):
        left = [number for number in range(len(candidates)) if number not in numbers]
        if not left:
            break
        falls = [float(np.sum(K * (T @ K))) for K in (known.fall(*candidates[number]) for number in left)]
        numbers.append(left[int(np.argmax(falls))])
        known = known.after(*candidates[numbers[-1]])
        errors.append(float(np.sqrt(np.sum(T * known.covariance))))
    return numbers, errors


def loads_at_hand(have: str, design: SensorDesign) -> list[KnownLoad]:
    """Loads that can be made of what is at hand: each weight on every pad or on a plate, strings on each, air, nothing.

    Parameters
    ----------
    have : str
        Kinds and sizes such as ``plate:20kg,pad:15kg,string:3kg,air:30kPa``. A string pulls along x and along y on each
        weight that is heavier than its pull, which may be a percentage of the weight.
    design : SensorDesign

    Raises
    ------
    FileFormatError
        If the list makes no sense, or a load in it is more than a sensor bears.
    """
    sizes: dict[str, dict[str, float]] = {kind: {} for kind in MEANS}
    for part in have.split(","):
        kind, _, text = (word.strip() for word in part.partition(":"))
        size = quantity_of(text, MEANS[kind]) if kind in MEANS else None
        if size is None or not size > 0:
            raise FileFormatError(f"'{part.strip()}' is no load that one can have: {HAVE}.")
        sizes[kind][text] = size
    if sizes["string"] and not sizes["pad"] and not sizes["plate"]:
        raise FileFormatError(f"a string pulls on a weight: add pad:15kg or plate:20kg to '{have}'.")
    rows, cols = design.array.rows, design.array.cols
    pads = [{"kind": "pad", "row": str(row), "col": str(col)} for row in range(rows) for col in range(cols)]
    lines: list[dict[str, str]] = [{"load": "nothing", "kind": "nothing"}]
    for place in (*pads, {"kind": "plate"}):
        on = "a plate" if place["kind"] == "plate" else f"{place['row']} {place['col']}"
        for text, newtons in sizes[place["kind"]].items():
            pressed = place | {"load": f"{text} on {on}", "fz_n": repr(newtons)}
            lines.append(pressed)
            for pull, size in sizes["string"].items():
                pulled_n = size * newtons if pull.endswith("%") else size
                for axis in ("x", "y") if pulled_n < newtons else ():
                    name = f"string {pull} along {axis}, {pressed['load']}"
                    lines.append(pressed | {"load": name, f"f{axis}_n": repr(pulled_n), "error": "3 %"})
    for text, kpa in sizes["air"].items():
        air = {"load": f"{text} of air", "kind": "air", "kpa": repr(kpa), "error": "2 kPa", "share": "5 %"}
        lines.append(air)
    loads = [(line, known_forces(line, rows, cols, design.pad.size_mm**2, f"'{line['load']}'")) for line in lines]
    return [KnownLoad(name=line["load"], force_n=f, unknown_n=u, lines=(line,)) for line, (f, u) in loads]


def as_columns(load: KnownLoad, component: Component) -> tuple[FloatArray, FloatArray]:
    """Forces (Q,) and unknown directions (k, Q) of a load [N], along a component's axes."""
    return force_columns(load.force_n[None], component)[0], force_columns(load.unknown_n, component)


@dataclass(frozen=True, kw_only=True)
class NextLoad:
    """A load to measure, and the expected error of a force before and after it, over the usual force of its axis."""

    load: str
    error_before: float
    error: float


def next_loads(
    expected: Expectation,
    state: State,
    measured: Pairs | None,
    possible: Sequence[KnownLoad],
    usual_n: FloatArray,
    count: int,
) -> tuple[NextLoad, ...]:
    """Loads to measure next, in order; those that were measured are proposed no more.

    `expected` is the prior of the joint sensor (`all`), `state` its most probable state by the pairs, `usual_n`
    (n, rows, cols, 3) are usual loads [N].
    """
    noise, bits = (READ_NOISE, None) if measured is None else (max(measured.noise, MIN_NOISE), measured.bits)
    known = Knowledge.before(expected, state, ReadingError(noise=noise, bits=bits))
    everything = expected.component
    if measured is not None:
        for force_n, unknown_n in zip(force_columns(measured.force_n, everything), measured.unknown_n, strict=True):
            known = known.after(force_n, force_columns(unknown_n, everything))
        possible = [load for load in possible if load.name not in measured.names]
    candidates = [as_columns(load, everything) for load in possible]
    with one_blas_thread():  # products are too small for two threads to share
        numbers, errors = choose(known, candidates, force_columns(usual_n, everything), count)
    return tuple(
        NextLoad(load=possible[number].name, error_before=errors[k], error=errors[k + 1])
        for k, number in enumerate(numbers)
    )
