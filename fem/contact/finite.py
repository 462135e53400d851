"""One contact at finite strain: Newton's method on a coarse grid about the patch that is pressed.

The contact is solved twice on one grid of boxes, by the rubbers' law and by linear elasticity. The ratio of the two
forces, and the difference of the electrodes' displacements, put right what `press` found on its cells: what such a grid
gets wrong at small strain cancels, and shallow contacts stay linear ones.

The shape presses by a penalty, along its normals where the rubber is then. Over an increment of depth its underside is
a plane before each point of integration, where the last increments foretell that to be; at full depth planes are
renewed until the force rests. Without friction, on bare rubber, as far as no edge of the shape bears.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation

from fem.contact.indentation import Contact
from fem.contact.shapes import Shape
from fem.contact.tiles import span
from fem.kernel.factor import Factor, SolverError
from fem.kernel.mixed import mixed_rubber, quadrature_lines
from fem.kernel.newton import Linearised, damped
from fem.kernel.system import State, System
from fem.kernel.top import Covered, FollowingPressures
from fem.meshes.grid import Grid
from geometry.law import LAWS
from geometry.layout import FloatArray, electrode_squares, unit_centres
from geometry.shares import pillar_shares

CELLS = 4, 6  #: of the coarse grid and of the finer one, along each side of the patch
AROUND = 1.15  #: of the patch that linear contact finds: how far cells are fine
GROWTH, FAR = 2.0, 1.5  #: of cells beyond it, and how many heights they reach
PENALTY = 300.0  #: stiffness of the shape per area, over Young's modulus and half the patch's shorter side
STEPS, MIN_STEP = 4, 1 / 64  #: of the depth
ITERATIONS, BALANCED = 14, 1e-4  #: of an increment, and the forces that it leaves unbalanced, of the contact's
RENEWALS, RESTED = 6, 5e-4  #: of the planes, and change of the force in the last one
LEAST_VOLUME = 0.1  #: of every point's, that a foretold state leaves
LEFT = 0.15  #: of what finite strain adds to electrodes, that may be missed: balls of 5 mm, 1 and 3.3 mm deep, 15, 7 %
NEAR_MM = 1e-4  #: over which a shape's slope is taken
SECONDS = 4e-6  #: of a search, times unknowns to the power of 1.5


@dataclass(frozen=True, eq=False, kw_only=True)
class FiniteContact(Contact):
    """A frictionless contact at finite strain: pressures are linear contact's times a ratio."""

    linear: Contact = field(repr=False)
    added_mm: FloatArray = field(repr=False)  #: to the electrodes' displacements, as `electrode_mm`
    strain_errors: tuple[float, float]  #: estimated, relative: of the ratio, and of `added_mm` over all

    @cached_property
    def displacement_mm(self) -> FloatArray:
        return self.linear.displacement_mm

    @cached_property
    def electrode_mm(self) -> FloatArray:
        return self.linear.electrode_mm + self.added_mm

    @cached_property
    def compliance_errors(self) -> tuple[float, float]:
        return self.linear.compliance_errors

    @cached_property
    def _judged(self) -> tuple[float, float]:
        forces, electrodes = self.linear.error_estimate, self.linear.electrode_error_estimate
        return forces + self.strain_errors[0], electrodes + self.strain_errors[1]


def why_tangent(contact: Contact) -> str | None:
    """Why a contact is left as the rubbers' tangent at rest has it; None where `at_finite_strain` solves it."""
    if contact.surface.has_plates:
        return "pads are plates"
    if contact.friction:
        return "there is friction"
    bears = binary_dilation(np.isinf(contact.above_mm)) & (contact.cell_force_n[2] > 0)
    return "an edge of the shape bears" if bears.any() else None


def at_finite_strain(contact: Contact, say: Callable[[str], None] = lambda line: None) -> FiniteContact:
    """A linear contact at finite strain by the design's own law, where `why_tangent` gives no reason against it.

    What it costs is said before. A `SolverError` says down to which depth there is a balance.
    """
    ratios, added = [], []
    for cells in CELLS:
        model = _Model(contact, cells)
        n = model.linear.n_unknowns
        if cells == CELLS[-1]:
            say(f"finite strain: {n:,} unknowns, about {SECONDS * n**1.5:.2g} s of processor time")
        (one, moved), (linear, before) = model.pressed(model.finite), model.pressed(model.linear)
        ratios.append(one / linear)
        of_force = (ratios[-1] - 1.0) * contact.electrode_mm  # far off forces alone are felt
        is_seen = model.is_seen.reshape(*contact.electrode_mm.shape[:-1], 1)
        added.append(np.where(is_seen, (moved - before).reshape(of_force.shape), of_force))
    plain = {spec.name: getattr(contact, spec.name) for spec in fields(Contact)}
    plain["cell_force_n"] = ratios[-1] * contact.cell_force_n
    size, off = (np.linalg.norm(one) for one in (contact.electrode_mm + added[-1], added[-1] - added[0]))
    left = max(off, LEFT * np.linalg.norm(added[-1])) / size
    errors = abs(ratios[0] / ratios[-1] - 1), float(left)
    return FiniteContact(**plain, linear=contact, added_mm=added[-1], strain_errors=errors)


