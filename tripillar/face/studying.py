"""Whole studies: the pipeline, sweeps of designs and the search for the best; and this machine."""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal

from common.errors import ArgumentError, DesignError
from common.storage.files import write_text
from common.storage.journal import Journal
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import DesignLike, File, design_of, job, require_packages
from tripillar.terminal.interrupts import last_words

MARKS = {"ok": "✓", "optional": "·", "wrong": "✗"}

#: said when a sweep is interrupted
STOPPED = "stopped; the rows in {} are kept: give the same command again to go on."


@job(out="/")
def run(
    design: DesignLike | None = None,
    *,
    out: File = Path("out"),
    until: Literal["dataset", "table"] = "table",
) -> "stages.PipelineResult":
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
    caller, sensor = current(), design_of(design)
    with last_words(f"interrupted; the files in {out} are kept: give the same command again to go on."):
        result = stages.run_pipeline(sensor, Path(out), caller.bars, until_dataset=until == "dataset")
    of_errors = [stages.comparison_table(result.comparisons)] if result.comparisons else []
    caller.answer(result.as_plain, lambda: [*of_errors, stages.stage_table(result.stages)], *result.files)
    return result


@job(out="/")
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
) -> "list[stages.Row]":
    """Compare many designs by error, range, crosstalk and cost, or search for the best within bounds.

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
        Address of a Dask scheduler to use instead of processes here, such as tcp://host:8786.
    retry : bool
        Try designs that failed before once more; not in a search.
    best : int
        Number of designs in the printed table.

    Returns
    -------
    list of Row
        The designs with their measures: those within the bounds first, the best of them at the head; of a search these
        alone.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> import tripillar as tp
    >>> folder = Path(mkdtemp())
    >>> _ = (folder / "heights.toml").write_text('''
    ... design = { array = { rows = 1, cols = 2 } }
    ... sweep = { sampling = "grid", noise = 1e-3, bits = 12 }
    ... bounds = { range_n = { least = 300.0 } }
    ... [[vary]]
    ... key = "unit.height_mm"
    ... values = [8.0, 10.0]
    ... ''')
    >>> best, *others = tp.sweep(folder / "heights.toml", out=folder, workers=1)
    >>> best.values, len(others), bool(best.metrics["error_n"] <= others[0].metrics["error_n"])
    ({'unit.height_mm': 10.0}, 1, True)
    """
    if not isinstance(file, Path | str):
        raise ArgumentError(f"file is of type {type(file).__name__}, expected a path: write it to a file (TOML).")
    caller, source, folder = current(), Path(file), Path(out)
    stages.require_pool(workers, scheduler)
    if optimize and retry:
        raise DesignError("retry=True is of sweeps: leave it out with optimize=True.")
    if trials is not None and not optimize:
        raise DesignError("trials= are of a search: add optimize=True, or leave trials= out.")
    asked, journal = stages.read_sweep(source), Journal(folder / f"{source.stem}-rows")
    asked = replace(asked, samples=trials or asked.samples)
    require_packages("sweep", *(("optuna",) if optimize else ("pyarrow", "matplotlib")))
    samples = [] if optimize else stages.samples_of_sweep(asked)
    with last_words(STOPPED.format(journal.folder)), stages.open_pool(workers, scheduler) as pool:
        if optimize:
            rows = stages.search(asked, pool, journal, _shown("trials", asked.samples))
            return _best_of(rows, asked, source, folder / f"{source.stem}-best.toml", best)
        by_key = stages.kept_rows(samples, journal, retry)
        missing = [sample for sample in samples if sample.cache_key not in by_key]
        by_key |= stages.judge_all(missing, asked.judging, pool, journal, _shown("designs", len(missing)))
    rows = [by_key[sample.cache_key] for sample in samples]
    files = [folder / f"{source.stem}.parquet"]
    stages.write_parquet(rows, asked.metrics, files[0])
    if stages.told(rows, asked):
        files.append(folder / f"{source.stem}-pareto.png")
        stages.draw_pareto(rows, asked, files[1])
    failed = stages.reasons(rows)
    result = {
        "designs": len(rows),
        "judged_now": len(missing),
        "failed": {kind: len(each) for kind, each in failed.items()},
        "best": [row.flat(asked.metrics) for row in stages.ranked(rows, asked)[:best]],
        "files": [str(path) for path in files],
    }
    caller.answer(lambda: result, lambda: stages.best_tables(rows, asked, best), *files)
    for each in failed.values():
        caller.say(f"{len(each)} failed, such as: {each[0]}")
    for line in stages.untold(rows, asked):
        caller.say(line)
    return [*{row.cache_key: row for row in (*stages.ranked(rows, asked), *rows)}.values()]


def _best_of(
    rows: "list[stages.Row]", asked: "stages.Sweep", source: Path, path: Path, count: int
) -> "list[stages.Row]":
    """The designs within bounds that a search tried, the best one first, which is written; so many are shown."""
    best = stages.ranked(rows, asked)
    if all(row.failed for row in rows):
        raise DesignError(f"all {len(rows)} designs of {source} failed, such as: {rows[0].reason}")
    if not best:
        raise DesignError(f"none of {len(rows)} designs is within the bounds of {source}: loosen them or try more.")
    write_text(best[0].design or "", path)
    result = {"trials": asked.samples, "designs": len(rows), "best": best[0].flat(asked.metrics), "file": str(path)}
    current().answer(lambda: result, lambda: stages.best_tables(rows, asked, count), path)
    return best


def _shown(what: str, total: int) -> Callable[["stages.Row"], None]:
    """Progress of rows as a bar."""
    advance = current().bars.begin(what, total=total)
    advance(0, "workers begin")
    return lambda row: advance(1, f"failed: {row.reason[:60]}" if row.failed else f"{row.metrics['seconds']:.1f} s")


@job()
def doctor(*, compute: bool = True) -> "list[stages.Check]":
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
    caller, checks = current(), list(stages.check_surroundings())
    if compute:
        advance = caller.bars.begin("known answers", total=len(stages.KNOWN))
        for check in stages.check_answers():
            advance(1, check.name)
            checks.append(check)
    wrong, lines = sum(check.state == "wrong" for check in checks), []
    for check in checks:
        lines.append(f"{MARKS[check.state]} {check.name:32} {check.found}")
        if check.advice:
            lines.append(f"    {check.advice}")
    lines.append(f"{wrong} of {len(checks)} checks failed" if wrong else "all is well")
    result = {"checks": [asdict(check) for check in checks], "wrong": wrong}
    caller.answer(lambda: result, "\n".join(lines), code=1 if wrong else 0)
    return checks
