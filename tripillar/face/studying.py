"""Whole studies: the pipeline, sweeps of designs and the search for the best; and this machine."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from geometry.errors import DesignError
from tripillar.face.caller import current
from tripillar.face.inputs import (
    DesignLike,
    File,
    design_of,
    require_counts,
    require_packages,
    require_pool,
    require_there,
    to_fill,
)
from tripillar.terminal.interrupts import last_words

if TYPE_CHECKING:
    from geometry.storage.journal import Journal
    from tripillar.doctor import Check
    from tripillar.pipeline.run import PipelineResult
    from tripillar.sweep.rows import Row
    from tripillar.sweep.sweep_file import Sweep
    from tripillar.terminal.progress import Bars

MARKS = {"ok": "✓", "optional": "·", "wrong": "✗"}


def run(
    design: DesignLike | None = None,
    *,
    out: File = Path("out"),
    until: Literal["dataset", "table"] = "table",
) -> "PipelineResult":
    """Run the whole pipeline, from a design to a table of errors.

    The stages are CAD, response, unit, data sets, networks and table. What did not change is not made again.

    Parameters
    ----------
    design : SensorDesign or path, optional
        Design file (TOML); default: the paper's sensor.
    out : path
        Folder for all files.
    until : str
        Last stage to run.

    Returns
    -------
    PipelineResult
        The stages that ran and the comparisons of the table.
    """
    caller, folder, sensor = current(), to_fill(out), design_of(design)
    from tripillar.face.tables import comparison_table, stage_table, touch_table
    from tripillar.pipeline.run import run_pipeline

    with last_words(f"interrupted; the files in {folder} are kept: give the same command again to go on."):
        result = run_pipeline(sensor, folder, caller.bars, until_dataset=until == "dataset")
    of_errors = (comparison_table, touch_table) if result.comparisons else ()
    caller.answer(
        result.as_plain,
        lambda: [*(table(result.comparisons) for table in of_errors), stage_table(result.stages)],
        *result.files,
    )
    return result


def sweep(
    file: File,
    /,
    *,
    out: File = Path("out"),
    optimize: bool = False,
    trials: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    best: int = 8,
) -> "list[Row]":
    """Compare many designs by error, range, crosstalk and cost, or search for the one of least error within bounds.

    The same command again goes on where it was stopped.

    Parameters
    ----------
    file : path
        Sweep file (TOML): what is varied, and how.
    out : path
        Folder for rows, tables and pictures, named after the sweep file.
    optimize : bool
        Search for the design of least error within the bounds of the file.
    trials : int, optional
        Number of designs to try in all in a search; default: samples of the file.
    workers : int, optional
        Number of worker processes; default: one a core.
    scheduler : str, optional
        Address of a Dask scheduler to use instead of processes here.
    retry : bool
        Try designs that failed before once more; not in a search.
    best : int
        Number of designs in the printed table.

    Returns
    -------
    list of Row
        The designs with their measures; of a search the best one first.
    """
    caller, source, folder = current(), Path(file), to_fill(out)
    require_there(source, what="a sweep file")
    require_counts(workers=workers, best=best, trials=trials)
    require_pool(workers if scheduler is None else None, scheduler)
    if optimize and retry:
        raise DesignError("retry=True is of sweeps: leave it out with optimize=True.")
    if trials is not None and not optimize:
        raise DesignError("trials= are of a search: add optimize=True, or leave trials= out.")
    from tripillar.sweep.sweep_file import read_sweep

    asked = read_sweep(source)
    if optimize:
        asked = asked if trials is None else replace(asked, samples=trials)
        return _optimized(asked, source, folder, workers, scheduler)
    require_packages("pyarrow", "matplotlib")
    from geometry.pool import open_pool
    from geometry.storage.journal import Journal
    from tripillar.sweep.rows import write_parquet
    from tripillar.sweep.run import judge_all, kept_rows
    from tripillar.sweep.sampling import samples_of
    from tripillar.sweep.trade_offs import best_table, draw_pareto, ranked, reasons

    samples = samples_of(asked)
    journal = Journal(folder / f"{source.stem}-rows")
    found = kept_rows(samples, journal, retry)
    missing = [sample for sample in samples if sample.cache_key not in found]
    with stoppable(journal), open_pool(workers, scheduler) as pool:
        found |= judge_all(missing, asked.judging, pool, journal, shown(caller.bars, "designs", len(missing)))
    rows = [found[sample.cache_key] for sample in samples]
    files = [folder / f"{source.stem}.parquet"]
    write_parquet(rows, files[0])
    if not all(row.failed for row in rows):
        files.append(folder / f"{source.stem}-pareto.png")
        draw_pareto(rows, asked, files[1])
    failed = reasons(rows)
    result = {
        "designs": len(rows),
        "judged_now": len(missing),
        "failed": {kind: len(each) for kind, each in failed.items()},
        "best": [row.flat() for row in ranked(rows, asked)[:best]],
        "files": [str(path) for path in files],
    }
    caller.answer(lambda: result, lambda: [best_table(rows, asked, best)], *files)
    for each in failed.values():
        caller.say(f"{len(each)} failed, such as: {each[0]}")
    return rows


def _optimized(asked: "Sweep", source: Path, folder: Path, workers: int | None, scheduler: str | None) -> "list[Row]":
    """The designs within bounds that a search tried, the best one first."""
    require_packages("optuna")
    from geometry.pool import open_pool
    from geometry.storage.files import write_text
    from geometry.storage.journal import Journal
    from tripillar.sweep.optimize import search
    from tripillar.sweep.trade_offs import best_table, ranked

    journal = Journal(folder / f"{source.stem}-rows")
    with stoppable(journal), open_pool(workers, scheduler) as pool:
        rows = search(asked, pool, journal, shown(current().bars, "trials", asked.samples))
    best = ranked(rows, asked)
    if all(row.failed for row in rows):
        raise DesignError(f"all {len(rows)} designs of {source} failed, such as: {rows[0].reason}")
    if not best:
        raise DesignError(f"none of {len(rows)} designs is within the bounds of {source}: loosen them or try more.")
    path = folder / f"{source.stem}-best.toml"
    write_text(best[0].design or "", path)
    result = {"trials": asked.samples, "designs": len(rows), "best": best[0].flat(), "file": str(path)}
    current().answer(lambda: result, lambda: [best_table(rows, asked, 5)], path)
    return best


def doctor(*, compute: Annotated[bool, Parameter(negative="--no-compute")] = True) -> "list[Check]":
    """Check this machine: versions, solver, display, serial ports, known answers.

    Ends with code 1 if something is wrong.

    Parameters
    ----------
    compute : bool
        Compute what has a known answer, too: about 5 s.

    Returns
    -------
    list of Check
        What was looked at, with its state and advice.
    """
    caller = current()
    from tripillar.doctor.known_answers import KNOWN, check_answers
    from tripillar.doctor.surroundings import check_surroundings

    checks = list(check_surroundings())
    if compute:
        advance = caller.bars.begin("known answers", total=len(KNOWN))
        for check in check_answers():
            advance(1, check.name)
            checks.append(check)
    wrong = sum(check.state == "wrong" for check in checks)
    lines = []
    for check in checks:
        lines.append(f"{MARKS[check.state]} {check.name:32} {check.found}")
        if check.advice:
            lines.append(f"    {check.advice}")
    lines.append(f"{wrong} of {len(checks)} checks failed" if wrong else "all is well")
    result = {"checks": [asdict(check) for check in checks], "wrong": wrong}
    caller.answer(lambda: result, "\n".join(lines), code=1 if wrong else 0)
    return checks


def stoppable(journal: "Journal") -> AbstractContextManager[None]:
    """On Ctrl-C say that what is done is kept."""
    return last_words(f"stopped; the rows in {journal.folder} are kept: give the same command again to go on.")


def shown(bars: "Bars", what: str, total: int) -> Callable[["Row"], None]:
    """Progress of rows as a bar."""
    advance = bars.begin(what, total=total)
    advance(0, "workers begin")
    return lambda row: advance(1, f"failed: {row.reason[:60]}" if row.failed else f"{row.metrics['seconds']:.1f} s")
