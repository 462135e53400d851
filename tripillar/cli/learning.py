"""The commands that make data, and train and test networks."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from geometry.design import with_model
from geometry.errors import DesignError
from tripillar.terminal.console import (
    DesignOption,
    GainSpreadOption,
    JsonOption,
    OffsetOption,
    VerbosityOption,
    answer,
    chosen,
    chosen_twin,
    output_file,
    output_samples,
    progress_bars,
    require_other,
    say,
    spelled,
    wrote,
)

if TYPE_CHECKING:
    from dataset import DatasetSettings, Readout, Samples
    from decoupler.evaluation.metrics import ForceErrors
    from decoupler.model.decoupler import Decoupler
    from geometry.design import SensorDesign
    from tripillar.face.checks import Caller
    from tripillar.terminal.progress import Bars

Protocol = Literal[
    "independent-fz", "independent-fx", "contact-fz", "contact-fx", "contact", "three-axis",
    "light-fz", "light-fx", "light",
]  # fmt: skip
Kind = Literal[Protocol, "indent"]
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
        Kind,
        typer.Option(
            help="Kind of loads: independent, each pad its own; contact, by a few indenters; three-axis, each along "
            "all axes; light, by 10 N at most; with -fz or -fx along one axis. indent: shapes pressed and dragged."
        ),
    ],
    samples: Annotated[int, typer.Option(help="Number of samples to make.")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", callback=output_samples, help="NetCDF file to write, or zarr directory (.zarr)."),
    ],
    seed: Annotated[int, typer.Option(help="Seed of the random loads and noise.")] = 0,
    cap: Annotated[float, typer.Option(help="Largest strain of a pillar; loads past it are drawn again.")] = 0.3,
    noise: Annotated[float, typer.Option(help="Standard deviation of a reading, relative to the resistance.")] = 0.0,
    bits: Annotated[int | None, typer.Option(help="Bits of the converter; default: exact readings.")] = None,
    drift: Annotated[
        float, typer.Option(help="Standard deviation of a sample's drift that all readings share, relative.")
    ] = 0.0,
    drift_tilt: Annotated[
        float, typer.Option(help="Standard deviation of its drift linear over the array, at the rim, along each axis.")
    ] = 0.0,
    drift_pillar: Annotated[
        float, typer.Option(help="Standard deviation of its drift of each pillar alone, relative.")
    ] = 0.0,
    drift_offset: Annotated[
        float, typer.Option(help="Standard deviation of its drift that adds as much to all readings [Ω].")
    ] = 0.0,
    gain_spread: GainSpreadOption = 0.0,
    offset: OffsetOption = 0.0,
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
    strain: Annotated[
        Literal["linear", "finite"] | None,
        typer.Option(
            help="Model: linear, or finite strain (neo-Hookean, stiff pads); default: the design's materials'."
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Worker processes of --strain finite and of .zarr; default: one a core.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler to use in their place, such as tcp://host:8786.")
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="Variables to keep, such as resistance,force; default: all."),
    ] = None,
    dtype: Annotated[
        Literal["float64", "float32"], typer.Option(help="Type of the numbers; float32 in .zarr alone.")
    ] = "float64",
    design: DesignOption = None,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Simulate labelled samples: forces on the pads, and the resistances they give."""
    require_other(out, design)
    from dataset import DatasetSettings
    from dataset.imperfections import place_of
    from dataset.leaves import is_zarr
    from dataset.protocols import INDENT, pad_protocol
    from dataset.samples import require_dtype
    from dataset.simulation import require_memory
    from fem.contact.surface import require_bare
    from tripillar.cli.studying import require_counts, require_packages
    from tripillar.pipeline.run import respond
    from tripillar.sweep.leaves import LeafJob, make_directory

    names = None if only is None else _variables(only)
    with spelled(dtype="--dtype"):
        require_dtype(dtype, out)
    require_counts(workers=workers)
    if scheduler is not None:
        require_packages("distributed")
        if workers is not None:
            raise DesignError("--workers are begun on this machine, --scheduler has its own: give one of them.")
    settings = DatasetSettings(
        protocol=protocol,
        samples=samples,
        seed=seed,
        cap=cap,
        noise=noise,
        bits=bits,
        drift=drift,
        drift_tilt=drift_tilt,
        drift_pillar=drift_pillar,
        drift_offset_ohm=drift_offset,
        gain_spread=gain_spread,
        offset_ohm=offset,
        specimen=specimen,
        dead_pillars=tuple(map(place_of, dead_pillar or ())),
        dead_rows=tuple(dead_row or ()),
        dead_cols=tuple(dead_col or ()),
    )
    sensor = chosen(design)
    twin = chosen_twin(design)
    settings.dead_mask(sensor.array.rows, sensor.array.cols)  # refuses what the array lacks before anything is solved
    readout = None
    wires = {"sense_ohm": sense_ohm, "switch_ohm": switch_ohm, "line_ohm": line_ohm}
    given = {name: ohms for name, ohms in wires.items() if ohms is not None}
    if crossbar is None and (given or not correct):
        raise DesignError("--sense-ohm, --switch-ohm, --line-ohm and --no-correct belong to --crossbar: give it, too.")
    if crossbar is not None:
        from hardware.readout.crossbar import Crossbar, scan_mode_named
        from hardware.readout.crossbar_readout import CrossbarReadout, shunts_of

        wired = Crossbar.suited(
            scan_mode_named(crossbar),
            rows=sensor.array.rows,
            cols=sensor.array.cols,
            bits=bits,
            shunt_siemens=shunts_of(sensor),
            **given,
        )
        readout = CrossbarReadout(crossbar=wired, corrected=correct)
    finite = strain == "finite" or (strain is None and sensor.matrix_material.model != "linear")
    if not (finite or is_zarr(out)) and (workers is not None or scheduler is not None):
        raise DesignError("--workers and --scheduler belong to --strain finite and to directories, --out data.zarr.")
    if not (finite or is_zarr(out)):
        require_memory(sensor, samples, names)
    if finite or twin is not None:
        with spelled(protocol="--protocol"):
            pad_protocol(protocol)
    elif protocol == INDENT:
        require_bare(sensor)
    if finite and twin is not None:
        raise DesignError(f"{design} is a twin, identified by linear rubber: leave --strain finite out.")
    with progress_bars(verbosity) as bars:
        if finite:
            data = _finite_samples(sensor, settings, readout, workers, scheduler, bars)
            (data if names is None else data.only(*names)).write(out, dtype)
            story = data.made_from | {"kept": 0}
        else:
            _, solved = respond(with_model(sensor, "linear"), bars)
            advance = bars.begin("dataset", total=samples)
            job = LeafJob(
                response=replace(solved, design=sensor), settings=settings, readout=readout, twin=twin, only=names,
                dtype=dtype,
            )  # fmt: skip
            with spelled(gain_spread="--gain-spread", offset_ohm="--offset", protocol="--protocol"):
                if is_zarr(out):
                    story = asdict(make_directory(job, out, workers, scheduler, lambda n: advance(n, "")))
                else:
                    data = job.whole(lambda n: advance(n, ""))
                    data.write(out)
                    story = data.made_from
    result = {"file": str(out), "samples": samples, "redrawn": story["redrawn"], "recipe": story["recipe"]}
    result |= {} if twin is None else {"twin": twin.decoder_hash}
    line = f"{samples} samples, {story['redrawn']} draws passed the cap of {cap:g} and were redrawn"
    line += f"; {story['kept']} samples are of earlier runs" if story.get("kept") else ""
    if finite:
        errors = data.error_estimate
        assert errors is not None
        result |= {"strain": "finite", "unsolved": story["unsolved"], "error_estimate": float(errors.mean())}
        line += (
            f", {story['unsolved']} had no solution and were redrawn, too; finite strain, estimated error "
            f"{errors.mean():.1e} on average, {errors.max():.1e} at most"
        )
    answer(json_, result, line, out)


