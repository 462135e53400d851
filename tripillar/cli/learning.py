"""The commands that make data, and train, test, tune and export networks."""

import sys
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from geometry.errors import DesignError
from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    chosen,
    output_file,
    progress_bars,
    require_other,
    say,
    show_json,
    wrote,
)

if TYPE_CHECKING:
    from decoupler.evaluation.metrics import ForceErrors
    from decoupler.model.decoupler import Decoupler

Protocol = Literal[
    "independent-fz", "independent-fx", "contact-fz", "contact-fx", "contact", "three-axis",
    "light-fz", "light-fx", "light",
]  # fmt: skip
Component = Literal["fz", "fx", "fy", "all"]
UnstatedOption = Annotated[
    Path | None,
    typer.Option("--design", help="Design file (TOML) for data that state none; default: the paper's sensor."),
]
NetOption = Annotated[
    Literal["plain", "skip"],
    typer.Option(help="Network: plain, as in the paper, or with a linear skip past the hidden layer."),
]
TrainerOption = Annotated[
    Literal["varpro", "lm", "momentum"],
    typer.Option(help="Method of training: variable projection, Levenberg-Marquardt, or the paper's (momentum)."),
]
FeatureOption = Annotated[
    Literal["auto", "inverse", "root", "resistance"],
    typer.Option(help="Inputs of the network: inverse (of the known response), root (√R) or resistance; auto chooses."),
]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Go on although the data look wrong; a model remembers why they did.")
]
GoalOption = Annotated[
    float | None,
    typer.Option(help="Mean squared error to stop at, of forces scaled to ± 1; default: the trainer's own."),
]


