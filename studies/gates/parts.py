"""The parts: each gives names of answers and how each is found."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from dataset import DatasetSettings
from dataset.finite_strain import GroupSolver
from dataset.resistance import conducted_lengths
from fem import ResponseSettings, Scene, array_response, read_scene, solve_response
from fem.scene.loads import FollowerLoad
from geometry.design import Array, Electrics, Material, Pad, SensorDesign
from studies.bench.reference import reference_probes, stored_references
from studies.bench.scenes import FINITE, FINITE_REFERENCE, all_scenes, finite_scene
from studies.gates import scenes
from studies.gates.rows import Row, Values, scene_row, spent

SCENES = Path(__file__).parents[2] / "scenes"
NEAR = 2  #: units on each side of a pad whose electrodes are kept of a large array
WHOLE = 3  #: units a side up to which all pads and electrodes are kept in the table of arrays
TIGHTER = 10.0  #: times as tight is the solve that random scenes are held to; of oblique inclusions 3
STIFF = Pad(kind="stiff")
OWN = "21-U1"  #: an electrode of the pad that scenes "response-inner" load
Kept = Mapping[str, Row]  #: what was frozen of a part, by what was answered
Jobs = Iterator[tuple[str, Callable[[], Row | list[Row]]]]


def references(_: Kept) -> Jobs:
    """Scenes that NGSolve has solved, at two tolerances; an array's electrodes as one, as its estimate means them."""
    bodies = all_scenes()

    def solve(name: str, tolerance: float) -> Row:
        entry, row = stored_references()[name], scene_row(bodies[name], tolerance)
        if not name.startswith("response"):
            return row.held_to(entry["probes"], entry["uncertainties"])
        truth = {"electrodes": np.array([entry["probes"][probe] for probe in row.values])}
        row = replace(row, values={"electrodes": np.array(list(row.values.values()))})
        return row.held_to(truth, entry["uncertainties"][OWN])

    for name in stored_references():
        for tolerance in (1e-3, 1e-2):
            yield f"{name}, {tolerance:g}", partial(solve, name, tolerance)


def responses(_: Kept) -> Jobs:
    """Influence matrices, whole."""
    paper = SensorDesign()
    for name, design in {
        "soft 6 × 6": paper,
        "stiff 6 × 6": replace(paper, pad=STIFF),
        "matrix of 1.5 MPa, 6 × 6": replace(paper, matrix_material=Material(young_mpa=1.5)),
        "conduction 6 × 6": replace(paper, electrics=Electrics(model="conduction")),
        "1 × 2": replace(paper, array=Array(rows=1, cols=2)),
        "3 × 3": replace(paper, array=Array(rows=3, cols=3)),
    }.items():
        yield name, partial(respond, design)


