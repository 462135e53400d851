"""Scenes at the edge of what can be solved."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from skfem import ElementTetP2, FacetBasis, LinearForm, MeshTet
from threadpoolctl import threadpool_limits

from fem.array.closed_forms import mean_compliance
from fem.array.coupled_cells import CoupledArray
from fem.array.design_cell import PADS, DesignCell
from fem.array.solving import ResponseSettings, solve_response
from fem.kernel.elements import taylor_hood
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.loads import FollowerLoad
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.methods.solving import solve_scene
from fem.scene.scene import Block, Inclusion, Pair, Pillar, Scene, Triple
from fem.scene.solution import Solution, largest_error
from geometry.design import Array, Material, Pad, SensorDesign, Unit, lone_unit
from geometry.layout import AXES, FloatArray, pad_squares
from geometry.mesh import TetMesh, smallest_dihedral_deg
from studies.bench.savings import solved_without
from studies.bench.scenes import RUBBER, loaded, response_scenes, upright
from studies.edge_cases.finite import KINDS, buckling, held_to_finer, ten_grids, tiny_load, work_of
from studies.edge_cases.trials import Judged, NotTriedError, Trial

YOUNG_MPA = RUBBER.young_mpa
TOLERANCE = 5e-3  #: of trials whose difficulty is not accuracy
ARRAY_TOLERANCE = 1e-3
TIGHTER = 2.0  #: by which a reference is asked to be better than estimated: enough for the next level, not for minutes
EXACT = 1e-12  #: for what differs by rounding alone, unamplified
ROUNDED = 1e-9  #: the same, amplified by the system's condition
END = 0.2  #: share of width over length by which a pillar's clamped end may stiffen it
PATCH_TEST = 1e-8  #: of linear fields, which quadratic elements hold exactly
SMALL_MPA = 1e-3  #: at which rubber of 6.1 MPa is linear
SPREAD = 3e-3  #: of a probe over meshes of the same body


def compared(scene: Scene, found: Solution, probes: dict[str, FloatArray], slack: float, against: str) -> Judged:
    """A scene's solution held against probes that are known to within a slack."""
    missed = found.error_estimate > scene.tolerance
    return Judged(
        residual=found.residual,
        error=largest_error(found.probes, probes),
        allowed=slack + max(scene.tolerance, found.error_estimate),
        against=against,
        short_of=scene.tolerance if missed else None,
    )


def compared_with_tighter(scene: Scene) -> Judged:
    """A scene solved, and solved again on a finer grid."""
    found, _ = solve_scene(scene)
    wanted = min(scene.tolerance, found.error_estimate) / TIGHTER  # or the first solve would do for the second too
    reference, _ = solve_scene(replace(scene, tolerance=wanted))
    require_other(found.unknowns, reference.unknowns)
    return compared(scene, found, reference.probes, reference.error_estimate, "a finer grid")


def require_other(unknowns: int, of_reference: int) -> None:
    """Refuse to hold an answer against itself."""
    if unknowns == of_reference:
        raise NotTriedError(f"nothing finer than its {unknowns} unknowns was solved, so there is nothing to compare")


# scenes


def block(
    material: Material, size_mm: Triple = (10.0, 10.0, 5.0), patch_mm: Pair = (4.0, 4.0),
    push: Triple = (0.0, 0.0, -1.0), *inclusions: Inclusion, tolerance: float = TOLERANCE,
) -> Scene:  # fmt: skip
    """A block under a patch in the middle of its top, whose mean displacement is asked for."""
    middle = (size_mm[0] / 2, size_mm[1] / 2)
    scene = loaded(Block(size_mm=size_mm), material, middle, patch_mm, push, *inclusions)
    return replace(scene, tolerance=tolerance)


def leaning_inclusion(tolerance: float = 3e-2) -> Scene:
    """A small block with an oblique inclusion ten times as stiff."""
    stiff = Inclusion(
        base_mm=(3.0, 3.0, 0.0), top_mm=(5.0, 5.0, 4.0), section_mm=(2.0, 2.0),
        material=replace(RUBBER, young_mpa=10 * YOUNG_MPA),
    )  # fmt: skip
    return block(RUBBER, (8.0, 8.0, 4.0), (5.0, 5.0), (0.0, 0.0, -1.0), stiff, tolerance=tolerance)


