"""The search for the best design within bounds: TPE of optuna, seeded and asked in batches of one size.

It is the same search however many workers there are, so one that was stopped finds its rows in the journal as it is
gone through again.
"""

import logging
from collections.abc import Callable

from common.pool import Pool
from common.storage.journal import Journal
from tripillar.sweeps.rows import Row
from tripillar.sweeps.run import judge_all, kept_rows
from tripillar.sweeps.sampling import sample_at
from tripillar.sweeps.sweep_file import Sweep

START = 16  #: trials drawn evenly before the search leans on any
BATCH = 4  #: trials asked for at a time
OUTSIDE = 1e9  #: value of a design out of bounds, times how far it is; only the order of values matters to TPE


def search(sweep: Sweep, pool: Pool, journal: Journal, progress: Callable[[Row], None] = lambda row: None) -> list[Row]:
    """As many trials as the sweep has samples; the rows of their designs, each once.

    `progress` is called with the row of each trial.
    """
    import optuna

    optuna.logging.set_verbosity(logging.WARNING)
    study = optuna.create_study(
        sampler=optuna.samplers.TPESampler(seed=sweep.seed, multivariate=True, n_startup_trials=START)
    )
    space: dict[str, optuna.distributions.BaseDistribution] = {
        variable.name: optuna.distributions.CategoricalDistribution(variable.values)
        if variable.changes
        else optuna.distributions.FloatDistribution(0.0, 1.0)
        for variable in sweep.variables
    }
    rows: dict[str, Row] = {}
    for first in range(0, sweep.samples, BATCH):
        trials = [study.ask(space) for _ in range(min(BATCH, sweep.samples - first))]
        tried = [[(each, trial.params[each.name]) for each in sweep.variables] for trial in trials]
        # of a choice one of its texts, else a share of its range
        samples = [sample_at(sweep, [at if isinstance(at, str) else each.at(at) for each, at in one]) for one in tried]
        new = {sample.cache_key: sample for sample in samples if sample.cache_key not in rows}
        rows |= kept_rows(new.values(), journal)
        missing = [sample for key, sample in new.items() if key not in rows]
        rows |= judge_all(missing, sweep.judging, pool, journal)
        for trial, sample in zip(trials, samples, strict=True):
            study.tell(trial, value(rows[sample.cache_key], sweep))
            progress(rows[sample.cache_key])
    return list(rows.values())


def value(row: Row, sweep: Sweep) -> float:
    """The number that the search minimises: the sweep's metric within the bounds, `OUTSIDE` and more beyond them."""
    metric = row.metrics.get(sweep.least)
    excess = sweep.excess(row.metrics)
    if row.failed or metric is None:
        return 1e3 * OUTSIDE
    return OUTSIDE * (1.0 + min(excess, 100.0)) if excess else metric
