"""The search for the best design within bounds: TPE of optuna, seeded; every trial is kept, so it can be resumed."""

import logging
from collections.abc import Callable

from geometry.pool import Pool
from geometry.storage.files import digest, stated
from geometry.storage.journal import Journal
from tripillar.sweep.rows import Row
from tripillar.sweep.run import judge_all, kept_rows
from tripillar.sweep.sampling import Sample, sample_at
from tripillar.sweep.sweep_file import Sweep

START = 16  #: trials drawn evenly before the search leans on any
OUTSIDE = 1e9  #: value of a design out of bounds, times how far it is; only the order of values matters to TPE

Shares = dict[str, float]  #: a trial: the place of each variable in its range, from 0 to 1


def tried(sweep: Sweep, trials: Journal) -> list[Shares]:
    """The trials of earlier runs of a sweep, in their order; another sweep has others, one of more samples the same."""
    found: list[Shares] = []
    while (shares := trials.read(trial_key(sweep, len(found)), lambda plain: {**plain})) is not None:
        found.append(shares)
    return found


def search(
    sweep: Sweep,
    pool: Pool,
    journal: Journal,
    trials: Journal,
    progress: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Go on with a search until it has as many trials as the sweep has samples; the rows of its designs, each once.

    Trials are asked for in batches, one a worker, and told in their order: the search does not depend on which of a
    batch ends first. `progress` is called with the row of each trial.
    """
    import optuna

    optuna.logging.set_verbosity(logging.WARNING)
    done = tried(sweep, trials)
    # another seed after each stop, or the search would draw the numbers of its beginning again
    sampler = optuna.samplers.TPESampler(
        seed=(sweep.seed + len(done)) % 2**32, multivariate=True, n_startup_trials=START
    )
    study = optuna.create_study(sampler=sampler)
    space: dict[str, optuna.distributions.BaseDistribution] = {
        variable.name: optuna.distributions.FloatDistribution(0.0, 1.0) for variable in sweep.variables
    }
    rows: dict[str, Row] = {}

    def values(batch: list[Shares]) -> list[float]:
        """The number of each trial that the search minimises."""
        samples = {sample.cache_key: sample for sample in (trial_sample(sweep, shares) for shares in batch)}
        rows.update(kept_rows([sample for key, sample in samples.items() if key not in rows], journal))
        missing = [sample for key, sample in samples.items() if key not in rows]
        rows.update(judge_all(missing, sweep.judging, pool, journal))
        return [value(rows[trial_sample(sweep, shares).cache_key], sweep) for shares in batch]

    for shares, number in zip(done, values(done), strict=True):
        study.add_trial(optuna.trial.create_trial(params=shares, distributions=space, value=number))
    while len(done) < sweep.samples:
        asked = [study.ask(space) for _ in range(min(pool.count(), sweep.samples - len(done)))]
        for trial, number in zip(asked, values([trial.params for trial in asked]), strict=True):
            study.tell(trial, number)
            trials.keep(trial_key(sweep, len(done)), trial.params)
            done.append(trial.params)
            progress(rows[trial_sample(sweep, trial.params).cache_key])
    return list(rows.values())


def trial_sample(sweep: Sweep, shares: Shares) -> Sample:
    """The design of a trial."""
    return sample_at(sweep, [variable.at(shares[variable.name]) for variable in sweep.variables])


def trial_key(sweep: Sweep, number: int) -> str:
    """Where a journal keeps a trial."""
    return f"{digest('study', {**stated(sweep), 'samples': None})}-{number:06d}"


def value(row: Row, sweep: Sweep) -> float:
    """The number that the search minimises: the sweep's metric within the bounds, `OUTSIDE` and more beyond them."""
    metric = row.metrics.get(sweep.least)
    excess = sweep.excess(row.metrics)
    if row.failed or metric is None:
        return 1e3 * OUTSIDE
    return OUTSIDE * (1.0 + min(excess, 100.0)) if excess else metric