def meshed_inclusion(tolerance: float = 3e-2) -> Scene:
    """The same of an elliptic section: no lines of hexahedra follow it, so it needs the mesher."""
    scene = leaning_inclusion(tolerance)
    return replace(scene, inclusions=(replace(scene.inclusions[0], is_round=True),))


def finite(scene: Scene) -> Scene:
    """The same scene of neo-Hookean rubbers."""
    inside = tuple(replace(one, material=replace(one.material, model="neo-hookean")) for one in scene.inclusions)
    return replace(scene, material=replace(scene.material, model="neo-hookean"), inclusions=inside)


# trials


def poisson(nu: float) -> Judged:
    """A patch on a block at any Poisson's ratio, against a tighter solve."""
    return compared_with_tighter(block(replace(RUBBER, poisson=nu)))


def poisson_on_tetrahedra(nu: float, tolerance: float) -> Judged:
    """The same scene by Taylor-Hood tetrahedra and by boxes."""
    scene = block(replace(RUBBER, poisson=nu), tolerance=tolerance)
    found = solved_without("hexahedra", scene)
    reference, _ = solve_scene(replace(scene, tolerance=TOLERANCE))
    return compared(scene, found, reference.probes, reference.error_estimate, "tetrahedra beside boxes")


def hooke() -> Judged:
    """At ν = 0 the clamped base holds nothing back: the top sinks by p h / E."""
    scene = block(replace(RUBBER, poisson=0.0), patch_mm=(10.0, 10.0))
    exact = {"patch": np.array([0.0, 0.0, -5.0 / YOUNG_MPA])}
    return replace(compared(scene, solve_scene(scene)[0], exact, 0.0, "−p h/E"), allowed=ROUNDED)


def confined(nu: float) -> Judged:
    """Far from its sides a flat block under pressure sinks by p h / (λ + 2μ)."""
    whole = block(replace(RUBBER, poisson=nu), (200.0, 200.0, 4.0), (200.0, 200.0))
    scene = replace(whole, probes=(replace(whole.probes[0], size_mm=(4.0, 4.0)),))
    lame, mu = scene.material.lame_mpa
    exact = {"patch": np.array([0.0, 0.0, -4.0 / (lame + 2 * mu)])}
    return compared(scene, solve_scene(scene)[0], exact, 0.0, "confined: −p h/(λ + 2μ)")


def modulus_ratio(ratio: float) -> Judged:
    """An upright pillar in a block `ratio` times as stiff."""
    inside = upright(5.0, 5.0, (0.0, 5.0), (2.0, 2.0), YOUNG_MPA / ratio, RUBBER.poisson)
    scene = block(RUBBER)
    return compared_with_tighter(replace(scene, inclusions=(inside,), tolerance=2e-2))


def two_rubbers_finite(ratio: float, pressure_mpa: float) -> Judged:
    """An oblique pillar `ratio` times as stiff as its block at finite strain, against a finer grid, or linear."""
    leaning = leaning_inclusion()
    inside = replace(leaning.inclusions[0], material=replace(RUBBER, young_mpa=ratio * YOUNG_MPA))
    load = FollowerLoad(center_mm=(4.0, 4.0), size_mm=(5.0, 5.0), pressure_mpa=pressure_mpa)
    scene = replace(leaning, inclusions=(inside,), loads=(load,), tolerance=2e-2)
    if pressure_mpa > SMALL_MPA:
        return compared_with_tighter(finite(scene))
    found, linear = solve_scene(finite(scene))[0], solve_scene(scene)[0]
    return compared(scene, found, linear.probes, linear.error_estimate, "linear rubber")


def slender(width_mm: float, height_mm: float, tangential: bool) -> Judged:
    """A pillar pressed or dragged, against rod and beam; its clamped end makes it a little stiffer."""
    p, G, kappa = 1e-3, YOUNG_MPA / 2.6, 5 / 6
    section = (width_mm, width_mm)
    if tangential:
        second_moment_over_area = width_mm**2 / 12
        bent = p * height_mm**3 / (3 * YOUNG_MPA * second_moment_over_area) + p * height_mm / (kappa * G)
        exact, traction, against = np.array([bent, 0.0, 0.0]), (p, 0.0, 0.0), "Timoshenko's beam"
    else:
        exact, traction, against = np.array([0.0, 0.0, -p * height_mm / YOUNG_MPA]), (0.0, 0.0, -p), "−p L/E"
    body = Pillar(section_mm=section, base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, height_mm))
    material = Material(young_mpa=YOUNG_MPA, poisson=0.3)
    scene = replace(loaded(body, material, (0.0, 0.0), section, traction), tolerance=TOLERANCE)
    slack = END * width_mm / height_mm
    return compared(scene, solve_scene(scene)[0], {"patch": exact}, slack, f"{against}, to {END:g} w/L")


