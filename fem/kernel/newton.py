"""Equilibrium under growing loads by Newton's method, in steps as large as converge.

The pressure of each element is an iterate of its own: a step moves it to what the linearised volume asks for, and the
tangent takes it from there. With the pressure of the displacements instead, nearly incompressible rubber needs twice as
many iterations, because an iterate whose volume is off by a percent has a pressure off by λ / 100. A state whose
tangent has an eigenvalue below 0 is unstable, and is not taken.

No change takes more than a part of an element's volume: J → 0 at the edges of plates, where W grows like −ln J, and
Newton's method on a logarithm converges from the steep side only. The few elements that such an edge squeezes come to
rest by themselves before each step, or the whole body would wait for them.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import eigh

from fem.kernel.factor import Factor, FactorMemoryError, SolverError
from fem.kernel.loads import FollowerLoad, StiffLoad
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


class UnreachableLoadError(SolverError):
    """A load at which no equilibrium was found, or an unstable one only: of the body, not of an edge's elements."""

    def __init__(self, message: str, is_unstable: bool) -> None:
        super().__init__(message)
        self.is_unstable = is_unstable


@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """A body in equilibrium with its loads."""

    state: State
    residual: float  #: unbalanced forces, relative to the loads
    least_j: float  #: least ratio of deformed to original volume at any point of integration
    iterations: int  #: of Newton's method, failed steps included
    steps: int  #: load steps that converged
    stored_mj: float  #: energy in the rubber
    work_mj: float  #: of the loads; NaN where they have no potential
    #: True if its tangent is definite; None where nothing counts eigenvalues: pressures, moments, no PARDISO
    is_stable: bool | None = None

    @property
    def energy_imbalance(self) -> float:
        """Work of the loads less stored energy, relative; NaN where the loads have no potential."""
        return (self.work_mj - self.stored_mj) / self.stored_mj if self.stored_mj else 0.0


