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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, eigsh

from fem.equations import Misfit, State
from fem.kernel.factor import Factor, FactorMemoryError, SolverError
from fem.kernel.loads import FollowerLoad, StiffLoad
from fem.system import System
from fem.tetrahedra.system import TetrahedralSystem
from geometry.layout import FloatArray

RESIDUAL = 1e-9  #: of the loads, of an equilibrium
MAX_ITERATIONS = 18  #: of a step, before it is halved: more means that it wandered, perhaps to another branch
MAX_GROWTH = 1e4  #: of the residual within a step, before it is given up
MIN_STEP = 1 / 32  #: of the load, before it is refused
KEPT_VOLUME = 0.2  #: of every Gauss point's volume, at least, that a change leaves
DAMPING, DAMPINGS = 0.6, 12  #: factor of a change that leaves less, and how often
SQUEEZED = 0.2  #: least J below which elements come to rest by themselves before each iteration
RESTS, RESTED = 25, 1e-6  #: iterations of these, and the unbalanced forces they leave, of the loads
STIFFENINGS = (0.05, 0.2, 0.8, 1.0)  #: shares of the negative eigenvalues of their moduli that are left out, if need be

AnySystem = System | TetrahedralSystem


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
    least_j: float  #: least ratio of deformed to original volume at any Gauss point
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


@dataclass(eq=False)
class _Path:
    """The load's own displacement g = f · u along the load, for the work ∫ s dg; f is the full load."""

    share: list[float] = field(default_factory=lambda: [0.0])
    value: list[float] = field(default_factory=lambda: [0.0])
    slope: list[float] = field(default_factory=list)

    def work(self) -> float:
        """∫ s dg, with g a cubic in every step that has the known values and slopes at its ends."""
        s, g, d = (np.array(v) for v in (self.share, self.value, self.slope))
        h = np.diff(s)
        below = h * (g[1:] + g[:-1]) / 2 + h**2 * (d[:-1] - d[1:]) / 12
        return float(s[-1] * g[-1] - below.sum())


def find_equilibrium(system: AnySystem, factor: Factor | None = None, first_step: float = 1.0) -> Equilibrium:
    """Load a body from rest to its full loads, trying a first share of them.

    A factor of the system's tangents can be used again; it is left with the last one. An `UnreachableLoadError` says
    which load was reached, the place that gave way, and what would help.
    """
    factor = factor or system.new_factor()
    state, share, step = system.rest(), 0.0, first_step
    path = _Path()
    iterations = steps = 0
    tried: _Tried | None = None
    if system.misfit(state, 1.0).size == 0.0:
        return Equilibrium(
            state=state, residual=0.0, least_j=1.0, iterations=0, steps=0, stored_mj=0.0, work_mj=0.0, is_stable=True
        )
    while share < 1.0:
        step = min(step, 1.0 - share)
        tried = _equilibrium_at(system, factor, state, share + step, path)
        iterations += tried.iterations
        if not tried.converged:
            step /= 2
            if step < MIN_STEP:
                raise _refusal(system, share, tried)
            continue
        share, state = share + step, tried.state
        path.share.append(share)
        path.value.append(system.own_displacement(state))
        path.slope.append(system.slope(factor, state))
        steps, step = steps + 1, 2 * step
    assert tried is not None  # the load is not 0
    return Equilibrium(
        state=state,
        residual=tried.misfit.residual,
        least_j=tried.misfit.least_j,
        iterations=iterations,
        steps=steps,
        stored_mj=system.stored_mj(state),
        work_mj=path.work() if system.symmetric else np.nan,
        is_stable=tried.is_stable,
    )


@dataclass(frozen=True, eq=False)
class _Tried:
    state: State
    misfit: Misfit
    iterations: int
    is_stable: bool | None  #: of an equilibrium

    @property
    def converged(self) -> bool:
        return self.misfit.residual <= RESIDUAL and self.is_stable is not False


def _equilibrium_at(system: AnySystem, factor: Factor, state: State, share: float, path: _Path) -> _Tried:
    """Newton's method at one load, from a state in equilibrium with a smaller one."""
    misfit = system.misfit(state, share)
    start, before = misfit.residual, np.inf
    tangent: _Linearised | None = None
    for iteration in range(MAX_ITERATIONS + 1):
        squeezed = system.volume_ratios(state).min(axis=1) < SQUEEZED
        if isinstance(system, System) and not len(system.faces.nodes) and squeezed.any():
            state = _with_rested(system, state, share, squeezed, RESTED * misfit.size)
            misfit = system.misfit(state, share)
        if misfit.residual <= RESIDUAL:
            return _Tried(state, misfit, iteration, system.is_stable(factor, state, share, misfit))
        if iteration == MAX_ITERATIONS or not misfit.residual <= MAX_GROWTH * max(start, 1.0):
            break
        ends = tangent is not None and misfit.residual**2 <= RESIDUAL * before  # by the last tangent, taken twice
        try:
            if not ends:
                tangent = _linearised(system, factor, state, share, misfit, squeezed)
        except FactorMemoryError:
            raise
        except SolverError:
            break
        if not path.slope:
            path.slope.append(system.slope(factor, state))
        if tangent is None:
            break
        for _ in range(1 + ends):
            before, state = misfit.residual, _stepped(system, factor, state, share, misfit, tangent)
            misfit = system.misfit(state, share)
    return _Tried(state, misfit, iteration, None)


