"""One answer: how it is found in a process of its own, what is kept of it, and whether another one agrees."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np
from scipy.sparse import diags_array, kronsum
from scipy.sparse.linalg import splu

from fem import Scene, solve_scene
from fem.scene.solution import largest_error, relative_errors
from geometry.errors import TriPillarError
from geometry.layout import FloatArray
from tripillar.sweep.memory import peak_mib

PATIENCE_S = 1800.0  #: by the clock, after which an answer is given up
ROUNDED = 1e-6  #: relative; what an answer without an estimate may move by, since single precision is kept
SLOWER, NOTICED_S = 1.5, 0.2  #: times as slow, and seconds more, that are said, at the same pace
SIDE = 16  #: unknowns a side of the body by which a machine's pace is measured

Values = dict[str, FloatArray]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One answer."""

    what: str = ""
    estimate: float | None = None  #: stated error, relative
    error: float | None = None  #: largest distance to the truth, relative
    at_least: float | None = None  #: the same, less what the truth is uncertain by
    unknowns: int | None = None
    seconds: float = 0.0  #: of one thread's processor time
    pace: float = 1.0  #: seconds that `pace` found around it
    peak_mib: float = 0.0
    said: str = ""  #: verdict, refusal, or what else must stay as it is
    values: Values = field(default_factory=dict, repr=False)  #: each is compared as a whole, by its norm
    truth: Values = field(default_factory=dict, repr=False)  #: where this code made it itself, by a tighter solve
    uncertain: float = 0.0  #: stated error of that, relative

    @property
    def is_wrong(self) -> bool:
        """True if it is further from the truth than it states, or no answer at all."""
        return self.said.startswith("WRONG") or (self.at_least is not None and self.at_least > (self.estimate or 0.0))

    def held_to(self, truth: Mapping[str, Any], uncertain: float | Mapping[str, float]) -> "Row":
        """The same with its distance to a truth that is uncertain by so much, relative: all of it, or each name."""
        exact = {name: np.asarray(value) for name, value in truth.items()}
        errors = relative_errors({name: self.values[name] - value for name, value in exact.items()}, exact)
        slack = uncertain if isinstance(uncertain, Mapping) else dict.fromkeys(errors, uncertain)
        at_least = max(max(0.0, error - slack[name]) for name, error in errors.items())
        return replace(self, error=max(errors.values()), at_least=at_least)


def scene_row(scene: Scene, tolerance: float | None = None) -> Row:
    """The default path's answer to a scene."""
    found, _ = solve_scene(replace(scene, tolerance=tolerance or scene.tolerance))
    return Row(estimate=found.error_estimate, unknowns=found.unknowns, values=found.probes)


def spent() -> float:
    """Processor seconds of this process and of those that it waited for."""
    others = getrusage(RUSAGE_CHILDREN)
    return process_time() + others.ru_utime + others.ru_stime


def pace() -> float:
    """Processor seconds of a fixed factorisation: more where others use the same cores and their memory."""
    line = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(SIDE, SIDE))
    plane = kronsum(line, line)
    body = kronsum(plane, line).tocsc()
    start = process_time()
    splu(body)
    return process_time() - start


def in_own_process(what: str, find: Callable[[], Row | list[Row]]) -> list[Row]:
    """Rows found in a copy of this process, whose imports are done, with an empty cache."""
    ours, theirs = get_context("fork").Pipe(duplex=False)

    def work() -> None:
        with TemporaryDirectory(prefix="gates-") as cache:
            os.environ["TRIPILLAR_CACHE"] = cache
            before, start = pace(), spent()
            try:
                found = find()
            except Exception as error:  # whatever it is, the row says it and the others go on
                kind = "refused" if isinstance(error, TriPillarError) else f"WRONG: {type(error).__name__}"
                found = Row(said=f"{kind}: {error}")
            seconds = spent() - start
        rows = [replace(found, what=what)] if isinstance(found, Row) else found
        mean, peak = (before + pace()) / 2, peak_mib()
        theirs.send([replace(one, seconds=one.seconds or seconds, pace=mean, peak_mib=peak) for one in rows])

    process = get_context("fork").Process(target=work)
    process.start()
    theirs.close()
    rows = [Row(what=what, said=f"WRONG: no answer within {PATIENCE_S:g} s")]
    if ours.poll(PATIENCE_S):
        try:
            rows = ours.recv()
        except EOFError:
            rows = [Row(what=what, said="WRONG: its process was ended")]
    else:
        process.kill()
    process.join()
    return rows


def verdict(kept: Row, now: Row) -> str:
    """ "holds", or why it does not; behind it, how much slower it has become."""
    moved = largest_error(now.values, kept.values) if now.values.keys() == kept.values.keys() else np.inf
    allowed = (kept.estimate or 0.0) + (now.estimate or 0.0) + ROUNDED
    kind = [one.said.partition(":")[0] for one in (kept, now)]
    if now.is_wrong:
        why = now.said if now.said.startswith("WRONG") else "stated too little"
        found = f"no: {why}{', as before' if kept.is_wrong else ''}"
    elif kept.is_wrong:
        found = "holds: was wrong"
    elif kind[0] == "refused" != kind[1]:
        found = "holds: was refused"
    elif kind[0] != kind[1]:
        found = f"no: '{kind[0]}' has become '{kind[1]}'"
    elif moved > allowed:
        found = f"no: moved by {moved:.1e}"
    else:
        found = "holds"
    paced = kept.seconds * now.pace / kept.pace
    slower = now.seconds / max(paced, 1e-9)
    if slower > SLOWER and now.seconds > paced + NOTICED_S:
        found += f", {slower:.1f} × as slow"
    return found
