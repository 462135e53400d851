"""Equilibrium by Newton's method: of one load, in steps as large as converge, or of many by a tangent that is kept.

The pressure of each element is an iterate of its own: a step moves it to what the linearised volume asks for, and the
tangent takes it from there. With the pressure of the displacements instead, nearly incompressible rubber needs twice as
many iterations, because an iterate whose volume is off by a percent has a pressure off by λ / 100. A state whose
tangent has an eigenvalue below 0 is unstable, and is not taken.

No change takes more than a part of an element's volume: J → 0 at the edges of plates, where W grows like −ln J, and
Newton's method on a logarithm converges from the steep side only. The few elements that such an edge squeezes come to
rest by themselves before each step, or the whole body would wait for them.

With a tangent that is kept (the chord method) an iteration costs one evaluation of the forces and one solve. Alone such
iterations diverge at large loads; Anderson's acceleration takes of the last ones the combination whose change is least
(Walker & Ni, SIAM J. Numer. Anal. 49 (2011) 1715).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from fem.kernel.factor import Factor, FactorMemoryError, SolverError
from fem.kernel.loads import FollowerLoad, StiffLoad
from fem.kernel.reference import IntArray
from fem.kernel.rubber import Tangent
from fem.kernel.system import Misfit, State, System
from geometry.layout import FloatArray

RESIDUAL = 1e-9  #: of the loads, of an equilibrium
MAX_ITERATIONS = 18  #: of a step, before it is halved: more means that it wandered, perhaps to another branch
MAX_GROWTH = 1e4  #: of the residual within a step, before it is given up
MIN_STEP = 1 / 32  #: of the load, before it is refused
JUMPED = 0.1  #: of the work of the loads, which a step that went to another branch does not store
KEPT_VOLUME = 0.2  #: of every point's volume, at least, that a change leaves
DAMPINGS = 0.6 ** np.arange(12)  #: of a change that leaves less
SQUEEZED = 0.2  #: least J below which elements come to rest by themselves before each iteration
RESTS, RESTED = 25, 1e-6  #: iterations of these, and the unbalanced forces they leave, of the loads
#: of many loads by one tangent
DEPTH = 6  #: earlier iterates that are combined
MAX_CHANGE_GROWTH = 2.0  #: of the change that is asked for, before a step is halved
PRESSURE_MM_PER_MPA = 0.02  #: weight of pressures beside displacements where changes are measured
AT_ONCE = 40_000  #: points of integration whose stress is worked on at a time: more would leave the cache
NEARLY = 0.1  #: change below which displacements tell whether a sample is wanted at all

#: of the load factor that is reached and of the iterations of the next step so far; may raise `Stopped`
Seen = Callable[[float, int], None]
LoadPath = list[tuple[float, float, float]]  #: fractions of the full load f, g = f · u there [mJ], and its slope
Unwanted = Callable[[State], NDArray[np.bool_]]  #: states of m samples to booleans (m,): of those that need no answer


class Stopped(Exception):  # no error: it is asked for
    """Raised by who watches a search, to have the last load step that converged."""


class UnreachableLoadError(SolverError):
    """A load at which no equilibrium was found, or an unstable one only: of the body, not of an edge's elements."""

    def __init__(self, message: str, is_unstable: bool) -> None:
        super().__init__(message)
        self.is_unstable = is_unstable