def small_patch(ratio: float, traction_mpa: Triple) -> Judged:
    """A patch so small that its block is a half-space to it, but for a/h."""
    size, a = 30.0, 30.0 / ratio
    scene = block(replace(RUBBER, poisson=0.3), (size, size, size), (a, a), traction_mpa)
    rectangle = np.array([-a / 2, -a / 2, a / 2, a / 2])
    exact = mean_compliance(rectangle, rectangle, scene.material) @ np.array(traction_mpa) * a**2
    return compared(scene, solve_scene(scene)[0], {"patch": exact}, a / size, "half-space, to a/h")


def flattened(smallest_deg: float) -> tuple[MeshTet, float]:
    """A box of tetrahedra whose inner nodes were pushed until the smallest dihedral angle is that, and the angle."""
    mesh = MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 4)] * 3)
    inner = ((mesh.p > 0) & (mesh.p < 1)).all(axis=0)
    push = np.zeros_like(mesh.p)
    push[:, inner] = np.random.default_rng(3).uniform(-1.0, 1.0, (3, int(inner.sum())))
    rest = np.sign(signed_volumes(mesh.p, mesh.t))

    def angle(share: float) -> float:
        points = mesh.p + share * push
        if not (rest * signed_volumes(points, mesh.t) > 0).all():
            return 0.0
        cells = TetMesh(points.T, mesh.t.T.astype(np.int32), np.zeros(mesh.nelements, dtype=np.int32))
        return smallest_dihedral_deg(cells)

    share = brentq(lambda share: angle(share) - 1.005 * smallest_deg, 0.0, 1.0)
    return MeshTet(mesh.p + share * push, mesh.t), angle(share)


def signed_volumes(points: FloatArray, cells: FloatArray) -> FloatArray:
    """Volumes of tetrahedra (4, m) of points (3, n)."""
    corners = points[:, cells]
    edges = corners[:, 1:] - corners[:, :1]
    return np.asarray(np.linalg.det(edges.transpose(2, 1, 0)) / 6)


def flat_cells(smallest_deg: float, nu: float) -> Judged:
    """A linear field, driven by its tractions, on a mesh with nearly flat cells: exact on any mesh."""
    mesh, _ = flattened(smallest_deg)
    rubber = Material(young_mpa=YOUNG_MPA, poisson=nu)
    system = System(Rubber.of(mesh, taylor_hood(), [rubber]))
    lame, mu = rubber.lame_mpa
    gradient = np.zeros((3, 3))
    gradient[:, 2] = [0.01, -0.02, -0.03]  # u = g z vanishes on the base
    stress = lame * np.trace(gradient) * np.eye(3) + mu * (gradient + gradient.T)
    facets = FacetBasis(mesh, ElementTetP2(), intorder=2)
    normals = np.stack([LinearForm(lambda v, w, i=i: v * w.n[i]).assemble(facets) for i in range(3)], axis=1)
    x, residual = checked_solve(Factor(system.rest_matrix(), upper=True), system.rest_loads((normals @ stress)[None]))
    found = system.displaced(x)[0]
    exact = np.outer(system.points_mm[:, 2], gradient[:, 2])
    error = float(np.abs(found - exact).max() / np.abs(exact).max())
    return Judged(residual=residual, error=error, allowed=PATCH_TEST, against="a linear field")


def meshed_again(times: int, tolerance: float) -> Judged:
    """Greatest less least of every probe over meshes of the same body, relative: the mesher is not deterministic."""
    scene = meshed_inclusion(tolerance)
    found = [solved_without("cache", scene) for _ in range(times)]
    probes = np.array([[solution.probes[probe.name] for probe in scene.probes] for solution in found])
    size = np.linalg.norm(probes.mean(axis=0), axis=-1)
    spread = float((np.linalg.norm(np.ptp(probes, axis=0), axis=-1) / size).max())
    residual = max(solution.residual for solution in found)
    return Judged(residual=residual, error=spread, allowed=SPREAD, against=f"spread of {times} meshes")