class _Linearised(NamedTuple):
    """A tangent in a factor."""

    parts: Any  #: of its elements
    is_stiffened: bool


def _linearised(
    system: AnySystem, factor: Factor, state: State, share: float, misfit: Misfit, squeezed: NDArray[np.bool_]
) -> _Linearised | None:
    """The tangent, left in the factor; None if squeezed elements, the stiffest, do not make it definite."""
    for stiffening in (0.0, *STIFFENINGS):
        parts = system.linearise(factor, state, share, misfit, (squeezed, stiffening))
        if not system.unstable_modes(factor) or not squeezed.any():
            return _Linearised(parts, stiffening > 0)
    return None


def _stepped(
    system: AnySystem, factor: Factor, state: State, share: float, misfit: Misfit, tangent: _Linearised
) -> State:
    """The state after one step of Newton's method, no longer than volumes allow.

    Where squeezed elements had to be stiffened the potential energy must fall: Newton's method would go to a saddle.
    """
    change, pressures = system.newton_change(factor, tangent.parts, state, misfit)
    return _damped(system, state, change, pressures, share if tangent.is_stiffened else None)


def _damped(
    system: AnySystem, state: State, change: FloatArray, pressures: FloatArray | float, falling_at: float | None
) -> State:
    """A state as far along a change as volumes allow; and until the potential energy falls, at a share of the load."""
    least = KEPT_VOLUME * system.volume_ratios(state)
    energy = np.inf if falling_at is None else _potential_mj(system, state, falling_at)
    for damping in DAMPING ** np.arange(DAMPINGS):
        trial = system.moved(state, change * damping, pressures * damping)
        kept = (least <= system.volume_ratios(trial)).all()
        if kept and (falling_at is None or _potential_mj(system, trial, falling_at) <= energy):
            break
    return trial


def _off_saddle(system: System, factor: Factor, state: State, share: float) -> State:
    """A state of less potential energy along the unstable mode of the tangent in a factor."""
    n, boxes = system.n_unknowns, system.body.boxes
    inverse = LinearOperator((n, n), matvec=lambda forces: factor.solve(forces.reshape(n, 1))[:, 0])
    mode = eigsh(inverse, k=1, which="SA", tol=1e-2, v0=np.ones(n))[1].reshape(-1, 3)
    return _damped(system, state, mode / np.abs(mode).max() * (boxes.high - boxes.low).min(), 0.0, share)


def _potential_mj(system: AnySystem, state: State, share: float) -> float:
    """Stored energy less the work of the loads."""
    return system.stored_mj(state) - share * system.own_displacement(state)


def _with_rested(system: System, state: State, share: float, squeezed: NDArray[np.bool_], unbalanced_n: float) -> State:
    """The state with squeezed elements at rest among the others, to so much of unbalanced force; as it is in vain.

    They are what Newton's method takes most iterations for, and few (nonlinear elimination: Cai & Li, SIAM J. Sci.
    Comput. 33 (2011) 746). They rest in a minimum of the potential energy: under the corner of a plate, symmetric about
    its diagonal, they would come to a saddle instead.
    """
    part, elements, nodes = system.around(squeezed)
    own = replace(part.rest(), u=state.u[nodes], p=state.p[elements])
    factor, every = part.new_factor(), np.ones(len(elements), dtype=bool)
    sizes = []
    for _ in range(RESTS + 1):
        misfit = part.misfit(own, share)
        sizes.append(float(np.linalg.norm(misfit.unbalanced)))
        if len(sizes) > RESTS:
            break
        if sizes[-1] > unbalanced_n:
            tangent = _linearised(part, factor, own, share, misfit, every)
            if tangent is None:
                break
            own = _stepped(part, factor, own, share, misfit, tangent)
            continue
        part.linearise(factor, own, share, misfit)
        if not part.unstable_modes(factor):
            break
        own = _off_saddle(part, factor, own, share)
    if not sizes[-1] < sizes[0]:
        return state
    u, p = state.u.copy(), state.p.copy()
    u[nodes], p[elements] = own.u, own.p
    return replace(state, u=u, p=p)


def _refusal(system: AnySystem, share: float, worst: _Tried) -> UnreachableLoadError:
    j = system.volume_ratios(worst.state).min(axis=1)
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
        f"no {what} above {share:.3g} of the load: beyond, the element at x = {x:.4g}, y = {y:.4g}, z = {z:.4g} mm "
        f"gives way (smallest J {least:.2g}): {mend}.",
        is_unstable=is_equilibrium and least >= SQUEEZED,
    )