@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """A body in equilibrium with its loads, or where the search for one ended."""

    state: State
    residual: float  #: unbalanced forces, relative to the loads
    least_j: float  #: least ratio of deformed to original volume at any point of integration
    iterations: int  #: of Newton's method, failed steps included
    #: True if its tangent is definite; None where nothing counts eigenvalues: pressures, moments, no PARDISO
    is_stable: bool | None = None
    steps: int = 0  #: load steps that converged
    stored_mj: float = 0.0  #: energy in the rubber
    work_mj: float = 0.0  #: of the loads; NaN where they have no potential
    load_factor: float = 1.0  #: below 1 where the search was stopped

    @property
    def is_found(self) -> bool:
        """Whether forces balance, and it is not known to be unstable."""
        return self.residual <= RESIDUAL and self.is_stable is not False

    @property
    def energy_imbalance(self) -> float:
        """Work of the loads less stored energy, relative; NaN where the loads have no potential."""
        return (self.work_mj - self.stored_mj) / self.stored_mj if self.stored_mj else 0.0


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Samples after their last iteration."""

    state: State
    change: FloatArray  #: last change of the plates' motion, relative, (m,); infinite before the first
    iterations: IntArray  #: (m,)


class _Iterate(NamedTuple):
    """Where a sample was, and the change that the tangent asked for there."""

    step: FloatArray
    change: FloatArray
    size: float  #: of the change


@dataclass(frozen=True, eq=False)
class Linearised:
    """A system's tangent at a state, in a factor: renewed by Newton's method, kept by the chord method.

    A step from that state is a vector: changes of the unknowns, then of the pressures.
    """

    system: System
    state: State
    factor: Factor
    parts: Tangent  #: of the elements

    @classmethod
    def at(
        cls, system: System, state: State, factor: Factor, load_factor: float = 1.0, misfit: Misfit | None = None
    ) -> "Linearised":
        """The tangent at any state under a fraction of the full load, which `factor` is left with."""
        misfit = misfit or system.misfit(state, load_factor)
        matrix, parts = system.tangent(state, load_factor, misfit.reactions)
        factor.factor(matrix)
        return cls(system, state, factor, parts)

    def changes(self, unbalanced: FloatArray, missing: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Changes of the unknowns by forces on them (m, n_blocks, 3), and of the pressures, of which these are missing.

        Jumping pressures have (m, n_elements, k). Of continuous ones (m, n_mixed) `missing` are those of `Misfit`.
        """
        m, n_mixed = len(unbalanced), self.system.n_mixed
        flat = np.hstack([unbalanced.reshape(m, -1), *([missing] if n_mixed else [])])
        y = self.factor.solve(np.ascontiguousarray(flat.T)).T
        motions = y[:, : y.shape[1] - n_mixed].reshape(unbalanced.shape)
        if n_mixed:
            return motions, y[:, -n_mixed:]
        nodal = self.system.nodal_change(self.state.rotation, motions)
        return motions, missing + self.parts.pressure_changes(nodal)

    def stepped(self, steps: FloatArray) -> State:
        """The deformed bodies after steps (m, n)."""
        base, m, n = self.state, len(steps), 3 * self.system.n_blocks
        copies = State(*(np.broadcast_to(part, (m, *part.shape)) for part in (base.u, base.p, base.shift, base.turn)))
        return self.system.moved(copies, steps[:, :n].reshape(m, -1, 3), steps[:, n:].reshape(copies.p.shape))

    def asked(self, steps: FloatArray, force_n: FloatArray) -> FloatArray:
        """Changes of steps (m, n) that balance forces (m, k, 3) on the plates [N]; of jumping pressures."""
        state, system, body = self.stepped(steps), self.system, self.system.body
        missing, forces = np.empty_like(state.p), np.empty_like(state.u)
        at_once = max(1, AT_ONCE // body.dx.size)
        for first in range(0, len(steps), at_once):
            some = slice(first, first + at_once)
            forces[some], strain, p = body.forces(state.u[some], state.p[some])
            missing[some] = body.pressures(strain.theta) - p
        forces += self.parts.pressed(missing)
        unbalanced = system.gathered(system.dead - forces, state.rotation)
        n, k = len(system.free), system.plates.count
        unbalanced[:, n : n + k] += force_n
        return np.hstack([part.reshape(len(steps), -1) for part in self.changes(unbalanced, missing)])

    def relaxed(
        self,
        force_n: FloatArray,
        tolerance: float,
        most: int,
        start: FloatArray | None = None,
        unwanted: Unwanted | None = None,
    ) -> Relaxed:
        """m samples under forces (m, k, 3) on the plates [N], until these move by less than a tolerance.

        Iterates from steps (m, n), or the tangent's own. A sample that has settled, or is not wanted, stays as it is,
        whatever the others need. A step that lets the forces grow, or turns an element inside out, is halved. A sample
        that does not settle ends with a change above the tolerance, after `most` iterations where it came closest.
        """
        m, n = len(force_n), 3 * self.system.n_blocks
        if start is None:
            start = np.zeros((m, n + self.state.p.size))
            start = start + self.asked(start, force_n)
        x, change, count = start.copy(), np.full(m, np.inf), np.zeros(m, dtype=np.int64)
        weight = np.ones(x.shape[1])
        weight[n:] = PRESSURE_MM_PER_MPA
        plates, shift = slice(3 * len(self.system.free), n), self.state.shift
        moved = np.concatenate([shift.ravel(), np.zeros(shift.size)])  # plates at the tangent's state
        seen, is_halved = [deque[_Iterate](maxlen=DEPTH + 1) for _ in range(m)], np.zeros(m, dtype=bool)
        going = np.arange(m)
        for _ in range(most):
            for sample, g in zip(going, self.asked(x[going], force_n[going]), strict=True):
                own = seen[sample]
                count[sample] += 1
                with np.errstate(over="ignore"):  # an iterate that runs away is halved
                    size = float(np.linalg.norm(g * weight))
                has_grown = len(own) > 0 and size > MAX_CHANGE_GROWTH * own[-1].size
                is_halved[sample] = has_grown or not np.isfinite(size)
                if is_halved[sample]:
                    x[sample] = (x[sample] + (own[-1].step if own else 0.0)) / 2
                    continue
                own.append(_Iterate(x[sample].copy(), g, size))
                step = _accelerated([*own], weight)
                x[sample] += step
                length = float(np.linalg.norm(moved + x[sample, plates])) or 1.0
                # both the step and what the tangent asks for: where one stagnates, the other does not
                change[sample] = max(float(np.linalg.norm(part[plates])) for part in (step, g)) / length
            going = going[change[going] > tolerance]
            if unwanted is not None and len(going):
                going = going[~(unwanted(self.stepped(x[going])) & (change[going] < NEARLY))]
            if not len(going):
                break
        for sample in going:
            if own := seen[sample]:
                best = min(own, key=lambda one: one.size)
                if is_halved[sample] or own[-1].size > best.size:
                    x[sample] = best.step
        return Relaxed(self.stepped(x), change, count)


def _accelerated(seen: list[_Iterate], weight: FloatArray) -> FloatArray:
    """Change from the last iterate to the combination of all, each with its change, whose change is least."""
    last = seen[-1]
    if len(seen) < 2:
        return last.change
    differences = last.change - np.stack([one.change for one in seen[:-1]])
    share = np.linalg.lstsq((differences * weight).T, weight * last.change, rcond=1e-6)[0]
    return np.asarray(last.change - share @ (differences + last.step - np.stack([one.step for one in seen[:-1]])))


def _work(path: LoadPath) -> float:
    """∫ s dg along a path of fractions s, with g a cubic in every step that has the known values and slopes."""
    s, g, d = np.array(path).T
    h = np.diff(s)
    below = h * (g[1:] + g[:-1]) / 2 + h**2 * (d[:-1] - d[1:]) / 12
    return float(s[-1] * g[-1] - below.sum())


def find_equilibrium(
    system: System, factor: Factor | None = None, first_step: float = 1.0, seen: Seen = lambda reached, iterations: None
) -> Equilibrium:
    """Load a body from rest to its full loads.

    A factor of the system's tangents can be used again; it is left with the last one. `seen` is called before every
    iteration, from a first load step of this size; where it raises `Stopped` after a step that converged, the answer is
    that step's. An `UnreachableLoadError` says which load was reached, the place that gave way, and what would help.
    """
    factor = factor or system.new_factor()
    state, reached, step = system.rest(), 0.0, first_step
    found, path = Equilibrium(state=state, residual=0.0, least_j=1.0, iterations=0, is_stable=True), LoadPath()
    if system.misfit(state, 1.0).size == 0.0:
        return found
    iterations = steps = 0
    while reached < 1.0:
        step = min(step, 1.0 - reached)
        last = found
        try:
            found = _equilibrium_at(system, factor, state, reached + step, path, partial(seen, reached))
        except Stopped:
            if not reached:
                raise
            found = replace(last, load_factor=reached)
            break
        iterations += found.iterations
        is_reached = found.is_found
        if is_reached:
            g, slope = system.own_displacement(found.state), system.slope(factor, found.state)
            ahead, stored = [*path, (reached + step, g, slope)], system.stored_mj(found.state)
            is_reached = not (system.symmetric and abs(_work(ahead) - stored) > JUMPED * stored)
        if not is_reached:
            step /= 2
            if step < MIN_STEP:
                raise _refusal(system, reached, found)
            found = last
            continue
        reached, state, path = reached + step, found.state, ahead
        steps, step = steps + 1, 2 * step
    work = _work(path) if system.symmetric else np.nan
    return replace(found, iterations=iterations, steps=steps, stored_mj=stored, work_mj=work)


def _equilibrium_at(
    system: System, factor: Factor, state: State, load_factor: float, path: LoadPath, seen: Callable[[int], None]
) -> Equilibrium:
    """Newton's method at one load, from a state in equilibrium with a smaller one; begins the path with its slope."""
    misfit = system.misfit(state, load_factor)
    start, before = misfit.residual, np.inf
    tangent: Linearised | None = None
    is_stable: bool | None = None
    for iteration in range(MAX_ITERATIONS + 1):
        seen(iteration)
        rested = _rested(system, state, load_factor, RESTED * misfit.size)
        if rested is not state:
            state, misfit = rested, system.misfit(rested, load_factor)
        if misfit.residual <= RESIDUAL:
            is_stable = system.is_stable(factor, state, load_factor, misfit)
            break
        if iteration == MAX_ITERATIONS or not misfit.residual <= MAX_GROWTH * max(start, 1.0):
            break
        chord = tangent is not None and misfit.residual**2 <= RESIDUAL * before  # the last tangent serves, taken twice
        if not chord:
            try:
                tangent = Linearised.at(system, state, factor, load_factor, misfit)
            except FactorMemoryError:
                raise
            except SolverError:
                break
        assert tangent is not None
        if not path:
            path.append((0.0, 0.0, system.slope(factor, state)))
        for _ in range(1 + chord):
            before = misfit.residual
            missing = misfit.pressures if system.body.is_mixed else misfit.pressures - state.p
            (motions,), (pressures,) = tangent.changes(misfit.unbalanced[None], missing[None])
            state = damped(system, state, motions, pressures)
            misfit = system.misfit(state, load_factor)
    residual, least_j = misfit.residual, misfit.least_j
    return Equilibrium(state=state, residual=residual, least_j=least_j, iterations=iteration, is_stable=is_stable)


def damped(system: System, state: State, change: FloatArray, pressures: FloatArray) -> State:
    """A state as far along a change as volumes allow."""
    least = KEPT_VOLUME * system.body.volume_ratios(state.u)
    for damping in DAMPINGS:
        trial = system.moved(state, change * damping, pressures * damping)
        if (least <= system.body.volume_ratios(trial.u)).all():
            break
    return trial


def _rested(system: System, state: State, load_factor: float, unbalanced_n: float) -> State:
    """The state with squeezed elements at rest among the others, to so much of unbalanced force; as it is in vain.

    They are what Newton's method takes most iterations for, and few (nonlinear elimination: Cai & Li, SIAM J. Sci.
    Comput. 33 (2011) 746). They rest in a minimum of the potential energy: negative eigenvalues of their tangent count
    as positive. Of jumping pressures and loads with a potential.
    """
    body = system.body
    if body.is_mixed or system.pressures.parts:
        return state
    squeezed = body.volume_ratios(state.u).min(axis=1) < SQUEEZED
    if not squeezed.any():
        return state
    touched = np.isin(body.nodes, body.nodes[squeezed]).any(axis=1)
    near, fixed = np.flatnonzero(touched), np.ones(body.n_nodes, dtype=bool)
    fixed[system.free[system.is_free[: len(system.free)].all(axis=1)]] = False
    fixed[body.nodes[~touched]] = True
    part, inside = body.part(near), np.setdiff1d(body.nodes[near], np.flatnonzero(fixed))
    number = np.full(body.n_nodes, -1)
    number[inside] = np.arange(len(inside))
    push, u, p, sizes = load_factor * system.dead, state.u.copy(), state.p[near], list[float]()

    def potential(u: FloatArray) -> float:
        return part.energy_mj(u) - float((push[inside] * u[inside]).sum())

    for _ in range(RESTS + 1):
        internal, _, asked = part.forces(u[None])
        unbalanced = (push - internal[0])[inside].ravel()
        sizes.append(float(np.linalg.norm(unbalanced)))
        parts = part.tangent(u, p)
        K = np.zeros((len(inside) + 1, len(inside) + 1, 3, 3))
        for (_, nodes, _), stiffness in zip(part.chunks, parts.blocks(), strict=True):
            for at, own in zip(number[nodes], stiffness, strict=True):
                K[at[:, None], at] += own  # of nodes that do not move too, which all are the last one
        matrix = K[:-1, :-1].swapaxes(1, 2).reshape(2 * (3 * len(inside),))
        values, modes = _unstable(matrix)
        settled = not sizes[-1] > unbalanced_n
        if len(sizes) > RESTS or (settled and not len(values)):
            break
        du, dp = np.zeros_like(u), np.zeros_like(p)
        if settled:  # on a saddle: off it, along the least stable mode
            mode = modes[:, 0].reshape(-1, 3)
            du[inside] = mode / mode.flat[np.abs(mode).argmax()] * np.ptp(body.points_mm[part.nodes[0]], axis=0).min()
        else:
            change = np.linalg.solve(matrix, unbalanced) - modes @ (2 / values * (modes.T @ unbalanced))
            du[inside] = change.reshape(-1, 3)
            dp = asked[0] - p + parts.pressure_changes(du[None])[0]
        least, energy = KEPT_VOLUME * part.volume_ratios(u), potential(u)
        for damping in DAMPINGS:
            trial = u + damping * du
            if (least <= part.volume_ratios(trial)).all() and potential(trial) <= energy:
                break
        u, p = trial, p + damping * dp
    if not sizes[-1] < sizes[0]:
        return state
    pressures = state.p.copy()
    pressures[near] = p
    return replace(state, u=u, p=pressures)


def _unstable(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Negative eigenvalues of a symmetric matrix (n, n), the least first, and their vectors, (n, k)."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return eigh(matrix, subset_by_value=(-np.inf, 0.0))
    return np.zeros(0), np.zeros((len(matrix), 0))


def _refusal(system: System, reached: float, worst: Equilibrium) -> UnreachableLoadError:
    j = system.body.volume_ratios(worst.state.u).min(axis=1)
    least, element = float(j.min()), int(j.argmin())
    x, y, z = system.body.centres_mm[element]
    mend = "bond a stiff plate to the patch, or take a smaller load"
    if all(isinstance(load, StiffLoad) for load in system.loads):
        mend = "take a smaller load or a stiffer rubber"
    elif any(isinstance(load, FollowerLoad) for load in system.loads):
        mend = "take a smaller load, a stiff plate in place of the pressure, or a coarser mesh at the patch's edge"
    what, at = "equilibrium", f"above {reached:.3g}" if reached else f"even under {MIN_STEP:.2g}"
    is_equilibrium = worst.residual <= RESIDUAL
    if is_equilibrium:
        what, mend = "stable equilibrium", f"it buckles or folds: {mend}, or make the body stouter"
    return UnreachableLoadError(
        f"no {what} {at} of the load: beyond, the element at x = {x:.4g}, y = {y:.4g}, z = {z:.4g} mm "
        f"gives way (smallest J {least:.2g}): {mend}.",
        is_unstable=is_equilibrium and least >= SQUEEZED,
    )
