"""The search for the best design within bounds: TPE of optuna, seeded; every trial is kept, so it can be resumed."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.errors import NotWrittenError
from geometry.storage.files import FULL, digest, explained, stated
from tripillar.sweep.rows import Row
from tripillar.sweep.run import judge_all, kept_rows
from tripillar.sweep.sampling import Sample, sample_at
from tripillar.sweep.sweep_file import Sweep
from tripillar.sweep.workers import Workers

if TYPE_CHECKING:
    import optuna

START = 16  #: trials drawn evenly before the search leans on any
OUTSIDE = 1e9  #: value of a design out of bounds, times how far it is; only the order of values matters to TPE


def open_study(sweep: Sweep, journal: Path) -> "optuna.Study":
    """The study of a sweep in a journal file, with the trials of earlier runs; another sweep is another study."""
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(logging.WARNING)
    journal.parent.mkdir(parents=True, exist_ok=True)
    _drop_torn_line(journal)
    study = optuna.create_study(
        storage=JournalStorage(JournalFileBackend(str(journal))),
        study_name=digest("study", {**stated(sweep), "samples": None}),
        load_if_exists=True,
    )
    # trials that a killed run left unfinished stay so: they may as well be those of another run, in progress now
    done = len(finished(study, sweep))
    # another seed after each stop, or the search would draw the numbers of its beginning again
    study.sampler = optuna.samplers.TPESampler(
        seed=(sweep.seed + done) % 2**32, multivariate=True, n_startup_trials=START
    )
    return study


@contextmanager
def written(journal: Path) -> Iterator[None]:
    """Name the journal in errors of a full disk: optuna's errors name no file."""
    try:
        yield
    except OSError as error:
        if error.errno not in FULL or error.filename is not None:
            raise
        raise NotWrittenError(explained(error, journal)) from None


def _drop_torn_line(journal: Path) -> None:
    """Cut off a half-written last line: optuna takes only whole ones."""
    if journal.exists() and not (kept := journal.read_bytes()).endswith(b"\n"):
        with journal.open("r+b") as file:
            file.truncate(kept.rfind(b"\n") + 1)


def finished(study: "optuna.Study", sweep: Sweep) -> list[Sample]:
    """The designs of the trials that have ended."""
    from optuna.trial import TrialState

    return [_sample(sweep, trial.params) for trial in study.get_trials(states=[TrialState.COMPLETE])]


def search(
    sweep: Sweep,
    study: "optuna.Study",
    workers: Workers,
    folder: Path,
    progress: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Go on with a study until it has as many trials as the sweep has samples; the rows of its designs, each once.

    Trials are asked for in batches, one a worker, and told in their order: the search does not depend on which of a
    batch ends first. `progress` is called with the row of each trial.
    """
    from optuna.distributions import BaseDistribution, FloatDistribution

    space: dict[str, BaseDistribution] = {variable.name: FloatDistribution(0.0, 1.0) for variable in sweep.variables}
    done = finished(study, sweep)
    rows = kept_rows(done, folder)

    def judged(samples: list[Sample]) -> None:
        missing = {sample.cache_key: sample for sample in samples if sample.cache_key not in rows}
        rows.update(judge_all(list(missing.values()), sweep.judging, workers, folder))

    judged(done)
    while len(done) < sweep.samples:
        width = min(workers.count, sweep.samples - len(done))
        trials = [study.ask(space) for _ in range(width)]
        batch = [_sample(sweep, trial.params) for trial in trials]
        judged(batch)
        for trial, sample in zip(trials, batch, strict=True):
            study.tell(trial, value(rows[sample.cache_key], sweep))
            done.append(sample)
            progress(rows[sample.cache_key])
    return list(rows.values())


def value(row: Row, sweep: Sweep) -> float:
    """The number that the search minimises: the sweep's metric within the bounds, `OUTSIDE` and more beyond them."""
    metric = row.metrics.get(sweep.least)
    excess = sweep.excess(row.metrics)
    if row.failed or metric is None:
        return 1e3 * OUTSIDE
    return OUTSIDE * (1.0 + min(excess, 100.0)) if excess else metric


def _sample(sweep: Sweep, shares: dict[str, float]) -> Sample:
    return sample_at(sweep, [variable.at(shares[variable.name]) for variable in sweep.variables])