def respond(design: SensorDesign, settings: ResponseSettings | None = None, whole: bool = True) -> Row:
    """Displacements by 1 N on a pad: of all electrodes for every pad, or for three pads of those near them."""
    from studies.bench.arrays import column_errors

    response = solve_response(design, settings)
    influence, (rows, cols) = response.influence_mm_per_n, (design.array.rows, design.array.cols)
    pads = {f"{i}, {j}": (i, j) for i, j in np.ndindex(rows, cols)}
    if not whole:
        pads = {"corner": (0, 0), "edge": (0, cols // 2), "inner": (rows // 2, cols // 2)}
    near = max(rows, cols) if whole else NEAR
    values: Values = {
        name: influence[max(0, i - near) : i + near + 1, max(0, j - near) : j + near + 1, ..., i, j, :]
        for name, (i, j) in pads.items()
    }
    estimate = None if np.isnan(response.error_estimate) else response.error_estimate
    row = Row(estimate=estimate, unknowns=response.unknowns, values=values)
    if response.conducted is not None:
        newtons = np.random.default_rng(26).uniform(-1.0, 0.0, (8, design.n_units, 3)) * [10.0, 10.0, 50.0]
        lengths = conducted_lengths(response.conducted, newtons)
        row = replace(row, values=values | {"effective lengths": lengths})
    if replace(design, electrics=Electrics()) == SensorDesign() and estimate is not None:
        entries = [one for name, one in stored_references().items() if name.startswith("response-inner")]
        error, uncertain = column_errors(influence)["inner self"], max(one["uncertainties"][OWN] for one in entries)
        row = replace(row, error=error, at_least=max(0.0, error - uncertain))
    return row


def samples(_: Kept) -> Jobs:
    """Groups of samples at finite strain, some heavy, some light, some of conduction."""
    for rows, protocol, electrics in (
        (2, "three-axis", Electrics(model="conduction")),
        (3, "contact", Electrics()),
        (3, "light", Electrics()),
    ):
        design = SensorDesign(array=Array(rows=rows, cols=rows), pad=STIFF, electrics=electrics)
        settings = DatasetSettings(protocol=protocol, samples=8, seed=17)
        name = f"{rows} × {rows} {protocol}"
        yield name, partial(group, name, design, settings)


def group(name: str, design: SensorDesign, settings: DatasetSettings) -> list[Row]:
    """A row a sample, and one of its resistances where these are by conduction; a sample's seconds are the mean."""
    response, _, _ = array_response(design)
    start = spent()
    found = GroupSolver(response, settings).group(settings, 0)
    rows, seconds = [], (spent() - start) / len(found.error_estimate)
    for number, moved in enumerate(found.displacement_mm):
        row = Row(
            what=f"{name}, {number}",
            estimate=float(found.error_estimate[number]),
            seconds=seconds,
            said=f"pressed by {-found.traction_mpa[number, :, 2].min():.4f} MPa at most",
            values={"electrodes": moved},
        )
        rows.append(row)
        if design.electrics.is_conduction:
            ratio, error = {"ratios": found.resistance_ratio[number]}, float(found.ratio_error[number])
            rows.append(replace(row, what=f"{row.what}, resistances", estimate=error, values=ratio))
    return rows


def finite_scenes(_: Kept) -> Jobs:
    """Scenes at finite strain: a plate, a dead load that NGSolve has solved, a pressure, a slender pillar."""
    from studies.edge_cases.finite import CENTER, SIZE, pressed_block

    def dead() -> Row:
        return scene_row(finite_scene(), 1e-2).held_to(reference_probes(FINITE), FINITE_REFERENCE["uncertainty"])

    pressure = pressed_block(FollowerLoad(center_mm=CENTER, size_mm=SIZE, pressure_mpa=3.0), tolerance=2e-2)
    yield "plate", partial(scene_row, read_scene(SCENES / "plate-finite-strain.toml"))
    yield "dead load", dead
    yield "pressure that follows", partial(scene_row, pressure)
    yield "slender pillar", partial(scene_row, replace(scenes.slender_pillar(), tolerance=1e-2))


def held(scene: Scene, truth: Mapping[str, object], uncertain: float) -> Row:
    """A scene's answer at 1e-2 held to what is known of it."""
    return scene_row(scene, 1e-2).held_to(truth, uncertain)


def random(kept: Kept) -> Jobs:
    """Scenes drawn at random and oblique inclusions, at 1e-2; the truth is a tighter solve of when they were frozen."""

    def solve(what: str, scene: Scene, tighter: float) -> Row:
        start, old = spent(), kept.get(what)
        row = scene_row(scene, 1e-2)
        row = replace(row, seconds=spent() - start)
        if old is not None and old.truth:
            truth, uncertain = old.truth, old.uncertain
        else:
            fine = scene_row(scene, 1e-2 / tighter)
            truth, uncertain = fine.values, fine.estimate or 0.0
        return replace(row.held_to(truth, uncertain), truth=truth, uncertain=uncertain)

    for what, scene in scenes.random_scenes().items():
        yield what, partial(solve, what, scene, TIGHTER)
    for what, scene in scenes.oblique_scenes().items():
        yield what, partial(solve, what, scene, 3.0)


def arrays(_: Kept) -> Jobs:
    """Rows of the table of arrays that users get, without its contrasts."""
    from studies.bench.arrays import CONTENDERS, SAME, SOFT

    for one in CONTENDERS:
        if not one.name.startswith(("whole", "half-space")):
            matrix = Material(young_mpa=SAME if one.covers(SAME) else SOFT)
            for units in one.settings:
                design = SensorDesign(array=Array(rows=units, cols=units), matrix_material=matrix)
                settings = ResponseSettings(**one.solve.keywords)  # type: ignore[attr-defined]  # of a partial
                yield f"{one.name}, {units} × {units}", partial(respond, design, settings, units <= WHOLE)


def edge_cases(_: Kept) -> Jobs:
    """Rows of the finite elements at the edge of what can be solved; their estimate is the error that is allowed."""
    from studies.edge_cases.scenes import scene_trials
    from studies.edge_cases.trials import Trial, tried

    def judge(trial: Trial) -> Row:
        found = tried(trial)
        return Row(estimate=found.allowed, error=found.error, at_least=found.error, said=found.verdict)

    for trial in scene_trials():
        yield f"{trial.name}, {trial.value}", partial(judge, trial)


def wrong_today(_: Kept) -> Jobs:
    """Answers that were wrong when they were frozen."""
    for side in (0.0004, 0.001, 0.01):
        for tolerance in (1e-1, 2e-2, 1e-2):
            name = f"patch of {side:g} mm, {tolerance:g}"
            yield name, partial(patch, side, tolerance)
    for name, (scene, truth, uncertain) in scenes.solved_by_others().items():
        yield name, partial(held, scene, truth, uncertain)
    settings = DatasetSettings(protocol="three-axis", samples=1, seed=77)
    yield "sample at the limit", partial(limit, settings, False)
    yield "the same as a scene", partial(limit, settings, True)


def patch(side_mm: float, tolerance: float) -> Row:
    """A small patch held to the half-space."""
    scene = scenes.small_patch(side_mm)
    truth = {"patch": (0.0, 0.0, scenes.sinking(side_mm))}
    return scene_row(scene, tolerance).held_to(truth, side_mm / scene.height_mm)


def limit(settings: DatasetSettings, as_scene: bool) -> Row:
    """A sample that the data set takes, and the same loads as a scene."""
    design = scenes.flat_array()
    response, _, _ = array_response(design)
    start = spent()
    found = GroupSolver(response, settings).group(settings, 0)
    if as_scene:
        start, row = spent(), scene_row(scenes.pads_pressed(design, found.traction_mpa[0]))
    else:
        row = Row(estimate=float(found.error_estimate[0]), values={"electrodes": found.displacement_mm[0]})
    pressed = f"{-found.traction_mpa[0, :, 2].min():.4f} MPa at most, {found.unsolved[0]} draws unsolved"
    return replace(row, seconds=spent() - start, said=pressed)


#: parts by name, in the order in which they are worth knowing
PARTS: dict[str, Callable[[Kept], Jobs]] = {
    "references": references,
    "responses": responses,
    "samples": samples,
    "finite-scenes": finite_scenes,
    "wrong-today": wrong_today,
    "random": random,
    "arrays": arrays,
    "edge-cases": edge_cases,
}