def pressed(mpa: float, tetrahedra: bool) -> Scene:
    """A block of boxes, or of tetrahedra, under a pressure."""
    scene = meshed_inclusion() if tetrahedra else block(RUBBER)
    return replace(scene, loads=(replace(scene.dead_loads[0], traction_mpa=(0.0, 0.0, -mpa)),))


def scaled_load(scale: float, tetrahedra: bool) -> Judged:
    """`scale` times the load bends `scale` times as far."""
    one, _ = solve_scene(pressed(1.0, tetrahedra))
    many, _ = solve_scene(pressed(scale, tetrahedra))
    error = largest_error({name: u / scale for name, u in many.probes.items()}, one.probes)
    return Judged(residual=many.residual, error=error, allowed=EXACT, against="load 1, scaled")


def zero_load(skipped: bool, tetrahedra: bool) -> Judged:
    """Nothing moves where nothing loads, computed or not."""
    scene = pressed(0.0, tetrahedra)
    found = solve_scene(scene)[0] if skipped else solved_without("zero-load", scene)
    moved = max(float(np.abs(u).max()) for u in found.probes.values())
    return Judged(residual=found.residual, error=moved, allowed=0.0, against="0 exactly")


def threads(tetrahedra: bool) -> Judged:
    """The same answer by one thread as by two."""
    solutions = []
    for count in (1, 2):
        with threadpool_limits(count):
            solutions.append(solve_scene(pressed(1.0, tetrahedra))[0])
    one, two = solutions
    error = largest_error(two.probes, one.probes)
    return Judged(residual=two.residual, error=error, allowed=EXACT, against="1 thread")


def small_array(pitch_mm: float, height_mm: float) -> SensorDesign:
    """2 × 2 units of one rubber, small enough for a pitch of 12 mm; not too flat for oblique pillars of 1 mm."""
    unit = Unit(span_mm=6.0, height_mm=height_mm, pillar_width_mm=1.0)
    return SensorDesign(array=Array(rows=2, cols=2, pitch_mm=pitch_mm), unit=unit, pad=Pad(size_mm=10.0))


def array_of(pitch_mm: float, height_mm: float) -> Judged:
    """Columns of an array's response by cells against the slab as one scene, over the loaded unit's own block."""
    design = small_array(pitch_mm, height_mm)
    found = solve_response(design, ResponseSettings(tolerance=ARRAY_TOLERANCE))
    scenes = response_scenes(design)
    columns, slack = [], 0.0
    for axis in AXES:
        column = solved_without("substructuring", replace(scenes[f"response-inner-{axis}"], tolerance=ARRAY_TOLERANCE))
        columns.append(np.stack(list(column.probes.values())).ravel())  # electrodes of a unit follow each other
        slack = max(slack, column.error_estimate)
    expected = np.stack(columns, axis=-1).reshape(2, 2, -1, 3)
    influence = found.influence_mm_per_n.reshape(2, 2, -1, 2, 2, 3)[:, :, :, 1, 1]
    error = np.linalg.norm(influence - expected, axis=(2, 3)).max() / np.linalg.norm(expected[1, 1])
    return Judged(
        residual=found.residual,
        error=float(error),
        allowed=max(ARRAY_TOLERANCE, found.error_estimate) + slack,
        against="one scene",
        short_of=ARRAY_TOLERANCE if found.error_estimate > ARRAY_TOLERANCE else None,
    )


def reciprocity(pitch_mm: float, height_mm: float) -> Judged:
    """Pads move each other alike (Betti), and no load does negative work."""
    design = small_array(pitch_mm, height_mm)
    cell = DesignCell(design, pad_squares(lone_unit(design))).condensed(2, 4)
    influence, misfit = CoupledArray(cell, 2, 2).influence(PADS, PADS)
    matrix = influence.reshape(12, 12)
    error = float(np.abs(matrix - matrix.T).max() / np.abs(matrix).max())
    if not np.linalg.eigvalsh(matrix + matrix.T).min() > 0:
        error = np.inf
    return Judged(residual=max(cell.residual, misfit), error=error, allowed=ROUNDED, against="Betti's reciprocity")


