"""Train, cross-validate, test and tune on samples that are checked first, for the commands and for Python alike."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter

import decoupler
from dataset import Samples
from decoupler import Assessment, Decoupler, Fold, NetworkConfig, TrainingConfig
from decoupler.evaluation.crossval import split_folds
from decoupler.evaluation.plausibility import doubt, nothing_to_learn
from decoupler.training.suited import suited_feature
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from tripillar.pipeline.data_checks import Caller, heed, joint_model, mention, mention_another_sensor, warn_of_test
from tripillar.pipeline.run import respond


def train_checked(
    samples: Samples,
    component: str,
    network: NetworkConfig,
    training: TrainingConfig,
    *,
    automatic: bool = True,
    design: SensorDesign | None = None,
    force: bool = False,
    caller: Caller,
) -> tuple[Decoupler, float]:
    """Train a network on samples that pass the checks.

    Parameters
    ----------
    samples : Samples
    component : str
        fz, fx, fy or all.
    network, training : NetworkConfig, TrainingConfig
    automatic : bool
        True replaces the network's feature: by `inverse` if the response explains the samples, else by `root`.
    design : SensorDesign, optional
        Of samples that state none; default: the paper's, if its array has their size.
    force : bool
        True goes on although the samples look wrong; the model remembers why they did.
    caller : Caller

    Returns
    -------
    Decoupler, float
        The model, and the seconds that its training took.

    Raises
    ------
    SampleError
        If the samples look wrong or cannot train a network.
    """
    network, solved, forced = _checked(samples, component, network, automatic, design, force, caller)
    advance = caller.bars.begin(f"train {component}", total=training.max_iterations)
    from decoupler import train  # loads torch, so that doubtful samples are refused before that

    start = perf_counter()
    model = train(samples, component, network, training, lambda _, mse: advance(1, f"mse {mse:.2e}"), solved)
    seconds = perf_counter() - start
    return replace(model, made_from=model.made_from | forced), seconds


def cross_validate_checked(
    samples: Samples,
    component: str,
    network: NetworkConfig,
    training: TrainingConfig,
    folds: int,
    *,
    automatic: bool = True,
    design: SensorDesign | None = None,
    force: bool = False,
    caller: Caller,
) -> tuple[NetworkConfig, list[Fold]]:
    """Cross-validate on samples that pass the checks; parameters and errors as in `train_checked`.

    Returns
    -------
    NetworkConfig, list of Fold
        The network with the feature that was chosen, and what each fold gave.
    """
    split_folds(len(samples), folds, training.seed)  # refuses too many before anything takes time
    network, solved, _ = _checked(samples, component, network, automatic, design, force, caller)
    advance = caller.bars.begin(f"{folds} folds", total=folds)
    tested = decoupler.cross_validate(samples, component, network, training, folds, solved, lambda _: advance(1, ""))
    return network, tested


def assess_checked(model: Decoupler, samples: Samples, limits: bool, caller: Caller) -> dict[str, Assessment]:
    """Errors of a model by force, with what makes them mean less than they seem to told to the caller.

    Raises
    ------
    FileFormatError
        If the samples are of another sensor than the model's.
    """
    decoupler.require_same_sensor(model, samples, Path(caller.model), Path(caller.samples))
    for name, design in ((caller.samples, samples.design), (caller.model, model.design)):
        if design is None:
            caller.say(f"{name} states no design that can be read: only the array's size was compared")
    response = _response(samples.design or model.design, caller) if limits else None
    warn_of_test(model, samples, response, caller)
    return decoupler.assess(model, samples, response)


def fine_tune_checked(model: Decoupler, pairs: Samples, force: bool, caller: Caller) -> Decoupler:
    """Fit a model to one sensor by measured pairs that pass the checks.

    Raises
    ------
    FileFormatError
        If the pairs are of another sensor than the model's.
    SampleError
        If they look wrong and `force` does not go on, or cannot tune the model.
    """
    decoupler.require_same_sensor(model, pairs, Path(caller.model), Path(caller.samples))
    solved = None if model.inverse is not None else _response(pairs.design or model.design, caller)
    judge = joint_model(solved) if model.inverse is None else model.inverse.forward
    forced = heed(doubt(pairs, model.component, judge), force, caller)
    mention(pairs, model.component, joint_model(solved), caller)
    mention_another_sensor(pairs, model.component, judge, caller)
    tuned = decoupler.fine_tune(model, pairs, solved)
    return replace(tuned, made_from=tuned.made_from | forced)


def _checked(
    samples: Samples,
    component: str,
    network: NetworkConfig,
    automatic: bool,
    design: SensorDesign | None,
    force: bool,
    caller: Caller,
) -> tuple[NetworkConfig, ArrayResponse | None, dict[str, str]]:
    """The network for samples, the response that it starts from, and what a model must remember of their doubts."""
    parts = decoupler.component_named(component)
    likely = samples.design or design or SensorDesign()
    fits = samples.force_n.shape[1:3] == (likely.array.rows, likely.array.cols)
    sensor = likely if fits else None
    forced = heed(nothing_to_learn(samples, parts), force, caller)
    note, solved = "", None
    if (network.feature == "inverse" and not automatic) or (automatic and network.net == "skip"):
        solved = _response(sensor, caller)
    if automatic:
        network = replace(network, feature=suited_feature(samples, parts, network.net, solved))
        if network.feature == "root" and solved is not None:
            note = "the response of the design does not explain these data: inputs are √R"
        if network.feature == "inverse" and samples.design is None:
            note = "the data state no design, but the response of --design explains them and is used"
    judging = solved
    if samples.design is not None or design is not None:
        judging = _response(sensor, caller) if solved is None else solved
    elif network.feature != "inverse":
        judging = None  # a guessed design that does not explain the samples cannot judge them
    judge = joint_model(judging)
    forced |= heed(None if forced else doubt(samples, parts, judge), force, caller)
    caller.say(note)
    mention(samples, parts, judge, caller)
    return network, solved, forced


def _response(design: SensorDesign | None, caller: Caller) -> ArrayResponse | None:
    return None if design is None else respond(design, caller.bars)[1]
