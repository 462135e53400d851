"""The paper's experiments of sections 3.2 and 3.3: samples, networks, and all trainings in one go."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product

import numpy as np

from common.pool import in_parallel
from common.storage.files import digest
from dataset import Samples
from dataset.resistance import pillar_strains
from dataset.settings import DatasetSettings
from dataset.simulation import LoadError, dataset_cache_key, simulate
from decoupler.data.columns import Columns, component_named, force_columns
from decoupler.evaluation.crossval import Job, fold, jobs_of, split_folds
from decoupler.evaluation.metrics import ForceErrors, component_errors, pca_floor
from decoupler.model.baseline import HOOKE, LINEAR, LeastSquares, hooke_forces
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.model_file import METHOD
from fem.array.response import ArrayResponse
from geometry.layout import FloatArray
from studies.paper.printed import MEAN_OVER_WIDTHS
from studies.paper.printed import TABLE_2 as PRINTED_TABLE_2
from studies.paper.results import DataSet, Result, ResultKey, Results, ShownForces
from tripillar.terminal.progress import Bars

VERSION = 3  #: raise when the same settings give other trials
FIGURE_9, TABLE_2 = "figure 9", "table 2"
LOADS = ("contact", "independent")  #: protocols by what comes before the component
COMPONENTS = ("fz", "fx")
CAPS = tuple(MEAN_OVER_WIDTHS)  #: largest strains of figure 9; table 2 and figure 11 have the first
TABLE_2_SAMPLES = tuple(PRINTED_TABLE_2)

PAPERS, SKIP, INFORMED, FLOOR = "plain, LM", "skip", "skip + response", "PCA floor"
#: networks by name; the paper's takes its number of nodes from the trial
NETWORKS = {
    PAPERS: (NetworkConfig(net="plain", feature="resistance"), TrainingConfig(trainer="lm")),
    SKIP: (NetworkConfig(hidden=36, feature="root"), TrainingConfig()),
    INFORMED: (NetworkConfig(hidden=17, feature="inverse"), TrainingConfig()),
}


@dataclass(frozen=True, kw_only=True)
class Experiments:
    """Settings of the experiments; by default as in the paper, section 3.2 and 3.3."""

    widths: tuple[int, ...] = tuple(range(10, 20))  #: nodes of figure 9: eq. 16 for 36 inputs and 36 outputs
    training_samples: int = 2000  #: of figures 9 and 11
    test_samples: int = 200
    folds: int = 10
    table_nodes: Mapping[str, int] = field(default_factory=lambda: {"fz": 16, "fx": 17})  #: text of section 3.3
    shown_nodes: int = 17  #: of figure 11: the paper's best for Fz, section 3.2
    shown_samples: int = 10
    seed: int = 1  #: of the samples

    def data_settings(self, loads: str, component: str, cap: float) -> DatasetSettings:
        """The samples of one kind: those of figure 9, of which table 2 takes the first."""
        samples = max(self.training_samples + self.test_samples, *TABLE_2_SAMPLES)
        return DatasetSettings(protocol=f"{loads}-{component}", samples=samples, seed=self.seed, cap=cap)


Kinds = dict[tuple[str, str, float], Samples]  #: by loads, component and cap


def cache_key_of(response: ArrayResponse, asked: Experiments) -> str:
    """Hash of all that the results depend on."""
    data = [dataset_cache_key(response, asked.data_settings(*kind)) for kind in product(LOADS, COMPONENTS, CAPS)]
    networks = [part for pair in NETWORKS.values() for part in pair]
    return digest("paper", VERSION, METHOD, data, asked, *networks)


def run_experiments(response: ArrayResponse, asked: Experiments, bars: Bars) -> Results:
    """Train and test everything, in as many processes as there are cores."""
    kinds, data_sets = simulate_all(response, asked)
    planned = [*plan_figure_9(response, asked, kinds), *plan_table_2(response, asked, kinds)]
    shown = list(plan_figure_11(response, asked, kinds))
    advance = bars.begin("trainings", total=len(planned) + len(shown))
    jobs = [*(job for _, job in planned), *(job for _, job in shown)]
    outcomes = in_parallel(jobs, lambda number: advance(1, ""))
    trained, forces = outcomes[: len(planned)], outcomes[len(planned) :]
    results = [
        _result(trial, one.errors[trial.component], one.reason)
        for (trial, _), one in zip(planned, trained, strict=True)
    ]
    pairs = zip(shown, forces, strict=True)
    return Results(
        data_sets=tuple(data_sets),
        results=(*results, *floors(asked, kinds), *marks(asked, kinds)),
        shown=tuple(replace(one, decoupled_n=tuple(n.ravel().tolist())) for (one, _), n in pairs),
    )


def simulate_all(response: ArrayResponse, asked: Experiments) -> tuple[Kinds, list[DataSet]]:
    """The samples of every kind, and their description; none where a cap below the first leaves no samples."""
    kinds, described = {}, []
    for loads, component, cap in product(LOADS, COMPONENTS, CAPS):
        settings = asked.data_settings(loads, component, cap)
        try:
            made = simulate(response, settings)
        except LoadError:
            if cap == CAPS[0]:
                raise
            continue  # of these loads none strains so little, as of plates pressed one by one
        kinds[loads, component, cap] = data = made.labels()
        assert made.displacement_mm is not None
        assert made.length_mm is not None
        strain = pillar_strains(made.displacement_mm, made.length_mm, response.design.unit).max()
        widest = pca_floor(data.force_n[: asked.training_samples], component_named(component), max(asked.widths))
        described.append(
            DataSet(
                loads=loads, component=component, cap=cap, content_hash=data.content_hash, largest_strain=float(strain),
                least_mse=widest.scaled_mse,
            )
        )  # fmt: skip
    return kinds, described


def plan_figure_9(response: ArrayResponse, asked: Experiments, kinds: Kinds) -> Iterator[tuple[ResultKey, Job]]:
    """The paper's network at every width, and ours at its one."""
    trained_on, tested_on = _split(asked)
    for (loads, component, cap), data in kinds.items():
        trial_of = partial(
            ResultKey, experiment=FIGURE_9, loads=loads, component=component, cap=cap,
            samples=len(trained_on) + len(tested_on),
        )  # fmt: skip
        for name, widths in ((PAPERS, asked.widths), (INFORMED, (NETWORKS[INFORMED][0].hidden,))):
            network, training = NETWORKS[name]
            for hidden in widths:
                sized = replace(network, hidden=hidden)
                settings = {"component": component, "network": sized, "training": training, "response": response}
                job = (fold, data, settings, trained_on, tested_on)
                yield trial_of(network=name, hidden=hidden), job


