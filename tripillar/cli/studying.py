"""The commands of whole studies: the pipeline, sweeps of designs and the search for the best; and of this machine."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from geometry.errors import DesignError
from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    answer,
    chosen,
    output_folder,
    progress_bars,
    say,
    wrote,
)
from tripillar.terminal.interrupts import last_words

if TYPE_CHECKING:
    from geometry.storage.journal import Journal
    from tripillar.sweep.rows import Row
    from tripillar.sweep.sweep_file import Sweep
    from tripillar.terminal.progress import Bars


SweepArgument = Annotated[Path, typer.Argument(help="Sweep file (TOML): what is varied, and how.")]
OutOption = Annotated[
    Path,
    typer.Option(
        "--out", "-o", callback=output_folder, help="Folder for rows, tables and pictures, named after the sweep file."
    ),
]
WorkersOption = Annotated[
    int | None, typer.Option("--workers", help="Number of worker processes; default: one a core.")
]
SchedulerOption = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler to use instead of processes here.")
]
TrainOption = Annotated[bool, typer.Option("--train", help="Train the network of every design, too.")]
RetryOption = Annotated[bool, typer.Option("--retry", help="Try designs that failed before once more.")]
MARKS = {"ok": "✓", "optional": "·", "wrong": "✗"}


def run(
    design: DesignOption = None,
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_folder, help="Folder for all files.")] = Path(
        "out"
    ),
    until: Annotated[Literal["dataset", "table"], typer.Option(help="Last stage to run.")] = "table",
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Run the whole pipeline, from a design to a table of errors.

    The stages are CAD, response, unit, data sets, networks and table. What did not change is not made again.
    """
    from tripillar.cli.tables import comparison_table, stage_table, touch_table
    from tripillar.pipeline.run import run_pipeline

    sensor = chosen(design)
    with progress_bars(verbosity) as bars:
        result = run_pipeline(sensor, out, bars, until_dataset=until == "dataset")
    of_errors = (comparison_table, touch_table) if result.comparisons else ()
    answer(
        json_,
        result.as_plain(),
        lambda: [*(table(result.comparisons) for table in of_errors), stage_table(result.stages)],
        *result.files,
    )