def scene_trials() -> list[Trial]:
    """Every line of the table, cheap ones first within each kind."""
    trials: list[Trial] = []

    def add(name: str, value: str, run: Callable[..., Judged], *arguments: object) -> None:
        trials.append(Trial(name=name, value=value, run=lambda: run(*arguments)))

    add("poisson", "ν = 0, whole top", hooke)
    for nu in (0.0, 0.3, 0.49, 0.4999, 0.499999):
        add("poisson", f"ν = {nu:g}", poisson, nu)
    for nu in (0.49, 0.4999, 0.499999):
        add("poisson", f"ν = {nu:g}, TH", poisson_on_tetrahedra, nu, 2e-2)
    for nu in (0.3, 0.49):
        add("poisson", f"ν = {nu:g}, flat block", confined, nu)
    for ratio in (1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3):
        add("modulus", f"matrix/pillar {ratio:g}", modulus_ratio, ratio)
    for ratio, mpa in ((1 / 3, 1e-6), (1 / 3, 1.0), (3.0, 1.0)):
        add("finite strain", f"pillar/matrix {ratio:.2g}, {mpa:g} MPa", two_rubbers_finite, ratio, mpa)
    for nu in (0.3, 0.45, 0.49, 0.499, 0.4999):
        add("finite strain", f"stiff 1 MPa, ν = {nu:g}", held_to_finer, "stiff", 1.0, nu)
    for kind in KINDS:
        add("finite strain", f"{kind} 1e-06 MPa", tiny_load, kind)
        for mpa in (3.0, 5.0, 10.0) if kind == "stiff" else (3.0, 10.0):
            judge = work_of if (kind, mpa) == ("stiff", 10.0) else held_to_finer
            add("finite strain", f"{kind} {mpa:g} MPa", judge, kind, mpa)
    for kind, mpa in (("follower", 1.0), ("stiff", 1.0)):
        add("finite strain", f"{kind} {mpa:g} MPa, ten grids", ten_grids, kind, mpa)
    for share, aside in ((0.5, 0.0), (0.5, 1e-5), (0.9, 1e-5), (1.1, 0.0), (2.0, 0.0)):
        add("finite strain", f"{share:g} of Euler's load{', aside' if aside else ''}", buckling, share, aside)
    for width_mm, height_mm in ((0.1, 10.0), (1.0, 100.0), (1.0, 20.0)):
        for tangential in (False, True):
            way = "dragged" if tangential else "pressed"
            value = f"{width_mm:g} × {width_mm:g} × {height_mm:g} {way}"
            add("slender", value, slender, width_mm, height_mm, tangential)
    for ratio in (100.0, 1000.0):
        add("edges", f"1:{ratio:g} pressed", small_patch, ratio, (0.0, 0.0, -1.0))
    add("edges", "1:1000 dragged", small_patch, 1000.0, (1.0, 0.0, 0.0))
    for smallest_deg in (0.9, 0.1, 1e-2, 1e-4):
        for nu in (0.3, 0.4999):
            add("flat cells", f"{smallest_deg:g}°, ν = {nu:g}", flat_cells, smallest_deg, nu)
    add("meshes", "10 of one body", meshed_again, 10, TOLERANCE)
    for scale in (1e-9, 1e-3, 1e3, 1e9):
        add("load", f"{scale:g} MPa", scaled_load, scale, False)
    for scale in (1e-9, 1e9):
        add("load", f"{scale:g} MPa, tetrahedra", scaled_load, scale, True)
    add("zero load", "skipped", zero_load, True, False)
    add("zero load", "computed", zero_load, False, False)
    add("zero load", "computed, tetrahedra", zero_load, False, True)
    add("threads", "2", threads, False)
    add("threads", "2, tetrahedra", threads, True)
    for pitch_mm in (12.0, 30.0):
        for height_mm in (2.0, 30.0):
            add("array", f"2 × 2, pitch {pitch_mm:g}, height {height_mm:g}", array_of, pitch_mm, height_mm)
    add("array", "2 × 2, pitch 12, height 10", array_of, 12.0, 10.0)
    add("reciprocity", "2 × 2, pitch 12, height 2", reciprocity, 12.0, 2.0)
    add("reciprocity", "2 × 2, pitch 30, height 30", reciprocity, 30.0, 30.0)
    return trials