def _variables(only: str) -> tuple[str, ...]:
    """Variables of --only beside forces and resistances, which a data set cannot do without."""
    from dataset.variables import ARRAYS

    known = {name.rpartition("_")[0]: name for name in ARRAYS}
    asked = [name.strip() for name in only.split(",")]
    unknown = [name for name in asked if name not in known]
    if unknown:
        raise DesignError(f"--only {only}: no variable '{unknown[0]}'; there are {', '.join(known)}.")
    if not {"force", "resistance"} <= set(asked):
        raise DesignError(f"--only {only}: a data set holds force and resistance at least: name them, too.")
    return tuple(name for short, name in known.items() if short in asked)


def _finite_samples(
    sensor: "SensorDesign",
    settings: "DatasetSettings",
    readout: "Readout | None",
    workers: int | None,
    scheduler: str | None,
    bars: "Bars",
) -> "Samples":
    """Samples at finite strain by workers, those of earlier runs taken up again."""
    from dataset.finite_strain import n_groups, require_finite
    from tripillar.pipeline.run import respond
    from tripillar.sweep.finite_samples import simulate_finite

    require_finite(sensor)
    _, solved = respond(with_model(sensor, "linear"), bars)
    advance = bars.begin("dataset", total=n_groups(settings.samples))
    return simulate_finite(replace(solved, design=sensor), settings, readout, workers, scheduler, advance)


