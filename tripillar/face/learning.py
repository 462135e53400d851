"""Make samples, and train and test networks on samples that are checked first; the commands call these, too."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from geometry.design import SensorDesign
from geometry.errors import DesignError, require_type
from tripillar.face.bodies import response as response_of

if TYPE_CHECKING:
    from dataset.samples import Samples
    from decoupler.data.enough import AnySamples
    from decoupler.evaluation.assessment import Assessment
    from decoupler.evaluation.crossval import Fold
    from decoupler.evaluation.metrics import ForceErrors
    from decoupler.model.decoupler import Decoupler
    from decoupler.model.settings import Net, NetworkConfig, Trainer, TrainingConfig
    from decoupler.twin.twin_file import TwinFile
    from fem.array.response import ArrayResponse
    from tripillar.face.checks import Caller

Component = Literal["fz", "fx", "fy", "all"]
Feature = Literal["auto", "inverse", "root", "resistance"]


def simulate(
    sensor: "SensorDesign | ArrayResponse | TwinFile | None" = None,
    protocol: str = "three-axis",
    samples: int = 1000,
    *,
    seed: int = 0,
    noise: float = 0.0,
    bits: int | None = None,
    **settings: Any,
) -> "Samples":
    """Simulate labelled samples: forces on the pads, and the resistances they give.

    Parameters
    ----------
    sensor : SensorDesign, ArrayResponse or TwinFile, optional
        Default: the paper's sensor. Of a twin (`decoupler.twin.read_twin`) each sample is another draw of what its
        pairs leave open.
    protocol : str
        Kind of loads: independent-fz, independent-fx, contact-fz, contact-fx, contact, three-axis, light-fz, light-fx
        or light.
    samples : int
        Number of samples.
    seed : int
        Seed of the random loads and noise.
    noise : float
        Standard deviation of a reading, relative to the resistance.
    bits : int, optional
        Bits of the converter; default: exact readings.
    **settings
        Further fields of `dataset.DatasetSettings`, such as cap, gain_spread, offset_ohm or dead_pillars.

    Returns
    -------
    Samples
        ``force_n`` and ``resistance_ohm``, shape (samples, rows, cols, 3), and what lies between.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = tp.simulate(design, "contact", 50, noise=0.001, bits=12, gain_spread=0.1)
    >>> len(samples), samples.resistance_ohm.shape
    (50, (50, 1, 2, 3))
    """
    import dataset
    from fem.array.response import ArrayResponse

    asked = dataset.DatasetSettings(protocol=protocol, samples=samples, seed=seed, noise=noise, bits=bits, **settings)
    if not isinstance(sensor, SensorDesign | ArrayResponse | None):
        from decoupler.twin.twin_file import TwinFile
        from decoupler.twin.twin_samples import simulate_twin

        require_type("sensor", sensor, TwinFile, "give a design, a response or what decoupler.twin.read_twin gave")
        return simulate_twin(sensor, response_of(sensor.design), asked)
    given = response_of(sensor) if sensor is None or isinstance(sensor, SensorDesign) else sensor
    return dataset.simulate(given, asked)


def train(
    samples: "AnySamples",
    component: Component | None = None,
    *,
    net: "Net" = "skip",
    hidden: int = 17,
    trainer: "Trainer" = "varpro",
    feature: Feature = "auto",
    seed: int = 0,
    design: SensorDesign | None = None,
    response: "ArrayResponse | None" = None,
    force: bool = False,
    caller: "Caller | None" = None,
    **settings: Any,
) -> "Decoupler":
    """Train a network that turns resistances into forces.

    Parameters
    ----------
    samples : Samples or StoredSamples
        Simulated or measured; leave those for tests out. Of more than 20,000 a random draw is learned from.
    component : str, optional
        Forces that the network tells: fz, fx, fy or all; default: those that act.
    net : str
        ``plain``, as in the paper, or ``skip`` with a linear map past the hidden layer.
    hidden : int
        Number of hidden nodes.
    trainer : str
        ``varpro`` (variable projection), ``lm`` (Levenberg-Marquardt) or ``momentum``, the paper's.
    feature : str
        Inputs of the network: ``inverse`` (of the response, solved for if need be), ``root`` (√R) or ``resistance``;
        ``auto`` takes the inverse if the response explains the samples, else √R. From samples at finite strain (all
        forces, with displacements) the maps of finite strain are learned, and a net of 60 nodes on draws of them; what
        is linear the response says, whatever linear samples stand beside.
    seed : int
        Seed of the random start.
    design : SensorDesign, optional
        Of samples that state none; default: the response's, or the paper's, if its array has their size.
    response : ArrayResponse, optional
        Of the sensor; default: solved with the default tolerance if need be.
    force : bool
        True trains although the samples look wrong; the model remembers why they did.
    caller : Caller, optional
        Takes messages and shows progress; default: Python's warnings, and no progress.
    **settings
        Further fields of `decoupler.TrainingConfig`, such as goal_mse or max_iterations.

    Returns
    -------
    Decoupler
        ``forces(resistance_ohm)`` gives forces [N], ``half_widths(resistance_ohm)`` those [N] that hold
        68 % and 95 % of their errors.

    Raises
    ------
    DesignError
        If the response is of another design.
    SampleError
        If the samples look wrong or cannot train a network.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = tp.simulate(design, samples=200, noise=0.001)
    >>> model = tp.train(samples, hidden=4)
    >>> model.component.name, model.network.feature
    ('all', 'inverse')
    >>> half_width_n, _ = model.half_widths(samples.resistance_ohm)
    >>> off_n = abs(model.forces(samples.resistance_ohm) - samples.force_n)
    >>> bool(0.6 < (off_n < half_width_n).mean() < 0.76)
    True
    """
    from decoupler.model.settings import TrainingConfig
    from tripillar.face.checks import Caller

    training, caller = TrainingConfig(trainer=trainer, seed=seed, **settings), caller or Caller()
    few = _enough(samples, seed, caller, "train the network")
    parts, network, solved, forced = _checked(few, component, net, hidden, feature, design, response, force, caller)
    from decoupler import train  # loads torch: only once the samples are found right

    advance = caller.bars.begin(f"train {parts}", total=training.max_iterations)
    model = train(samples, parts, network, training, lambda _, mse: advance(1, f"mse {mse:.2e}"), solved)
    return replace(model, made_from=model.made_from | forced)


def evaluate(
    model: "Decoupler",
    samples: "AnySamples",
    *,
    limits: bool = True,
    response: "ArrayResponse | None" = None,
    caller: "Caller | None" = None,
) -> "dict[str, Assessment]":
    """Errors of a model on samples that it has not seen, beside what the readings allow.

    Parameters
    ----------
    model : Decoupler
    samples : Samples or StoredSamples
    limits : bool
        False leaves the limits out, for which the response is needed.
    response : ArrayResponse, optional
        As of `train`.
    caller : Caller, optional
        As of `train`.

    Returns
    -------
    dict of Assessment
        By force: ``errors`` (rel_err, rmse_n, full_scale_pct), ``limits``, ``ratio`` of error and limit, and more.

    Raises
    ------
    DesignError
        If the response is of another design.
    FileFormatError
        If the samples are of another sensor than the model's.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> model = tp.train(tp.simulate(design, samples=1000, seed=1, noise=0.001), hidden=4)
    >>> found = tp.evaluate(model, tp.simulate(design, samples=100, seed=2, noise=0.001))
    >>> list(found), found["fz"].ratio < 1.15
    (['fx', 'fy', 'fz'], True)
    """
    from decoupler import assess, require_same_sensor
    from tripillar.face.checks import Caller, warn_of_test

    caller = caller or Caller()
    require_same_sensor(model, samples, Path(caller.model), Path(caller.samples))
    for name, design in ((caller.samples, samples.design), (caller.model, model.design)):
        if design is None:
            caller.say(f"{name} states no design that can be read: only the array's size was compared")
    solved = _response(samples, samples.design or model.design, response, caller) if limits else None
    warn_of_test(model, samples, solved, caller)
    return assess(model, samples, solved)


def crossval(
    samples: "AnySamples",
    component: Component | None = None,
    folds: int = 10,
    *,
    net: "Net" = "skip",
    hidden: int = 17,
    trainer: "Trainer" = "varpro",
    feature: Feature = "auto",
    seed: int = 0,
    design: SensorDesign | None = None,
    response: "ArrayResponse | None" = None,
    force: bool = False,
    **settings: Any,
) -> "dict[str, ForceErrors]":
    """Cross-validate: test every sample once, by a network that never saw it; folds in parallel processes.

    These processes import the program that calls: it calls below ``if __name__ == "__main__":``.

    Parameters
    ----------
    samples : Samples or StoredSamples
        Of more than 20,000 a random draw is split.
    folds : int
        Number of parts, each tested once.
    component, net, hidden, trainer, feature, seed, design, response, force, **settings
        As of `train`.

    Returns
    -------
    dict of ForceErrors
        By force, the mean over the folds: rel_err, rmse_n, full_scale_pct.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = tp.simulate(design, "contact-fz", 60)
    >>> tp.crossval(samples, folds=2, hidden=4)["fz"].rel_err < 0.0261  # the paper's of ten folds of 2000
    True
    """
    import numpy as np

    from decoupler.evaluation.crossval import over_folds
    from decoupler.model.settings import TrainingConfig
    from tripillar.face.checks import Caller

    training = TrainingConfig(trainer=trainer, seed=seed, **settings)
    _, tested = folds_of(samples, component, folds, training, net, hidden, feature, design, response, force, Caller())
    return over_folds(tested, np.mean)


def folds_of(
    samples: "AnySamples",
    component: Component | None,
    folds: int,
    training: "TrainingConfig",
    net: "Net",
    hidden: int,
    feature: Feature,
    design: SensorDesign | None,
    response: "ArrayResponse | None",
    force: bool,
    caller: "Caller",
) -> "tuple[NetworkConfig, list[Fold]]":
    """The network of a cross-validation, with the inputs that were chosen, and the result of each fold."""
    from decoupler import cross_validate
    from decoupler.data.enough import ENOUGH
    from decoupler.evaluation.crossval import split_folds

    split_folds(min(len(samples), ENOUGH), folds, training.seed)  # refuses too many before anything takes time
    samples = _enough(samples, training.seed, caller, "are split")
    parts, network, solved, _ = _checked(samples, component, net, hidden, feature, design, response, force, caller)
    advance = caller.bars.begin(f"{folds} folds", total=folds)
    return network, cross_validate(samples, parts, network, training, folds, solved, lambda _: advance(1, ""))


def _enough(samples: "AnySamples", seed: int, caller: "Caller", purpose: str) -> "Samples":
    """The samples, or a draw of those that are too many; says so."""
    from decoupler.data.enough import drawn

    few = drawn(samples, seed)
    if len(few) < len(samples):
        caller.say(f"{caller.samples}: {len(few):,} of {len(samples):,} samples, drawn at random, {purpose}")
    return few


def _checked(
    samples: "Samples",
    component: Component | None,
    net: "Net",
    hidden: int,
    feature: Feature,
    design: SensorDesign | None,
    response: "ArrayResponse | None",
    force: bool,
    caller: "Caller",
) -> "tuple[str, NetworkConfig, ArrayResponse | None, dict[str, str]]":
    """Component and network for samples, the response that it starts from, and what a model must remember of doubts."""
    from dataset.samples import require_samples
    from decoupler import component_named
    from decoupler.evaluation.plausibility import doubt, nothing_to_learn
    from decoupler.model.settings import NetworkConfig
    from decoupler.training.suited import suited_component, suited_feature
    from tripillar.face.checks import heed, joint_model, mention

    require_samples("samples", samples)
    automatic, named = feature == "auto", component or suited_component(samples)
    network, parts = NetworkConfig(hidden=hidden, net=net), component_named(named)
    sensor = samples.design or design
    if sensor is None and response is None and _fits(SensorDesign(), samples):
        sensor = SensorDesign()
    forced = heed(nothing_to_learn(samples, parts), force, caller)
    note, solved = "", None
    if net == "skip" if automatic else feature == "inverse":
        solved = _response(samples, sensor, response, caller)
    chosen = suited_feature(samples, parts, net, solved) if feature == "auto" else feature
    if automatic and chosen == "root" and solved is not None and not samples.is_finite.any():
        note = "the response of the design does not explain these data: inputs are √R"
    if automatic and chosen == "inverse" and samples.design is None and response is None:
        which = "the paper's sensor" if design is None else "the given design"
        note = f"the data state no design, but the response of {which} explains them and is used"
    judging = solved
    if samples.design is not None or design is not None or response is not None:
        judging = _response(samples, sensor, response, caller) if solved is None else solved
    elif chosen != "inverse":
        judging = None  # a guessed design that does not explain the samples cannot judge them
    judge = joint_model(judging)
    forced |= heed(None if forced else doubt(samples, parts, judge), force, caller)
    caller.say(note)
    mention(samples, parts, judge, caller)
    return named, replace(network, feature=chosen), solved, forced


def _fits(design: SensorDesign, samples: "AnySamples") -> bool:
    return samples.shape == (design.array.rows, design.array.cols)


def _response(
    samples: "AnySamples", design: SensorDesign | None, given: "ArrayResponse | None", caller: "Caller"
) -> "ArrayResponse | None":
    """The response that is given, or that of the samples' design, solved if need be; None if it is unknown."""
    from fem.array.response import ArrayResponse
    from tripillar.pipeline.run import respond

    if given is None:
        return None if design is None or not _fits(design, samples) else respond(design, caller.bars)[1]
    require_type("response", given, ArrayResponse, "solve one with tripillar.response, or give None")
    if not _fits(given.design, samples) or (design is not None and given.design != design):
        raise DesignError(
            f"the response is of another design than {caller.samples}: solve one with tripillar.response of their "
            "design, or give none."
        )
    return given