@dataclass(frozen=True, eq=False)
class _Planes(FollowingPressures):
    """Penalty of a shape that is a plane before each point of integration: forces k o n of the overlap o > 0."""

    normal: FloatArray  #: n: out of the shape, its z −1, (t, q, 3)
    offset_mm: FloatArray  #: n · x + offset is how far a place is below the plane, (t, q)
    stiffness_n_mm: FloatArray  #: k, (t, q): 0 beside the shape

    def overlap_mm(self, x: FloatArray) -> FloatArray:
        ((_, own),) = self.parts
        return np.maximum(0.0, -np.einsum("tqk,tki,tqi->tq", own.values, x[own.nodes], self.normal) - self.offset_mm)

    def forces(self, x: FloatArray) -> FloatArray:
        ((_, own),) = self.parts
        push = self.normal * (self.stiffness_n_mm * self.overlap_mm(x))[..., None]
        out = np.zeros((self.n_nodes, 3))
        np.add.at(out, own.nodes, own.values.swapaxes(1, 2) @ push)
        return out

    def stiffness(self, x: FloatArray) -> list[FloatArray]:
        ((_, own),) = self.parts
        along = own.values[..., None] * self.normal[..., None, :]
        weight = -self.stiffness_n_mm * (self.overlap_mm(x) > 0)
        return [np.einsum("tqai,tq,tqbj->tabij", along, weight, along, optimize=True)]


class _Model:
    """A grid about a contact's patch, of both laws."""

    def __init__(self, contact: Contact, cells: int) -> None:
        design, patch = contact.design, contact.patch
        self.contact, height, slab = contact, design.unit.height_mm, np.array(design.slab_mm[:2]) / 2
        first, last = span(contact.cell_force_n[2] > 0)
        low, high = (np.array(patch.low_mm) + at * patch.cell_mm for at in (first, last))
        middle, half = (low + high) / 2, AROUND * (high - low) / 2
        low, high = np.maximum(middle - half, -slab), np.minimum(middle + half, slab)
        ends = np.maximum(low - FAR * height, -slab), np.minimum(high + FAR * height, slab)
        cell = (high - low) / cells
        lines = [_lines(np.linspace(low[k], high[k], cells + 1), ends[0][k], ends[1][k]) for k in (0, 1)]
        top = height - min(cell.min(), height / 2)
        self.grid = Grid([*lines, _lines(np.array([top, height]), 0.0, height)])
        rubbers, shares = [design.matrix_material, design.pillar_material], None
        if not design.is_homogeneous:
            x, y, z = (quadrature_lines(line) for line in self.grid.lines)
            of_pillars = sum(pillar_shares(design.unit, x - cx, y - cy, z) for cx, cy in unit_centres(design))
            shares = np.stack([1.0 - of_pillars, np.asarray(of_pillars)])
        finite, linear = (
            mixed_rubber(self.grid, LAWS[model], rubbers, shares) for model in (rubbers[0].model, "linear")
        )
        linear.condensed = None  # Newton's method has the nodes inside elements, too
        self.finite, self.linear = System(finite), System(linear)
        self.covered: Covered = self.finite.top.over(np.array([*low, *high]), following=True)
        young = rubbers[0].young_mpa if shares is None else max(one.young_mpa for one in rubbers)
        self.penalty = PENALTY * young / min(half)
        squares = electrode_squares(design)
        self.is_seen = ((squares[:, :2] >= ends[0]) & (squares[:, 2:] <= ends[1])).all(axis=1)
        self.seen = self.finite.integrals(squares[self.is_seen]) / design.unit.electrode_mm**2

    def planes(self, system: System, x: FloatArray, depth_mm: float) -> _Planes:
        """The shape at a depth as planes before places (n_nodes, 3) of the nodes; level ones of the linear body."""
        shape, place = self.contact.shape, self.covered.values @ x[self.covered.nodes]
        at_x, at_y = np.moveaxis(place[..., :2] - np.add(self.contact.at_mm, self.contact.slide_mm), -1, 0)
        height = shape.heights_mm(at_x, at_y)
        is_below, normal = np.isfinite(height), np.zeros(place.shape)
        normal[..., 2] = -1.0
        if not system.body.law.is_linear:
            normal[..., :2] = _slopes(shape, at_x, at_y, height)
        bottom = self.grid.lines[2][-1] - depth_mm + np.where(is_below, height, 0.0)
        stiffness = self.penalty * self.covered.weight_mm2 * is_below / (normal**2).sum(axis=-1)
        offset = bottom - (normal[..., :2] * place[..., :2]).sum(axis=-1)
        return _Planes([(1.0, self.covered)], len(x), normal, offset, stiffness)

    def pressed(self, system: System) -> tuple[float, FloatArray]:
        """Vertical force at full depth [N], and displacements (k, 3) of the electrodes [mm], 0 of unseen ones."""
        depth_mm, is_linear, factors = self.contact.depth_mm, system.body.law.is_linear, list[Factor]()
        state, before, reached = system.rest(), (0.0, system.rest()), 0.0
        step = depth_mm if is_linear else depth_mm / STEPS

        def balanced(start: State, depth_mm: float) -> State | None:
            system.pressures = self.planes(system, system.points_mm + start.u * (not is_linear), depth_mm)
            factors[:] = factors or [system.new_factor()]
            return _balanced(system, factors[0], start)

        while reached < depth_mm:
            ahead = min(depth_mm, reached + step)
            share = (ahead - reached) / (reached - before[0]) if reached else 0.0
            start = replace(
                state, u=state.u + share * (state.u - before[1].u), p=state.p + share * (state.p - before[1].p)
            )
            start = start if (system.body.volume_ratios(start.u) > LEAST_VOLUME).all() else state
            if (found := balanced(start, ahead)) is not None:
                before, state, reached = (reached, state), found, ahead
                continue
            step /= 2
            if step < MIN_STEP * depth_mm:
                raise self._refusal(reached)
        force_n = system.pressures.pressing_n(system.points_mm + state.u)
        for _ in range(0 if is_linear else RENEWALS):
            if (found := balanced(state, depth_mm)) is None:
                raise self._refusal(reached)
            state, last_n, force_n = found, force_n, system.pressures.pressing_n(system.points_mm + found.u)
            if abs(force_n - last_n) <= RESTED * force_n:
                break
        moved = np.zeros((len(self.is_seen), 3))
        moved[self.is_seen] = self.seen @ state.u
        return force_n, moved

    def _refusal(self, reached_mm: float) -> SolverError:
        return SolverError(
            f"no balance at finite strain deeper than {reached_mm:.3g} mm: press less deep, with a wider shape, or "
            "write model = 'linear' in the rubbers."
        )


