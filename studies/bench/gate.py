"""``python -m studies gate``: TriPillar, NGSolve and CalculiX as programs of their own, to the same true errors.

Processor seconds of the whole process, imports and all, and of the solve alone, on one thread; the programs take turns.
TriPillar is asked for each error; of NGSolve and CalculiX the cheapest of the settings in `gate.json` whose true error
meets it is run, chosen by hand for each scene (``--tune`` measures them anew). They state no error. `gate.json` holds
scenes and truths, too: answers of TriPillar at 1e-4 or tighter, and how far the finest NGSolve is from them. The truth
at finite strain is NGSolve's, by half of the block in Taylor-Hood hexahedra of third order, and right to 9e-5.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Annotated, Any, NamedTuple

import numpy as np
from cyclopts import Parameter

from common.errors import DesignError
from common.storage.files import write_text
from fem.scene.scene_file import scene_from_dict
from fem.scene.solution import largest_error
from studies.bench.peers import calculix
from studies.bench.processes import timed
from studies.bench.reference import by_hand, laid_out, missing_ngsolve, write_scene
from studies.tables import OUT, Folder, Row, report, shown
from tripillar.terminal.entry import say

GATE = Path(__file__).with_name("gate.json")
LEVELS = (5e-2, 1e-2, 3e-3, 1e-3)  #: true errors that are asked for
IMPORTS = "import numpy, scipy.sparse, skfem"  #: what any program on scikit-fem loads
SLOW_S = 5.0  #: a run that takes longer is not repeated
#: a scene solved once, what it imports left out
ALONE = """
import sys, time
from dataclasses import replace
from pathlib import Path
import fem.array.design_cell, fem.methods.box_refinement, fem.scene.tetrahedra
from fem.kernel.factor import Factor
from fem.methods.solving import solve_scene
from fem.scene.scene_file import read_scene
from scipy.sparse import eye_array
scene = replace(read_scene(Path(sys.argv[1])), tolerance=float(sys.argv[2]))
Factor(eye_array(9, format="csr"))  # loads the library
start = time.process_time()
solve_scene(scene)
print(time.process_time() - start)
"""


class Ran(NamedTuple):
    """What a program gave and took; a run without an estimate states 0."""

    whole_s: float
    solve_s: float
    error: float
    estimate: float = 0.0


class Case(NamedTuple):
    """A scene of the gate."""

    table: dict[str, Any]  #: of its scene file
    truth: dict[str, list[float]]  #: displacement of each probe [mm]
    uncertain: dict[str, float]  #: what TriPillar states of the truth, and NGSolve's distance from it
    settings: dict[str, dict[str, list[float]]]  #: by program and setting, its true error and seconds of the solve

    def error(self, probes: dict[str, Any]) -> float:
        """The largest of the probes' true errors."""
        found, truth = ({name: np.array(u) for name, u in each.items()} for each in (probes, self.truth))
        return largest_error(found, truth)

    def cheapest(self, program: str, level: float) -> str | None:
        """The setting of a program that meets an error at the least cost."""
        good = {setting: cost for setting, (error, cost) in self.settings.get(program, {}).items() if error <= level}
        return min(good, key=good.__getitem__, default=None)


def by_tripillar(case: Case, scene: Path, level: float) -> Ran:
    """`tripillar solve` at a tolerance, and the solve alone in a second process."""
    said, whole_s = timed(sys.executable, "-m", "tripillar", "solve", scene, "--json", "--tolerance", str(level))
    alone, _ = timed(sys.executable, "-c", ALONE, scene, str(level))
    found = json.loads(said)
    return Ran(whole_s, float(alone), case.error(found["probes"]), found["error_estimate"])


def by_ngsolve(case: Case, scene: Path, setting: str) -> Ran:
    """NGSolve's program at its flags."""
    found, whole_s = by_hand(scene, setting)
    return Ran(whole_s, found["seconds"], case.error(found["probes"]))


def by_calculix(case: Case, scene: Path, setting: str) -> Ran:
    """CalculiX's program on a grid of a fineness."""
    probes, seconds = calculix.solve_by_calculix(scene_from_dict(case.table), int(setting))
    return Ran(seconds, seconds, case.error(probes))