@dataclass(frozen=True, eq=False)
class Linearised:
    """A system's tangent at a state, in a factor: Newton's method renews it, the chord method (`chord.py`) keeps it."""

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

    def solve(self, unbalanced: FloatArray) -> FloatArray:
        """Changes of the unknowns (m, n_blocks, 3) by forces on them, of the same shape; no continuous pressures."""
        flat = np.ascontiguousarray(unbalanced.reshape(len(unbalanced), -1).T)
        return self.factor.solve(flat).T.reshape(unbalanced.shape)

    def changes(self, unbalanced: FloatArray, missing: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Changes of the unknowns, and of jumping pressures (m, n_elements, k) of which these are missing."""
        motions = self.solve(unbalanced)
        nodal = self.system.nodal_change(self.state.rotation, motions)
        return motions, missing + self.parts.pressure_changes(nodal)

    def balancing(self, state: State, misfit: Misfit) -> tuple[FloatArray, FloatArray]:
        """Changes of the unknowns (n_blocks, 3) and of the pressures of one state that balance its forces."""
        if not self.system.body.is_mixed:
            motions, pressures = self.changes(misfit.unbalanced[None], (misfit.pressures - state.p)[None])
            return motions[0], pressures[0]
        both = self.factor.solve(np.concatenate([misfit.unbalanced.ravel(), misfit.pressures])[:, None])[:, 0]
        return both[: -self.system.n_mixed].reshape(-1, 3), both[-self.system.n_mixed :]


@dataclass(eq=False)
class _Path:
    """The load's own displacement g = f · u along the load, for the work ∫ s dg; f is the full load."""

    load_factor: list[float] = field(default_factory=lambda: [0.0])
    value: list[float] = field(default_factory=lambda: [0.0])
    slope: list[float] = field(default_factory=list)

    def to(self, load_factor: float, value: float, slope: float) -> "_Path":
        """The path one step farther."""
        return _Path([*self.load_factor, load_factor], [*self.value, value], [*self.slope, slope])

    def work(self) -> float:
        """∫ s dg, with g a cubic in every step that has the known values and slopes at its ends."""
        s, g, d = (np.array(v) for v in (self.load_factor, self.value, self.slope))
        h = np.diff(s)
        below = h * (g[1:] + g[:-1]) / 2 + h**2 * (d[:-1] - d[1:]) / 12
        return float(s[-1] * g[-1] - below.sum())


@dataclass(frozen=True, eq=False)
class _Tried:
    state: State
    misfit: Misfit
    iterations: int
    is_stable: bool | None  #: of an equilibrium

    @property
    def converged(self) -> bool:
        return self.misfit.residual <= RESIDUAL and self.is_stable is not False


def find_equilibrium(system: System, factor: Factor | None = None) -> Equilibrium:
    """Load a body from rest to its full loads.

    A factor of the system's tangents can be used again; it is left with the last one. An `UnreachableLoadError` says
    which load was reached, the place that gave way, and what would help.
    """
    factor = factor or system.new_factor()
    state, reached, step = system.rest(), 0.0, 1.0
    path, tried = _Path(), None
    iterations = steps = 0
    if system.misfit(state, 1.0).size == 0.0:
        return Equilibrium(
            state=state, residual=0.0, least_j=1.0, iterations=0, steps=0, stored_mj=0.0, work_mj=0.0, is_stable=True
        )
    while reached < 1.0:
        step = min(step, 1.0 - reached)
        tried = _equilibrium_at(system, factor, state, reached + step, path)
        iterations += tried.iterations
        ahead = path
        if tried.converged:
            ahead = path.to(reached + step, system.own_displacement(tried.state), system.slope(factor, tried.state))
        stored = system.stored_mj(tried.state) if tried.converged else np.nan
        if not tried.converged or (system.symmetric and abs(ahead.work() - stored) > JUMPED * stored):
            step /= 2
            if step < MIN_STEP:
                raise _refusal(system, reached, tried)
            continue
        reached, state, path = reached + step, tried.state, ahead
        steps, step = steps + 1, 2 * step
    assert tried is not None  # the load is not 0
    return Equilibrium(
        state=state,
        residual=tried.misfit.residual,
        least_j=tried.misfit.least_j,
        iterations=iterations,
        steps=steps,
        stored_mj=stored,
        work_mj=path.work() if system.symmetric else np.nan,
        is_stable=tried.is_stable,
    )


def _equilibrium_at(system: System, factor: Factor, state: State, load_factor: float, path: _Path) -> _Tried:
    """Newton's method at one load, from a state in equilibrium with a smaller one."""
    misfit = system.misfit(state, load_factor)
    start, before = misfit.residual, np.inf
    tangent: Linearised | None = None
    for iteration in range(MAX_ITERATIONS + 1):
        rested = _rested(system, state, load_factor, RESTED * misfit.size)
        if rested is not state:
            state, misfit = rested, system.misfit(rested, load_factor)
        if misfit.residual <= RESIDUAL:
            return _Tried(state, misfit, iteration, system.is_stable(factor, state, load_factor, misfit))
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
        if not path.slope:
            path.slope.append(system.slope(factor, state))
        for _ in range(1 + chord):
            before = misfit.residual
            state = _damped(system, state, *tangent.balancing(state, misfit))
            misfit = system.misfit(state, load_factor)
    return _Tried(state, misfit, iteration, None)


def _damped(system: System, state: State, change: FloatArray, pressures: FloatArray) -> State:
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


def _refusal(system: System, reached: float, worst: _Tried) -> UnreachableLoadError:
    j = system.body.volume_ratios(worst.state.u).min(axis=1)
    least, element = float(j.min()), int(j.argmin())
    x, y, z = system.body.centres_mm[element]
    mend = "bond a stiff plate to the patch, or take a smaller load"
    if all(isinstance(load, StiffLoad) for load in system.loads):
        mend = "take a smaller load or a stiffer rubber"
    elif any(isinstance(load, FollowerLoad) for load in system.loads):
        mend = "take a smaller load, a stiff plate in place of the pressure, or a coarser mesh at the patch's edge"
    what = "equilibrium"
    is_equilibrium = worst.misfit.residual <= RESIDUAL
    if is_equilibrium:
        what, mend = "stable equilibrium", f"it buckles or folds: {mend}, or make the body stouter"
    return UnreachableLoadError(
        f"no {what} above {reached:.3g} of the load: beyond, the element at x = {x:.4g}, y = {y:.4g}, z = {z:.4g} mm "
        f"gives way (smallest J {least:.2g}): {mend}.",
        is_unstable=is_equilibrium and least >= SQUEEZED,
    )