def _balanced(system: System, factor: Factor, state: State) -> State | None:
    """Newton's method from a state; None where it does not end."""
    for _ in range(ITERATIONS):
        misfit = system.misfit(state, 1.0)
        if not np.isfinite(misfit.residual):
            return None
        if misfit.residual <= BALANCED:
            return state
        tangent = Linearised.at(system, state, factor, 1.0, misfit)
        (motions,), (pressures,) = tangent.changes(misfit.unbalanced[None], (misfit.pressures - state.p)[None])
        state = damped(system, state, motions, pressures)
    return None


def _slopes(shape: Shape, x_mm: FloatArray, y_mm: FloatArray, height_mm: FloatArray) -> FloatArray:
    """Slopes of a shape's underside along x and y, (..., 2); from one side at its edges, 0 beside it."""
    found = []
    for dx, dy in ((NEAR_MM, 0.0), (0.0, NEAR_MM)):
        ahead, behind = (shape.heights_mm(x_mm + sign * dx, y_mm + sign * dy) for sign in (1, -1))
        width = NEAR_MM * np.maximum(1, np.isfinite(ahead).astype(int) + np.isfinite(behind))
        ahead, behind = (np.where(np.isfinite(one), one, height_mm) for one in (ahead, behind))
        with np.errstate(invalid="ignore"):
            found.append(np.where(np.isfinite(height_mm), (ahead - behind) / width, 0.0))
    return np.stack(found, axis=-1)


def _lines(inner: FloatArray, low: float, high: float) -> FloatArray:
    """Lines of a grid from one end to the other, `GROWTH` times as far apart with each beyond the inner ones."""
    lines = inner.tolist()
    for end, at in ((low, 0), (high, -1)):
        sign, step = (-1.0, inner[1] - inner[0]) if at == 0 else (1.0, inner[-1] - inner[-2])
        while sign * (end - lines[at]) > 1e-9:
            step *= GROWTH
            left = sign * (end - lines[at])
            lines.insert(0 if at == 0 else len(lines), end if left < 1.6 * step else lines[at] + sign * step)
    return np.array(lines)