PEERS: dict[str, tuple[Callable[[], str], Callable[[Case, Path, str], Ran]]] = {
    "NGSolve": (missing_ngsolve, by_ngsolve),
    "CalculiX": (calculix.missing, by_calculix),
}


def alternated(runs: dict[str, Callable[[], Ran]], times: int) -> dict[str, Ran | None]:
    """Medians of programs that take turns; None where one failed or took too long."""
    found: dict[str, list[Ran]] = {name: [] for name in runs}
    failed = set()
    for _ in range(times):
        for name, run in runs.items():
            if name in failed or any(one.whole_s > SLOW_S for one in found[name]):
                continue
            try:
                found[name].append(run())
            except (subprocess.SubprocessError, ValueError) as error:
                say(f"{name}: {error}")
                failed.add(name)
    return {
        name: None if name in failed else Ran(*(median(column) for column in zip(*each, strict=True)))
        for name, each in found.items()
    }


def raced(name: str, case: Case, folder: Path, peers: list[str], times: int) -> list[Row]:
    """Rows of a scene: each program to each error."""
    rows: list[Row] = []
    scene = write_scene(case.table, folder / f"{name}.toml")
    for level in LEVELS:
        settings = {peer: chosen for peer in peers if (chosen := case.cheapest(peer, level))}
        runs: dict[str, Callable[[], Ran]] = {"TriPillar": partial(by_tripillar, case, scene, level)}
        runs |= {peer: partial(PEERS[peer][1], case, scene, setting) for peer, setting in settings.items()}
        row: dict[str, Any] = {"scene": name, "asked": level}
        for program, ran in alternated(runs, times).items():
            if ran:
                row[f"{program} whole / solve [s]"] = [ran.whole_s, ran.solve_s]
                row[f"{program} error" + " / estimate" * bool(ran.estimate)] = [
                    ran.error,
                    *filter(None, [ran.estimate]),
                ]
        say(", ".join(f"{key} {shown(value)}" for key, value in row.items()))
        rows.append(row)
    return rows


def tuned(name: str, case: Case, folder: Path, peers: list[str]) -> Case:
    """A scene whose peers' settings are all measured anew."""
    scene = write_scene(case.table, folder / f"{name}.toml")
    settings = dict(case.settings)
    for peer in peers:
        for setting in case.settings.get(peer, {}):
            ran = alternated({f"{name}, {peer} at {setting}": partial(PEERS[peer][1], case, scene, setting)}, 1)
            (one,) = ran.values()
            measured = [float(f"{one.error:.4g}"), round(one.solve_s, 3)] if one else [np.inf, np.inf]
            settings[peer] = settings[peer] | {setting: measured}
    return case._replace(settings=settings)


def cases() -> dict[str, Case]:
    """The scenes of the gate."""
    return {name: Case(**case) for name, case in json.loads(GATE.read_text(encoding="utf-8")).items()}


def gate(
    out: Folder = OUT,
    scene: Annotated[list[str] | None, Parameter(help="Scene to run; may be given again.")] = None,
    times: Annotated[int, Parameter(help="Runs of each program, of which the median counts.")] = 3,
    tune: Annotated[bool, Parameter(name="--tune", help="Measure the peers' settings anew and store them.")] = False,
) -> None:
    """Race TriPillar, NGSolve and CalculiX on the scenes of the gate; a program that is missing is skipped."""
    absent = {peer: why for peer, (missing, _) in PEERS.items() if (why := missing())}
    for peer, why in absent.items():
        say(f"{peer}: skipped, {why}")
    peers, every = [peer for peer in PEERS if peer not in absent], cases()
    for name in scene or ():
        if name not in every:
            raise DesignError(f"no scene '{name}' in the gate: choose {', '.join(every)}.")
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in scene or every:
            if tune:
                every[name] = tuned(name, every[name], Path(folder), peers)
                write_text(laid_out({one: case._asdict() for one, case in every.items()}), GATE)
            else:
                rows += raced(name, every[name], Path(folder), peers, times)
    if rows:
        imports = [timed(sys.executable, "-c", IMPORTS)[1] for _ in range(times)]
        tables: dict[str, list[Row]] = {
            "Processor seconds to true errors": rows,
            IMPORTS: [{"whole [s]": median(imports)}],
        }
        report(tables, out / "gate.json", {"times": times})