def sweep(
    file: SweepArgument,
    out: OutOption = Path("out"),
    count: WorkersOption = None,
    scheduler: SchedulerOption = None,
    train: TrainOption = False,
    retry: RetryOption = False,
    best: Annotated[int, typer.Option(help="Number of designs in the printed table.")] = 8,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Compare many designs by error, range, crosstalk and cost.

    The same command again goes on where it was stopped.
    """
    require_counts(workers=count, best=best)
    require_packages("pyarrow", "matplotlib", *(["dask", "distributed"] if scheduler else []))
    from geometry.pool import open_pool
    from geometry.storage.journal import Journal
    from tripillar.sweep.rows import write_parquet
    from tripillar.sweep.run import are_cached, judge_all, kept_rows
    from tripillar.sweep.sampling import samples_of
    from tripillar.sweep.trade_offs import best_table, draw_parallel, draw_pareto, ranked, reasons

    asked = sweep_of(file, train)
    samples = samples_of(asked)
    journal = Journal(out / f"{file.stem}-rows")
    found = kept_rows(samples, journal, retry)
    missing = [sample for sample in samples if sample.cache_key not in found]
    if missing:
        log = out / f"{file.stem}-workers.log"
        tasks = 0 if are_cached(missing, asked.judging) else None
        with stoppable(journal), progress_bars(verbosity) as bars, open_pool(count, scheduler, log, tasks) as pool:
            found |= judge_all(missing, asked.judging, pool, journal, shown(bars, "designs", len(missing)))
    rows = [found[sample.cache_key] for sample in samples]
    files = [out / f"{file.stem}.parquet"]
    write_parquet(rows, files[0])
    if not all(row.failed for row in rows):
        files += [out / f"{file.stem}-pareto.png", out / f"{file.stem}-parallel.png"]
        draw_pareto(rows, asked, files[1])
        draw_parallel(rows, asked, files[2])
    failed = reasons(rows)
    result = {
        "designs": len(rows),
        "judged_now": len(missing),
        "failed": {kind: len(each) for kind, each in failed.items()},
        "best": [row.flat() for row in ranked(rows, asked)[:best]],
        "files": [str(path) for path in files],
    }
    answer(json_, result, lambda: [best_table(rows, asked, best)])
    for each in failed.values():
        say(f"{len(each)} failed, such as: {each[0]}")
    wrote(files)


def optimize(
    file: SweepArgument,
    out: OutOption = Path("out"),
    trials: Annotated[
        int | None, typer.Option(help="Number of designs to try in all; default: samples of the file.")
    ] = None,
    count: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Search for the design of least error within bounds.

    The same command again goes on where it was stopped.
    """
    require_counts(workers=count, trials=trials)
    require_packages("optuna", *(["dask", "distributed"] if scheduler else []))
    from geometry.pool import open_pool
    from geometry.storage.files import write_text
    from geometry.storage.journal import Journal
    from tripillar.sweep.optimize import search, trial_sample, tried
    from tripillar.sweep.run import kept_rows
    from tripillar.sweep.trade_offs import best_table, ranked

    asked = sweep_of(file, train=False)
    if trials is not None:
        asked = replace(asked, samples=trials)
    journal, history = Journal(out / f"{file.stem}-rows"), Journal(out / f"{file.stem}-trials")
    done = [trial_sample(asked, shares) for shares in tried(asked, history)]
    rows = list(kept_rows(done, journal).values())
    left = max(0, asked.samples - len(done))
    if left or len(rows) < len({sample.cache_key for sample in done}):
        log = out / f"{file.stem}-workers.log"
        with (
            history.alone(),
            stoppable(journal),
            progress_bars(verbosity) as bars,
            open_pool(count, scheduler, log) as pool,
        ):
            rows = search(asked, pool, journal, history, shown(bars, "trials", left))
    best = ranked(rows, asked)
    if all(row.failed for row in rows):
        raise DesignError(f"all {len(rows)} designs of {file} failed, such as: {rows[0].reason}")
    if not best:
        raise DesignError(f"none of {len(rows)} designs is within the bounds of {file}: loosen them or try more.")
    path = out / f"{file.stem}-best.toml"
    write_text(best[0].design or "", path)
    counts = {"trials": len(done) + left, "tried_now": left, "designs": len(rows)}
    result = counts | {"best": best[0].flat(), "file": str(path)}
    answer(json_, result, lambda: [best_table(rows, asked, 5)], path)


def doctor(
    compute: Annotated[bool, typer.Option(help="Compute what has a known answer, too: about 5 s.")] = True,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Check this machine: versions, solver, display, serial ports, known answers.

    Ends with code 1 if something is wrong.
    """
    from tripillar.doctor.known_answers import KNOWN, check_answers
    from tripillar.doctor.surroundings import check_surroundings

    with progress_bars(verbosity) as bars:
        checks = list(check_surroundings())
        if compute:
            advance = bars.begin("known answers", total=len(KNOWN))
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
    answer(json_, {"checks": [asdict(check) for check in checks], "wrong": wrong}, "\n".join(lines))
    if wrong:
        raise typer.Exit(1)


def sweep_of(file: Path, train: bool) -> "Sweep":
    """The sweep of a file, with or without trained nets."""
    from tripillar.sweep.sweep_file import read_sweep

    asked = read_sweep(file)
    return replace(asked, judging=replace(asked.judging, train=train))


def stoppable(journal: "Journal") -> AbstractContextManager[None]:
    """On Ctrl-C say that what is done is kept."""
    return last_words(f"stopped; the rows in {journal.folder} are kept: give the same command again to go on.")


def shown(bars: "Bars", what: str, total: int) -> Callable[["Row"], None]:
    """Progress of rows as a bar."""
    advance = bars.begin(what, total=total)
    advance(0, "workers begin")
    return lambda row: advance(1, f"failed: {row.reason[:60]}" if row.failed else f"{row.metrics['seconds']:.1f} s")


def require_counts(**counts: int | None) -> None:
    """Refuse options that must be at least 1."""
    for name, count in counts.items():
        if count is not None and count < 1:
            raise DesignError(f"--{name} {count} must be at least 1.")


def require_packages(*names: str) -> None:
    """Refuse to begin without the packages of the extra `sweep`."""
    absent = [name for name in names if find_spec(name) is None]
    if absent:
        raise DesignError(f"{', '.join(absent)} not installed: pip install 'tripillar[sweep]'.")