def dataset(
    protocol: Annotated[
        Protocol,
        typer.Option(
            help="Kind of loads: independent, each pad its own; contact, by a few indenters; three-axis, each along "
            "all axes; light, by 10 N at most. With -fz or -fx along one axis."
        ),
    ],
    samples: Annotated[int, typer.Option(help="Number of samples to make.")],
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_file, help="NetCDF file to write.")],
    seed: Annotated[int, typer.Option(help="Seed of the random loads and noise.")] = 0,
    cap: Annotated[float, typer.Option(help="Largest strain of a pillar; loads past it are drawn again.")] = 0.3,
    noise: Annotated[float, typer.Option(help="Standard deviation of a reading, relative to the resistance.")] = 0.0,
    bits: Annotated[int | None, typer.Option(help="Bits of the converter; default: exact readings.")] = None,
    gain_spread: Annotated[
        float, typer.Option(help="Spread of the pillars' gains: each is uniform in 1 ± this.")
    ] = 0.0,
    offset: Annotated[float, typer.Option(help="Standard deviation of the pillars' offsets [Ω].")] = 0.0,
    specimen: Annotated[int, typer.Option(help="Seed of gains and offsets; each is another specimen.")] = 0,
    dead_pillar: Annotated[
        list[str] | None, typer.Option(metavar="ROW,COL,PILLAR", help="Broken pillar, such as 0,3,z; can be repeated.")
    ] = None,
    dead_row: Annotated[
        list[int] | None, typer.Option(metavar="WIRE", help="Number of a broken row wire, from 0; can be repeated.")
    ] = None,
    dead_col: Annotated[
        list[int] | None, typer.Option(metavar="WIRE", help="Number of a broken column wire, from 0; can be repeated.")
    ] = None,
    crossbar: Annotated[
        Literal["zero-potential", "grounded", "divider"] | None,
        typer.Option(help="Circuit to read the array through, as a board does; default: each pillar alone."),
    ] = None,
    sense_ohm: Annotated[
        float | None, typer.Option(help="Sense or feedback resistor of --crossbar [Ω]; default: one that suits 10 kΩ.")
    ] = None,
    switch_ohm: Annotated[
        float | None, typer.Option(help="Resistance of a closed switch of --crossbar [Ω]; default: 25.")
    ] = None,
    line_ohm: Annotated[float | None, typer.Option(help="Resistance of a wire of --crossbar [Ω]; default: 0.")] = None,
    correct: Annotated[bool, typer.Option(help="Correct the crosstalk of --crossbar, as a live sensor does.")] = True,
    design: DesignOption = None,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Simulate labelled samples: forces on the pads, and the resistances they give."""
    require_other(out, design)
    from dataset import DatasetSettings, simulate
    from dataset.imperfections import place_of
    from tripillar.pipeline.run import respond

    settings = DatasetSettings(
        protocol=protocol,
        samples=samples,
        seed=seed,
        cap=cap,
        noise=noise,
        bits=bits,
        gain_spread=gain_spread,
        offset_ohm=offset,
        specimen=specimen,
        dead_pillars=tuple(map(place_of, dead_pillar or ())),
        dead_rows=tuple(dead_row or ()),
        dead_cols=tuple(dead_col or ()),
    )
    sensor = chosen(design)
    settings.dead_mask(sensor.array.rows, sensor.array.cols)  # refuses what the array lacks before anything is solved
    readout = None
    wires = {"sense_ohm": sense_ohm, "switch_ohm": switch_ohm, "line_ohm": line_ohm}
    given = {name: ohms for name, ohms in wires.items() if ohms is not None}
    if crossbar is None and (given or not correct):
        raise DesignError("--sense-ohm, --switch-ohm, --line-ohm and --no-correct belong to --crossbar: give it, too.")
    if crossbar is not None:
        from hardware.readout.correction import CrossbarReadout
        from hardware.readout.crossbar import Crossbar, scan_mode_named

        wired = Crossbar.suited(
            scan_mode_named(crossbar),
            rows=sensor.array.rows,
            cols=sensor.array.cols,
            bits=bits,
            **given,
        )
        readout = CrossbarReadout(crossbar=wired, corrected=correct)
    with progress_bars(verbosity) as bars:
        _, solved = respond(sensor, bars)
        advance = bars.begin("dataset", total=samples)
        data = simulate(solved, settings, lambda n: advance(n, ""), readout)
    data.write(out)
    redrawn = data.made_from["redrawn"]
    if json_:
        show_json({"file": str(out), "samples": samples, "redrawn": redrawn, "recipe": data.made_from["recipe"]})
    else:
        print(f"{samples} samples, {redrawn} draws passed the cap of {cap:g} and were redrawn")
    wrote([out])


def train(
    data: Annotated[Path, typer.Option(help="Data set to train on.")],
    component: Annotated[Component, typer.Option(help="Forces that the network tells: along one axis, or all.")],
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_file, help="Model file to write (safetensors).")],
    net: NetOption = "skip",
    hidden: Annotated[int, typer.Option(help="Number of hidden nodes.")] = 17,
    trainer: TrainerOption = "varpro",
    feature: FeatureOption = "auto",
    goal: GoalOption = None,
    iterations: Annotated[int, typer.Option(help="Largest number of iterations; 0: the trainer's own.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of the random start.")] = 0,
    design: UnstatedOption = None,
    force: ForceOption = False,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Train a network that turns resistances into forces; write a model file."""
    require_other(out, data, design)
    from dataset import read_samples
    from decoupler.data.columns import component_named
    from decoupler.evaluation.metrics import evaluate as errors_on
    from decoupler.evaluation.plausibility import doubt, nothing_to_learn
    from decoupler.model.model_file import write_model
    from decoupler.model.settings import NetworkConfig, TrainingConfig
    from tripillar.pipeline.data_checks import (
        heed,
        joint_model,
        judging_response,
        likely_design,
        mention,
        suited_network,
    )

    training = TrainingConfig(trainer=trainer, goal_mse=goal, max_iterations=iterations, seed=seed)
    NetworkConfig(hidden=hidden, net=net)  # refuse nonsense before anything takes time
    labelled, parts = read_samples(data, labels_only=True), component_named(component)
    sensor = likely_design(labelled, design)
    forced = heed(data, nothing_to_learn(labelled, parts), force)
    with progress_bars(verbosity) as bars:
        network, solved, note = suited_network(labelled, sensor, component, hidden, net, feature, bars)
        judge = joint_model(judging_response(labelled, design, sensor, network, solved, bars))
        forced |= heed(data, None if forced else doubt(labelled, parts, judge), force)
        say(note)
        mention(data, labelled, parts, judge)
        from decoupler import train as train_network

        advance = bars.begin(f"train {component}", total=training.max_iterations)
        started = perf_counter()
        model = train_network(
            labelled, component, network, training, lambda _, mse: advance(1, f"mse {mse:.2e}"), solved
        )
        seconds, outcome = perf_counter() - started, model.made_from["outcome"]
    write_model(replace(model, made_from=model.made_from | forced), out)
    figures = {
        "feature": network.feature,
        "iterations": outcome["iterations"],
        "mse": outcome["mse"],
        "reason": outcome["reason"],
        "seconds": seconds,
        "training_errors": plain(errors_on(model, labelled)),
        "untrusted": [f"{name} row {row} col {col}" for row, col, name in model.untrusted()],
    }
    if json_:
        show_json({"file": str(out), **figures})
    else:
        iterations, mse, reason = (outcome[name] for name in ("iterations", "mse", "reason"))
        print(f"{iterations} iterations in {seconds:.1f} s to mse {mse:.2e} ({reason})")
        say_untrusted(model)
    wrote([out])