def train(
    data: Annotated[
        list[Path],
        typer.Option(help="Data set to train on; several of one sensor, linear and at finite strain, count as one."),
    ],
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
    require_other(out, *data, design)
    stated = None if design is None else chosen(design)
    from dataset import in_memory, read_samples
    from dataset.samples import joined
    from decoupler.evaluation.metrics import evaluate as errors_on
    from decoupler.model.model_file import write_model
    from tripillar.face import learning as face

    several = [read_samples(path, labels_only=True) for path in data]
    if any(each.is_finite.any() for each in several):  # these learn from displacements, too
        several = [read_samples(path) for path in data]
    samples = several[0] if len(several) == 1 else joined([in_memory(each) for each in several])
    with spelled(goal_mse="--goal", max_iterations="--iterations"), progress_bars(verbosity) as bars:
        model = face.train(
            samples, component, net=net, hidden=hidden, trainer=trainer, feature=feature, seed=seed, design=stated,
            force=force, goal_mse=goal, max_iterations=iterations, caller=caller(data[0], bars),
        )  # fmt: skip
        seconds = bars.seconds()
    write_model(model, out)
    iterations, mse, reason = (model.made_from["outcome"][name] for name in ("iterations", "mse", "reason"))
    result = {
        "file": str(out),
        "feature": model.network.feature,
        "iterations": iterations,
        "mse": mse,
        "reason": reason,
        "seconds": seconds,
        "training_errors": plain(errors_on(model, samples)),
        "untrusted": [f"{name} row {row} col {col}" for row, col, name in model.untrusted()],
    }
    answer(json_, result, f"{iterations} iterations in {seconds:.1f} s to mse {mse:.2e} ({reason})")
    say_untrusted(model, json_)
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
    from decoupler.evaluation.assessment import as_plain
    from decoupler.model.model_file import read_model
    from tripillar.cli.tables import assessment_table
    from tripillar.face import learning as face

    decoupler, samples = read_model(model), read_samples(data, labels_only=True)
    with progress_bars(verbosity) as bars:
        assessed = face.evaluate(decoupler, samples, limits=limits, caller=caller(data, bars, model))
    answer(json_, as_plain(assessed), lambda: [assessment_table(assessed)])
    say_untrusted(decoupler, json_)


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
    stated = None if design is None else chosen(design)
    from dataset import read_samples
    from decoupler.evaluation.crossval import summary
    from decoupler.model.settings import TrainingConfig
    from tripillar.cli.tables import crossval_table
    from tripillar.face.learning import folds_of

    with spelled(goal_mse="--goal"):
        training = TrainingConfig(trainer=trainer, goal_mse=goal, seed=seed)
    samples = read_samples(data, labels_only=True)
    with progress_bars(verbosity) as bars:
        network, tested = folds_of(
            samples, component, folds, training, net, hidden, feature, stated, None, force, caller(data, bars)
        )
    answer(json_, {"feature": network.feature} | summary(tested), lambda: [crossval_table(tested)])


def caller(data: Path, bars: "Bars", model: Path | str = "model") -> "Caller":
    """This command, which messages name its files to."""
    from tripillar.face.checks import Caller

    return Caller(samples=str(data), model=str(model), go_on="--force", say=say, bars=bars)


def say_untrusted(model: "Decoupler", as_json: bool) -> None:
    """Name the forces that dead pillars leave unsure, on stderr; JSON has them already."""
    for row, col, name in [] if as_json else model.untrusted():
        say(f"{name} of the unit in row {row}, col {col} cannot be trusted")


def plain(errors: "dict[str, ForceErrors]") -> dict[str, Any]:
    """Errors by force as the contract's JSON has them."""
    return {name: asdict(values) for name, values in errors.items()}
