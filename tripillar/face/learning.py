"""Train and test networks on samples that are checked first."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from common.errors import DesignError
from decoupler.model.settings import NetworkConfig, TrainingConfig
from geometry.design import SensorDesign, Unit
from geometry.layout import FloatArray, require_told, told_by_tilt, untold
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import (
    DesignLike,
    File,
    Flag,
    ModelLike,
    Options,
    SamplesLike,
    design_of,
    job,
    model_of,
    name_of,
    samples_of,
)  # fmt: skip
from tripillar.face.pressing import TOOL, read_tool

if TYPE_CHECKING:
    SeveralSamples = SamplesLike | Sequence[SamplesLike]
    Response = stages.ArrayResponse | None
    Predictions = FloatArray | File | None
else:
    SeveralSamples = list[Path]
    Predictions = Path | None
    Response = None  # for Python alone

Component = Literal["fz", "fx", "fy", "all"]
AT_REST = 0.005  #: of the largest force, below which a sample counts as of no load
NETWORK = Options(NetworkConfig)
TRAINING = Options(
    TrainingConfig,
    goal_mse=Annotated[float | None, Flag(name=("--goal",))],
    max_iterations=Annotated[int, Flag(name=("--iterations",))],
    **dict.fromkeys(("patience", "least_gain", "held_out", "learning_rate", "momentum")),  # for Python alone
)
READ: dict[str, Any] = {"noise": 0.001, "bits": 12}  #: how a sensor is felt with, where data say nothing else


class Evaluation(dict[str, "stages.Assessment"]):
    """Errors by force; a line each where it is shown."""

    def __repr__(self) -> str:
        lines = []
        for force, one in self.items():
            relative = "" if one.errors.rel_err is None else f"{one.errors.rel_err:.2%}, "
            times = "" if one.ratio is None else f", {one.ratio:.2f} times the limit of the readings"
            lines.append(f"{force}: {relative}RMSE {one.errors.rmse_n:.3g} N{times}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{self!r}</pre>"


@job(out=".safetensors")
def train(
    data: SeveralSamples | None = None,
    component: Component | None = None,
    *,
    touch: bool = False,
    shape: list[File] | None = None,
    out: Annotated[File | None, Flag(required=True)] = None,
    design: DesignLike | None = None,
    response: Response = None,
    force: bool = False,
    **settings: Annotated[Any, TOOL, NETWORK, TRAINING],
) -> "stages.Decoupler | stages.TouchDecoder":
    """Train a network that turns resistances into forces; or make a decoder of whatever presses.

    Parameters
    ----------
    data : Samples, StoredSamples or path, or several
        Data set to train on, not with touch; several of one sensor count as one. Leave samples out for tests; of more
        than 20,000 a random draw is used.
    component : str, optional
        Forces to tell, along one axis or all; default: those that act, or fz if pillars tell no others.
    touch : bool
        Make a decoder of whatever presses, for a design or a twin: on bare rubber in minutes, once; on stiff pads in
        seconds.
    shape : list of path, optional
        Files of tools that press, too, as of 'press'.
    out : path, optional
        Model file to write (.safetensors).
    design : SensorDesign or path, optional
        Design file (TOML) of data that state none; default: the paper's sensor if of their size.
    response : ArrayResponse, optional
        Response of the sensor; default: solved with the default tolerance if need be.
    force : bool
        Go on although the data look wrong; a model remembers why they did.
    **settings
        Fields of `decoupler.NetworkConfig`: hidden, net and feature; of `decoupler.TrainingConfig`: trainer, goal_mse,
        max_iterations, seed, patience, held_out and more; of the tools turn_deg, unit and scale, as of `press`.

    Returns
    -------
    Decoupler or TouchDecoder
        ``forces(resistance_ohm)`` gives forces [N], ``half_widths(resistance_ohm)`` those [N] that hold
        68 % and 95 % of their errors.

    Raises
    ------
    DesignError
        If the response is of another design, or pillars of the layout do not tell the forces asked for.
    SampleError
        If the samples look wrong or cannot train a network.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> samples = tp.dataset(design, samples=200, noise=0.001)
    >>> model = tp.train(samples, hidden=4)
    >>> model.component.name, model.form.feature
    ('all', 'inverse')
    >>> half_width_n, _ = model.half_widths(samples.resistance_ohm)
    >>> off_n = abs(model.forces(samples.resistance_ohm) - samples.force_n)
    >>> bool(0.6 < (off_n < half_width_n).mean() < 0.76)
    True
    """
    caller, path, tool = current(), None if out is None else Path(out), TOOL.of(settings)
    if tool and not shape:
        raise DesignError("turn_deg=, unit= and scale= are of tools: give shape=, their files, too.")
    if touch:
        given = {"data": data, "component": component, "response": response} | settings
        if surplus := [f"{name}=" for name, each in given.items() if each is not None and name not in tool]:
            raise DesignError(f"touch=True learns from presses of its own: leave {' and '.join(surplus)} out.")
        return _touch_decoder(design, path, shape or (), tool)
    if shape:
        raise DesignError("shape= is of decoders of touch: give touch=True with it.")
    if data is None:
        raise DesignError("give data=, samples to train on; or touch=True.")
    network, training = NetworkConfig(**NETWORK.of(settings)), TrainingConfig(**TRAINING.of(settings))
    sources: list[SamplesLike] = [*data] if isinstance(data, list | tuple) else [data]  # type: ignore[list-item]
    name = name_of(sources[0], "samples")
    samples = _of_design(_together(sources), name, design)
    few = stages.enough(samples, training.seed, name, "train the network")
    parts, network, solved, forced = _checked(few, name, network, response, component, force)
    if solved is None and samples.design is None:
        caller.say(f"{name} states no design: with design=FILE the network learns from the sensor's response, too")
    advance = caller.bars.begin(f"train {parts}", total=training.max_iterations)
    model = stages.train(samples, parts, network, training, lambda _, mse: advance(1, f"mse {mse:.2e}"), solved)
    model, seconds = replace(model, made_from=model.made_from | forced | _at_rest(few)), caller.bars.seconds()
    if path is not None:
        stages.write_model(model, path)
    _mention_untrusted(model)

    def result() -> dict[str, Any]:
        told = {name: model.made_from["outcome"][name] for name in ("iterations", "mse", "reason")}
        errors = {force: asdict(values) for force, values in stages.errors_on(model, samples).items()}
        untrusted = [f"{force} row {row} col {col}" for row, col, force in model.untrusted()]
        made = {"file": str(out), "feature": model.form.feature} | told | {"seconds": seconds}
        return made | {"training_errors": errors, "untrusted": untrusted}

    outcome = model.made_from["outcome"]
    text = f"{outcome['iterations']} iterations in {seconds:.1f} s to mse {outcome['mse']:.2e} ({outcome['reason']})"
    caller.answer(result, text, out)
    return model


OF_DATA = Options(train, "component", "design", "force")


@job()
def evaluate(
    model: ModelLike | None = None,
    data: Annotated[SamplesLike | None, Flag(required=True)] = None,
    *,
    limits: bool = True,
    folds: int | None = None,
    predictions: Predictions = None,
    response: Response = None,
    **training: Annotated[Any, OF_DATA, NETWORK, TRAINING],
) -> "dict[str, stages.Assessment]":
    """Show the errors of a model, or of another's predictions, beside what the readings allow; or cross-validate.

    Errors are relative (the paper's eq. 17), root mean square, and in % of full scale, beside two simpler methods. With
    folds every sample is tested once, by a network that never saw it.

    Parameters
    ----------
    model : Decoupler or path, or None
        Model file; not with folds.
    data : Samples, StoredSamples or path
        Data set to test on, which the model has not seen; with folds at most 20,000 samples at random.
    limits : bool
        Compute the least error that the readings allow, too.
    folds : int, optional
        Number of parts to cross-validate; the paper uses 10.
    predictions : array or path, optional
        Forces of another program for the same data, in place of a model: a NetCDF file with force_n (sample, row, col,
        axis) [N], samples in their order, NaN along axes left out.
    response : ArrayResponse, optional
        Response of the sensor; default: solved with the default tolerance if need be.
    **training
        With folds: component, design, force, hidden, net, trainer, seed and more, as of `train`.

    Returns
    -------
    dict of Assessment
        By force, shown as a line each: ``errors`` (rel_err, rmse_n, full_scale_pct), ``limits``, ``ratio`` of error and
        limit, and more; with folds the errors alone, their mean over the folds.

    Raises
    ------
    DesignError
        If the response is of another design.
    FileFormatError
        If the samples are of another sensor than the model's.

    Notes
    -----
    Folds run in parallel processes, which import the program that calls: call below ``if __name__ == "__main__":``.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> model = tp.train(tp.dataset(design, samples=1000, seed=1, noise=0.001), hidden=4)
    >>> found = tp.evaluate(model, tp.dataset(design, samples=100, seed=2, noise=0.001))
    >>> list(found), found["fz"].ratio < 1.15
    (['fx', 'fy', 'fz'], True)
    >>> tested = tp.evaluate(None, tp.dataset(design, "contact-fz", 60), folds=2, hidden=4)
    >>> tested["fz"].errors.rel_err < 0.0261  # the paper's of ten folds of 2000
    True
    """
    caller, name, named = current(), name_of(data, "samples"), name_of(model, "model")
    if data is None:
        raise DesignError("give data=, samples to test on.")
    if sum(each is None for each in (model, folds, predictions)) != 2:
        raise DesignError("give model=, predictions=, or folds= to cross-validate: one of them.")
    if folds is not None:
        samples = _of_design(samples_of(data), name, training.pop("design", None))
        return _cross_validated(samples, name, folds, response, training)
    if training:
        given = ", ".join(f"{name}=" for name in training)
        raise DesignError(f"a model has its own: leave {given} out, or give folds= to cross-validate.")
    if predictions is not None:
        samples = samples_of(data)
        solved = stages.response_of(samples, name, samples.design, response) if limits else None
        told = stages.read_predictions(Path(predictions)) if isinstance(predictions, Path | str) else predictions
        predicted_n = np.asarray(told, float)
        assessed = Evaluation(stages.assess_predictions(predicted_n, samples, solved))
        stages.warn_of_predictions(predicted_n, samples, name_of(predictions, "predictions"), solved)
        caller.answer(lambda: stages.as_plain(assessed), lambda: [stages.assessment_table(assessed)])
        return assessed
    assert model is not None  # there are neither folds nor predictions
    decoupler, samples = model_of(model), samples_of(data)
    stages.require_same_sensor(decoupler, samples, Path(named), Path(name))
    if sensor := samples.design or decoupler.design:
        caller.say(told_by_tilt(sensor.unit, decoupler.component.axes))
    if isinstance(decoupler, stages.TouchDecoder):
        return _assessed_touch(decoupler, data)
    assert isinstance(decoupler, stages.Decoupler)
    for label, known in ((name, samples.design), (named, decoupler.design)):
        if known is None:
            caller.say(f"{label} states no design that can be read: only the array's size was compared")
    solved = stages.response_of(samples, name, samples.design or decoupler.design, response) if limits else None
    stages.warn_of_test(decoupler, named, samples, name, solved)
    assessed = Evaluation(stages.assess(decoupler, samples, solved))
    stages.warn_of_deviations(decoupler, named, samples, name, assessed)
    _mention_untrusted(decoupler)
    caller.answer(lambda: stages.as_plain(assessed), lambda: [stages.assessment_table(assessed)])
    return assessed


def _cross_validated(
    samples: "stages.AnySamples", name: str, folds: int, response: "stages.ArrayResponse | None", asked: dict[str, Any]
) -> "dict[str, stages.Assessment]":
    """Errors of networks trained, as `train` is asked, on all folds but the one that tests them."""
    network, training = NetworkConfig(**NETWORK.of(asked)), TrainingConfig(**TRAINING.of(asked))
    stages.split_folds(min(len(samples), stages.ENOUGH), folds, training.seed)  # refuses too many before anything
    few = stages.enough(samples, training.seed, name, "are split")
    parts, network, solved, _ = _checked(few, name, network, response, **OF_DATA.of(asked))
    advance = current().bars.begin(f"{folds} folds", total=folds)
    tested = stages.cross_validate(few, parts, network, training, folds, solved, lambda _: advance(1, ""))
    result = {"feature": network.feature} | stages.summary(tested)
    current().answer(lambda: result, lambda: [stages.crossval_table(tested)])
    over_folds = stages.over_folds(tested, np.mean)
    return Evaluation({force: stages.Assessment(errors=errors) for force, errors in over_folds.items()})


def _touch_decoder(
    source: DesignLike | None, out: Path | None, shapes: Sequence[File], tool: dict[str, Any]
) -> "stages.TouchDecoder":
    """A decoder of touches, of a design or of a twin's own sensor; its library comes from the cache or is made."""
    caller, design = current(), design_of(source)
    is_plated = design.pad.kind == "stiff"
    (stages.require_pressable if is_plated else stages.require_bare)(design)
    if (model := design.matrix_material.model) != "linear":
        caller.say(
            f"warning: touches of {model} rubber are pressed on its tangent at rest; those that move the top by more "
            f"than {stages.LARGE_SHARE:g} of the slab's height, {stages.LARGE_SHARE * design.unit.height_mm:g} mm, are "
            "beyond it"
        )
    if is_plated and shapes:
        raise DesignError(
            "shape= is of bare rubber: under stiff pads the decoder takes whatever presses; leave it out."
        )
    solids = [read_tool(shape, **tool) for shape in shapes]
    for note in (note for solid in solids for note in solid.notes):
        caller.say(f"warning: {note}")
    twin = stages.read_twin(Path(source)) if isinstance(source, Path | str) else None
    pillars = stages.Pillars.designed(design)
    if twin is not None:
        pillars = stages.identified_pillars(pillars, twin.read_decoder())
    made_from = {} if twin is None else {"twin": twin.decoder_hash}
    errors = stages.ReadingError(**READ).with_drifts_of(design.electrics)
    of_sensor: dict[str, Any] = {"design": design, "errors": errors}
    of_sensor |= {"pillars": pillars, "made_from": made_from}
    decoder: stages.TouchDecoder
    if is_plated:
        advance = caller.bars.begin("plates", total=1)
        plates, _, reused = stages.plate_response(design, lambda step: advance(0, step))
        made_from["library"] = plates.cache_key
        decoder = stages.PlateDecoder(library=plates, **of_sensor)
        result, text = {"plates": design.n_units}, f"{design.n_units} plates"
    else:
        advance = caller.bars.begin("presses", total=stages.PRESSES + stages.OWN_PRESSES * len(shapes))
        library, _, reused = stages.touch_library(design, stages.PRESSES, lambda done: advance(done, ""), solids)
        made_from["library"] = library.cache_key
        decoder = stages.BareDecoder(library=library, **of_sensor)
        result = {"presses": len(library.presses.size), "rows": len(library.source)}
        text = f"{result['presses']} presses in {result['rows']} places{', reused' if reused else ''}"
    if out is not None:
        stages.write_model(decoder, out)
    made = {"file": str(out)} | result | {"reused": reused, "seconds": caller.bars.seconds()}
    caller.answer(lambda: made, text, out)
    return decoder


def _assessed_touch(decoder: "stages.TouchDecoder", data: "SamplesLike") -> "dict[str, stages.Assessment]":
    """Errors of a touch decoder: of units, of the net force and of its place."""
    samples = stages.in_memory(samples_of(data, labels_only=False))
    advance = current().bars.begin("touches", total=len(samples))
    assessed = stages.assess_touch(decoder, samples, lambda done: advance(done, ""))
    current().answer(assessed.plain, lambda: stages.assessed_touch_tables(assessed))
    return assessed.by_force


def _together(sources: "Sequence[SamplesLike]") -> "stages.AnySamples":
    """The samples of one source, or of several joined; at finite strain with their displacements."""
    several = [samples_of(each) for each in sources]
    for each in several:
        stages.require_samples("samples", each, stages.AnySamples)
    if any(each.is_finite.any() for each in several):  # these learn from displacements, too
        several = [samples_of(each, labels_only=False) for each in sources]
    return several[0] if len(several) == 1 else stages.joined([stages.in_memory(each) for each in several])


def _of_design(samples: "stages.AnySamples", name: str, given: "DesignLike | None") -> "stages.AnySamples":
    """The samples, of the design that is given for some that state none."""
    design = None if given is None else design_of(given)
    if design in (None, samples.design):
        return samples
    if samples.design is not None or not stages.fits(design, samples):
        raise DesignError(f"{name} is of another design than design=: leave it out, or give data of that design.")
    return replace(stages.in_memory(samples), design=design)


def _at_rest(samples: "stages.Samples") -> dict[str, Any]:
    """Resistances of samples without a load, where no design says what the sensor shows at rest."""
    largest_n = np.abs(samples.force_n).max(axis=(1, 2, 3))
    idle = largest_n <= AT_REST * largest_n.max()
    is_known = samples.design is not None or not idle.any()
    return {} if is_known else {"rest_ohm": np.median(samples.resistance_ohm[idle], axis=0).tolist()}


def _mention_untrusted(model: "stages.Decoupler") -> None:
    """Name the forces that dead pillars leave unsure; JSON has them already, and who has the model can ask it."""
    for row, col, name in model.untrusted() if current().is_typed and not current().as_json else []:
        current().say(f"{name} of the unit in row {row}, col {col} cannot be trusted")


def _checked(
    samples: "stages.Samples", name: str, asked: NetworkConfig, response: "stages.ArrayResponse | None",
    component: Component | None = None, force: bool = False,
) -> "tuple[str, NetworkConfig, stages.ArrayResponse | None, dict[str, str]]":  # fmt: skip
    """Component and network for samples, the response that it starts from, and what a model must remember of doubts."""
    named, is_automatic = component or stages.acting_component(samples.force_n), asked.feature == "auto"
    if component is None and named == "all" and untold(Unit(layout=samples.layout)):
        named = "fz"
    parts = stages.component_named(named)
    sensor = samples.design
    is_stated = sensor is not None or response is not None
    if not is_stated and stages.fits(SensorDesign(), samples):
        sensor = SensorDesign()
    require_told(Unit(layout=samples.layout) if sensor is None else sensor.unit, parts.axes)
    if sensor is not None:
        current().say(told_by_tilt(sensor.unit, parts.axes))
    forced = stages.heed(stages.nothing_to_learn(samples, parts), name, force)
    note, solved = "", None
    if asked.feature == "inverse" or (is_automatic and asked.net != "plain"):
        solved = stages.response_of(samples, name, sensor, response)
    is_finite = samples.is_finite.any()
    stages.require_heeded(samples, name, named == "all" and solved is not None, asked)
    network = stages.suited(samples, named, asked, None, solved).form
    chosen = network.feature
    if is_automatic and chosen == "root" and solved is not None and not is_finite:
        note = "the response of the design does not explain these data: inputs are √R"
    if is_automatic and chosen == "inverse" and samples.design is None and response is None:
        note = "the data state no design, but the response of the paper's sensor explains them and is used"
    # a guessed design that does not explain the samples cannot judge them
    judging = solved if solved is not None and (is_stated or chosen == "inverse") else None
    if judging is None and is_stated:
        judging = stages.response_of(samples, name, sensor, response)
    judge = stages.joint_model(judging)
    forced |= stages.heed(None if forced else stages.doubt(samples, parts, judge), name, force)
    current().say(note)
    stages.mention(samples, name, parts, judge, bool(forced or is_finite))
    return named, network, solved, forced