def evaluate(
    model: Annotated[Path, typer.Option(help="Model file.")],
    data: Annotated[Path, typer.Option(help="Data set to test on.")],
    limits: Annotated[bool, typer.Option(help="Also compute the least error that the readings allow.")] = True,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Show the errors of a model on a data set, beside what the readings allow.

    Errors are relative (the paper's eq. 17), root mean square, and in % of full scale; two simpler methods
    stand beside.
    """
    from dataset import read_samples
    from decoupler.evaluation.assessment import assess
    from decoupler.model.model_file import read_model, require_same_sensor
    from tripillar.pipeline.data_checks import known_response, warn_of_test

    decoupler, labelled = read_model(model), read_samples(data, labels_only=True)
    require_same_sensor(decoupler, labelled, model, data)
    for file, stated in ((data, labelled.design), (model, decoupler.design)):
        if stated is None:
            print(f"{file} states no design that can be read: only the array's size was compared", file=sys.stderr)
    with progress_bars(verbosity) as bars:
        solved = known_response(labelled.design or decoupler.design, bars) if limits else None
        warn_of_test(model, decoupler, data, labelled, solved)
        assessed = assess(decoupler, labelled, solved)
    if json_:
        from decoupler.evaluation.assessment import as_plain

        show_json(as_plain(assessed))
    else:
        from tripillar.terminal.tables import assessment_table, show

        show(assessment_table(assessed))
        say_untrusted(decoupler)


def crossval(
    data: Annotated[Path, typer.Option(help="Data set to split.")],
    component: Annotated[Component, typer.Option(help="Forces that the network tells: along one axis, or all.")],
    folds: Annotated[int, typer.Option(help="Number of parts, each tested once; the paper uses 10.")] = 10,
    net: NetOption = "skip",
    hidden: Annotated[int, typer.Option(help="Number of hidden nodes.")] = 17,
    trainer: TrainerOption = "varpro",
    feature: FeatureOption = "auto",
    goal: GoalOption = None,
    seed: Annotated[int, typer.Option(help="Seed of the split and the random start.")] = 0,
    design: UnstatedOption = None,
    force: ForceOption = False,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Cross-validate: test every sample once, by a network that never saw it."""
    from dataset import read_samples
    from decoupler.data.columns import component_named
    from decoupler.evaluation.crossval import cross_validate, split_folds, summary
    from decoupler.evaluation.plausibility import doubt, nothing_to_learn
    from decoupler.model.settings import NetworkConfig, TrainingConfig
    from tripillar.pipeline.data_checks import (
        heed,
        joint_model,
        judging_response,
        likely_design,
        mention,
        suited_network,
    )

    training = TrainingConfig(trainer=trainer, goal_mse=goal, seed=seed)
    NetworkConfig(hidden=hidden, net=net)  # refuse nonsense before anything takes time
    labelled, parts = read_samples(data, labels_only=True), component_named(component)
    split_folds(len(labelled.force_n), folds, seed)
    sensor = likely_design(labelled, design)
    forced = heed(data, nothing_to_learn(labelled, parts), force)
    with progress_bars(verbosity) as bars:
        network, solved, note = suited_network(labelled, sensor, component, hidden, net, feature, bars)
        judge = joint_model(judging_response(labelled, design, sensor, network, solved, bars))
        heed(data, None if forced else doubt(labelled, parts, judge), force)
        say(note)
        mention(data, labelled, parts, judge)
        advance = bars.begin(f"{folds} folds", total=folds)
        tested = cross_validate(labelled, component, network, training, folds, solved, lambda _: advance(1, ""))
    if json_:
        show_json({"feature": network.feature} | summary(tested))
    else:
        from tripillar.terminal.tables import crossval_table, show

        show(crossval_table(tested))


def fine_tune(
    model: Annotated[Path, typer.Option(help="Model file, trained on simulated data.")],
    data: Annotated[Path, typer.Option(help="Data set of measured resistances and forces of one sensor.")],
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_file, help="Model file to write (safetensors).")],
    pairs: Annotated[int | None, typer.Option(help="Number of pairs to use, from the first on; default: all.")] = None,
    force: ForceOption = False,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Fit a model to one real sensor by a few measured pairs.

    A pair is the forces on the pads and the resistances measured under them. Gain and offset of each pillar are fitted
    first, then the network's output layer.
    """
    require_other(out, model, data)
    from dataset import read_samples
    from decoupler.evaluation.metrics import evaluate as errors_on
    from decoupler.evaluation.plausibility import doubt
    from decoupler.model.model_file import read_model, require_same_sensor, write_model
    from decoupler.training.fine_tuning import fine_tune as fine_tuned
    from tripillar.pipeline.data_checks import heed, joint_model, known_response, mention, mention_another_sensor

    if pairs is not None and pairs < 1:
        raise DesignError(f"--pairs {pairs} must be at least 1.")
    decoupler, measured = read_model(model), read_samples(data, labels_only=True)
    require_same_sensor(decoupler, measured, model, data)
    if pairs is not None and pairs > len(measured.force_n):
        raise DesignError(f"--pairs {pairs} must be at most {len(measured.force_n)}: {data} holds no more.")
    measured = measured[:pairs]
    with progress_bars(verbosity) as bars:
        known = measured.design or decoupler.design
        solved = None if decoupler.inverse is not None else known_response(known, bars)
    judge = joint_model(solved) if decoupler.inverse is None else decoupler.inverse.forward
    forced = heed(data, doubt(measured, decoupler.component, judge), force)
    mention(data, measured, decoupler.component, joint_model(solved))
    mention_another_sensor(data, measured, decoupler.component, judge)
    tuned = fine_tuned(decoupler, measured, solved)
    write_model(replace(tuned, made_from=tuned.made_from | forced), out)
    before, after = (errors_on(one, measured) for one in (decoupler, tuned))
    if json_:
        show_json({"pairs": len(measured.force_n), "before": plain(before), "after": plain(after)})
    else:
        for name in after:
            print(
                f"{name}: {before[name].rmse_n:.3g} N before, {after[name].rmse_n:.3g} N after, on the pairs themselves"
            )
    wrote([out])


def export(
    model: Annotated[Path, typer.Option(help="Model file.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", callback=output_file, help="File to write: .onnx, or .h for a header in C.")
    ],
    precision: Annotated[
        Literal["float", "double"] | None,
        typer.Option(help="Precision of the numbers; default: double in .onnx, float in .h."),
    ] = None,
    json_: JsonOption = False,
) -> None:
    """Write a model for other programs: ONNX, or C for a microcontroller."""
    require_other(out, model)
    from decoupler.export import export_model
    from decoupler.model.model_file import read_model

    exported = export_model(read_model(model), out, precision)
    if json_:
        show_json({"file": str(out), **asdict(exported)})
    elif exported.deviation is None:
        print(f"not checked: {exported.unchecked}")
    else:
        print(f"largest deviation from the model: {exported.deviation:.1e} of full scale ({exported.precision})")
    wrote([out])


def say_untrusted(model: "Decoupler") -> None:
    """Name the forces that dead pillars leave unsure, on stderr."""
    for row, col, name in model.untrusted():
        say(f"{name} of the unit in row {row}, col {col} cannot be trusted")


def plain(errors: "dict[str, ForceErrors]") -> dict[str, Any]:
    """Errors by force as the contract's JSON has them."""
    return {name: asdict(values) for name, values in errors.items()}