def plan_table_2(response: ArrayResponse, asked: Experiments, kinds: Kinds) -> Iterator[tuple[ResultKey, Job]]:
    """Cross-validation of every network on the large and the small set."""
    for loads, component, size in product(LOADS, COMPONENTS, TABLE_2_SAMPLES):
        data = kinds[loads, component, CAPS[0]][:size]
        trial_of = partial(ResultKey, experiment=TABLE_2, loads=loads, component=component, cap=CAPS[0], samples=size)
        for name, (usual, training) in NETWORKS.items():
            network = replace(usual, hidden=asked.table_nodes[component]) if name == PAPERS else usual
            jobs = jobs_of(data, component, network, training, asked.folds, response)
            for number, job in enumerate(jobs, start=1):
                yield trial_of(network=name, hidden=network.hidden, fold=number), job


def plan_figure_11(response: ArrayResponse, asked: Experiments, kinds: Kinds) -> Iterator[tuple[ShownForces, Job]]:
    """Forces Fz of random test samples, still without the decoupled ones."""
    trained_on, tested_on = _split(asked)
    some = np.random.default_rng(asked.seed).choice(tested_on, asked.shown_samples, replace=False)
    fz = component_named("fz")
    for loads, name in product(LOADS, (PAPERS, INFORMED)):
        data = kinds[loads, fz.name, CAPS[0]]
        network, training = NETWORKS[name]
        network = replace(network, hidden=asked.shown_nodes) if name == PAPERS else network
        shown = ShownForces(
            loads=loads, network=name, hidden=network.hidden, samples=tuple(some.tolist()),
            actual_n=tuple(force_columns(data.force_n[some], fz).ravel().tolist()), decoupled_n=(),
        )  # fmt: skip
        yield shown, (decoupled_forces, data, fz.name, network, training, response, trained_on, some)


def decoupled_forces(
    data: Samples, component: str, network: NetworkConfig, training: TrainingConfig, response: ArrayResponse,
    trained_on: np.ndarray, shown: np.ndarray,
) -> FloatArray:  # fmt: skip
    """Train on some samples and give the forces of others [N]; for another process, like `crossval.fold`."""
    from decoupler import train  # loads torch: in the processes that train, and only there

    model = train(data[trained_on], component, network, training, response=response)
    return model.forces(data.resistance_ohm[shown])


def floors(asked: Experiments, kinds: Kinds) -> Iterator[Result]:
    """Error of the best projection: of figure 9's test forces at every width, of table 2's sets at their nodes."""
    tested_on = _split(asked)[1]
    for (loads, name, cap), data in kinds.items():
        wanted = [(FIGURE_9, data.force_n[tested_on], hidden) for hidden in asked.widths]
        if cap == CAPS[0]:
            wanted += [(TABLE_2, data.force_n[:size], asked.table_nodes[name]) for size in TABLE_2_SAMPLES]
        trial_of = partial(ResultKey, loads=loads, component=name, cap=cap, network=FLOOR)
        for experiment, force_n, hidden in wanted:
            errors = pca_floor(force_n, component_named(name), hidden).projection[name]
            yield _result(trial_of(experiment=experiment, samples=len(force_n), hidden=hidden), errors)


def marks(asked: Experiments, kinds: Kinds) -> Iterator[Result]:
    """Errors of eq. 8 and of least squares on table 2's sets, the latter cross-validated on the networks' folds."""
    for loads, name, size in product(LOADS, COMPONENTS, TABLE_2_SAMPLES):
        data, component = kinds[loads, name, CAPS[0]][:size], component_named(name)
        assert data.design is not None, "simulated data state their design"
        forces = {HOOKE: hooke_forces(data.resistance_ohm, data.design, component)}
        forces[LINEAR] = np.empty_like(forces[HOOKE])
        for part in split_folds(size, asked.folds, TrainingConfig().seed):
            others = np.setdiff1d(np.arange(size), part)
            fitted = LeastSquares.fitted(Columns.of(data[others], component))
            forces[LINEAR][part] = fitted.forces(data.resistance_ohm[part])
        trial_of = partial(ResultKey, experiment=TABLE_2, loads=loads, component=name, cap=CAPS[0], samples=size)
        for network, found in forces.items():
            yield _result(trial_of(network=network), component_errors(found, data, component)[name])


def _split(asked: Experiments) -> tuple[np.ndarray, np.ndarray]:
    """Sample numbers of figure 9's training and test set."""
    numbers = np.arange(asked.training_samples + asked.test_samples)
    return numbers[: asked.training_samples], numbers[asked.training_samples :]


def _result(trial: ResultKey, errors: ForceErrors, reason: str = "") -> Result:
    assert errors.rel_err is not None, "no pad of these loads goes free, so eq. 17 has a meaning"
    return Result(trial=trial, rel_err=errors.rel_err, reason=reason)
