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

from fem import Scene, solve_scene
from fem.scene.solution import largest_error, relative_errors
from geometry.errors import TriPillarError
from geometry.layout import FloatArray
from studies.memory import peak_mib

PATIENCE_S = 1800.0  #: by the clock, after which an answer is given up
ROUNDED = 1e-6  #: relative; what an answer without an estimate may move by, since single precision is kept

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


def in_own_process(what: str, find: Callable[[], Row | list[Row]]) -> list[Row]:
    """Rows found in a copy of this process, whose imports are done, with an empty cache."""
    ours, theirs = get_context("fork").Pipe(duplex=False)

    def work() -> None:
        with TemporaryDirectory(prefix="gates-") as cache:
            os.environ["TRIPILLAR_CACHE"] = cache
            start = spent()
            try:
                found = find()
            except Exception as error:  # whatever it is, the row says it and the others go on
                kind = "refused" if isinstance(error, TriPillarError) else f"WRONG: {type(error).__name__}"
                found = Row(said=f"{kind}: {error}")
            seconds = spent() - start
        rows = [replace(found, what=what)] if isinstance(found, Row) else found
        theirs.send([replace(one, seconds=one.seconds or seconds, peak_mib=peak_mib()) for one in rows])

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
    """ "holds", or why it does not."""
    moved = largest_error(now.values, kept.values) if now.values.keys() == kept.values.keys() else np.inf
    before, after = (one.said.partition(":")[0] for one in (kept, now))
    if now.is_wrong:
        why = now.said if now.said.startswith("WRONG") else "stated too little"
        return f"no: {why}{', as before' if kept.is_wrong else ''}"
    if kept.is_wrong:
        return "holds: was wrong"
    if before == "refused" != after:
        return "holds: was refused"
    if before != after:
        return f"no: '{before}' has become '{after}'"
    return f"no: moved by {moved:.1e}" if moved > (kept.estimate or 0.0) + (now.estimate or 0.0) + ROUNDED else "holds"
