"""Make labelled samples: of pads or of contacts, by linear or by finite strain, in one file or in a zarr directory."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from dataset.imperfections import Imperfections, place_of
from geometry.design import SensorDesign, with_model
from geometry.errors import DesignError, require_type
from geometry.layout import PILLARS
from tripillar.face.caller import current
from tripillar.face.inputs import (
    DesignLike,
    File,
    Options,
    Protocol,
    design_of,
    given,
    require_counts,
    require_pool,
    to_write,
)

if TYPE_CHECKING:
    from dataset import DatasetSettings, Readout, Samples
    from dataset.imperfections import Place
    from dataset.stored import StoredSamples
    from decoupler.twin.twin_file import TwinFile
    from fem.array.response import ArrayResponse

    SensorLike = DesignLike | ArrayResponse | TwinFile
else:
    SensorLike = Path

Kind = Literal[Protocol, "indent"]
NEEDED = Parameter(required=True)  # on the command line, where a default would be written to a file unasked
SPECIMEN = Options(
    Imperfections,
    offset_ohm=Annotated[float, Parameter(name="--offset")],
    drift_offset_ohm=Annotated[float, Parameter(name="--drift-offset")],
    dead_pillars=Annotated[Sequence[str], Parameter(name="--dead-pillar")],
    dead_rows=Annotated[Sequence[int], Parameter(name="--dead-row")],
    dead_cols=Annotated[Sequence[int], Parameter(name="--dead-col")],
)
WIRES = "sense_ohm=, switch_ohm=, line_ohm= and correct=False"


def dataset(
    design: SensorLike | None = None,
    protocol: Annotated[Kind, NEEDED] = "three-axis",
    samples: Annotated[int, NEEDED] = 1000,
    *,
    out: Annotated[File | None, NEEDED] = None,
    seed: int = 0,
    cap: float = 0.3,
    crossbar: Literal["zero-potential", "grounded", "divider"] | None = None,
    sense_ohm: float | None = None,
    switch_ohm: float | None = None,
    line_ohm: float | None = None,
    correct: Annotated[bool, Parameter(negative="--no-correct")] = True,
    strain: Literal["linear", "finite"] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    only: str | None = None,
    dtype: Literal["float64", "float32"] = "float64",
    **specimen: Annotated[Any, SPECIMEN],
) -> "Samples | StoredSamples":
    """Simulate labelled samples: forces on the pads, and the resistances they give.

    Parameters
    ----------
    design : SensorDesign, ArrayResponse, TwinFile or path, optional
        Design file (TOML); default: the paper's sensor. Of a twin each sample is another draw of what its pairs leave
        open.
    protocol : str
        Kind of loads: independent, each pad its own; contact, by a few indenters; three-axis, each along all axes;
        light, by 10 N at most; with -fz or -fx along one axis. indent: shapes pressed and dragged.
    samples : int
        Number of samples to make.
    out : path, optional
        NetCDF file to write, or zarr directory (.zarr).
    seed : int
        Seed of the random loads and noise.
    cap : float
        Largest strain of a pillar; loads past it are drawn again.
    crossbar : str, optional
        Circuit to read the array through, as a board does; default: each pillar alone.
    sense_ohm : float, optional
        Sense or feedback resistor of the crossbar [Ω]; default: one that suits 10 kΩ.
    switch_ohm : float, optional
        Resistance of a closed switch of the crossbar [Ω]; default: 25.
    line_ohm : float, optional
        Resistance of a wire of the crossbar [Ω]; default: 0.
    correct : bool
        Correct the crossbar's crosstalk, as a live sensor does.
    strain : str, optional
        Model: linear, or finite strain (neo-Hookean, stiff pads); default: the design's materials'.
    workers : int, optional
        Worker processes of finite strain and of .zarr; default: one a core.
    scheduler : str, optional
        Address of a Dask scheduler to use in their place, such as tcp://host:8786.
    only : str, optional
        Variables to keep, such as resistance,force; default: all.
    dtype : str
        Type of the numbers; float32 in .zarr alone.
    **specimen
        Fields of `dataset.Imperfections`: noise, bits, drift, drift_tilt, drift_pillar, drift_offset_ohm of readings;
        gain_spread, offset_ohm, specimen, dead_pillars, dead_rows, dead_cols of the sensor.

    Returns
    -------
    Samples
        ``force_n`` and ``resistance_ohm``, shape (samples, rows, cols, 3), and what lies between; of a zarr directory
        the samples as stored.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> samples = tp.dataset(design, "contact", 50, noise=0.001, bits=12, gain_spread=0.1)
    >>> len(samples), samples.resistance_ohm.shape
    (50, (50, 1, 2, 3))
    """
    caller = current()
    from dataset.leaves import is_zarr, require_zarr_place

    if out is not None and is_zarr(Path(out)):
        out = Path(out)
        require_zarr_place(out)
    else:
        out = to_write("out", out, ".nc", ".zarr", read=(design,))
    in_leaves = out is not None and is_zarr(out)
    sensor, twin, solved = _sensor(design)
    dead: dict[str, Any] = {
        name: tuple(specimen[name]) for name in ("dead_pillars", "dead_rows", "dead_cols") if name in specimen
    }
    dead["dead_pillars"] = tuple(map(_place, dead.get("dead_pillars", ())))
    require_counts(workers=workers)
    require_pool(workers, scheduler)
    from dataset import DatasetSettings, in_memory, read_samples
    from dataset.protocols import INDENT, pad_protocol
    from dataset.samples import require_dtype
    from dataset.simulation import require_memory
    from fem.contact.surface import require_bare
    from tripillar.pipeline.run import respond
    from tripillar.sweep.leaves import LeafJob, make_directory

    names = None if only is None else _variables(only)
    if out is not None:
        require_dtype(dtype, out)
    settings = DatasetSettings(protocol=protocol, samples=samples, seed=seed, cap=cap, **specimen | dead)
    settings.dead_mask(sensor.array.rows, sensor.array.cols)  # refuses what the array lacks before anything is solved
    wires = given(sense_ohm=sense_ohm, switch_ohm=switch_ohm, line_ohm=line_ohm)
    readout = _readout(sensor, crossbar, settings.bits, correct, wires)
    finite = strain == "finite" or (strain is None and sensor.matrix_material.model != "linear")
    if not (finite or in_leaves):
        if workers is not None or scheduler is not None:
            raise DesignError("workers= and scheduler= belong to strain='finite' and to directories, out=data.zarr.")
        require_memory(sensor, samples, names)
    if finite or twin is not None:
        pad_protocol(protocol)
    elif protocol == INDENT:
        require_bare(sensor)
    if finite and twin is not None:
        raise DesignError("a twin is identified by linear rubber: leave strain='finite' out.")
    solved = solved or respond(with_model(sensor, "linear"), caller.bars)[1]
    made: Samples | StoredSamples
    if finite:
        made = _finite_samples(replace(solved, design=sensor), settings, readout, workers, scheduler)
        made = made if names is None else made.only(*names)
        story: dict[str, Any] = made.made_from | {"kept": 0}
        if out is not None:
            made.write(out, dtype)
    else:
        advance = caller.bars.begin("dataset", total=samples)
        job = LeafJob(
            response=replace(solved, design=sensor), settings=settings, readout=readout, twin=twin, only=names,
            dtype=dtype,
        )  # fmt: skip
        if in_leaves and out is not None:
            story = asdict(make_directory(job, out, workers, scheduler, lambda n: advance(n, "")))
            made = read_samples(out)
        else:
            made = job.whole(lambda n: advance(n, ""))
            story = made.made_from
            if out is not None:
                made.write(out)
    result = {"file": str(out), "samples": samples, "redrawn": story["redrawn"], "recipe": story["recipe"]}
    result |= {} if twin is None else {"twin": twin.decoder_hash}
    line = f"{samples} samples, {story['redrawn']} draws passed the cap of {cap:g} and were redrawn"
    line += f"; {story['kept']} samples are of earlier runs" if story.get("kept") else ""
    if finite and (errors := in_memory(made).error_estimate) is not None:
        result |= {"strain": "finite", "unsolved": story["unsolved"], "error_estimate": float(errors.mean())}
        line += (
            f", {story['unsolved']} had no solution and were redrawn, too; finite strain, estimated error "
            f"{errors.mean():.1e} on average, {errors.max():.1e} at most"
        )
    caller.answer(lambda: result, line, out)
    return made


def _sensor(source: "SensorLike | None") -> "tuple[SensorDesign, TwinFile | None, ArrayResponse | None]":
    """The design, the twin it is of, and the response that was given."""
    from geometry.design_file import states_twin

    if source is None or isinstance(source, SensorDesign):
        return design_of(source), None, None
    if isinstance(source, Path | str):
        if not states_twin(Path(source)):
            return design_of(source), None, None
        from decoupler.twin.twin_file import read_twin

        source = read_twin(Path(source))
    from decoupler.twin.twin_file import TwinFile
    from fem.array.response import ArrayResponse

    if isinstance(source, ArrayResponse):
        return source.design, None, source
    require_type("design", source, TwinFile, "give a design, a response or what decoupler.twin.read_twin gave")
    return source.design, source, None  # type: ignore[union-attr]


def _place(text: "str | Place") -> "Place":
    """A place of a pillar, as typed or as a tuple."""
    place = place_of(text) if isinstance(text, str) else text
    if place[2] not in PILLARS:
        typed = ",".join(map(str, place))
        raise DesignError(f"dead_pillars={typed} names no pillar: write row,col and one of {', '.join(PILLARS)}.")
    return place


def _variables(only: str) -> tuple[str, ...]:
    """Variables to keep beside forces and resistances, which a data set cannot do without."""
    from dataset.variables import ARRAYS

    known = {name.rpartition("_")[0]: name for name in ARRAYS}
    asked = [name.strip() for name in only.split(",")]
    unknown = [name for name in asked if name not in known]
    if unknown:
        raise DesignError(f"only={only}: no variable '{unknown[0]}'; there are {', '.join(known)}.")
    if not {"force", "resistance"} <= set(asked):
        raise DesignError(f"only={only}: a data set holds force and resistance at least: name them, too.")
    return tuple(name for short, name in known.items() if short in asked)


def _readout(
    sensor: SensorDesign, crossbar: str | None, bits: int | None, correct: bool, wires: dict[str, float]
) -> "Readout | None":
    """The electronics that resistances pass through; None: each pillar is read alone."""
    if crossbar is None:
        if wires or not correct:
            raise DesignError(f"{WIRES} belong to crossbar=: give it, too.")
        return None
    from hardware.readout.crossbar import Crossbar, scan_mode_named
    from hardware.readout.crossbar_readout import CrossbarReadout, shunts_of

    wired = Crossbar.suited(
        scan_mode_named(crossbar),
        rows=sensor.array.rows,
        cols=sensor.array.cols,
        bits=bits,
        shunt_siemens=shunts_of(sensor),
        **wires,
    )
    return CrossbarReadout(crossbar=wired, corrected=correct)


def _finite_samples(
    response: "ArrayResponse",
    settings: "DatasetSettings",
    readout: "Readout | None",
    workers: int | None,
    scheduler: str | None,
) -> "Samples":
    """Samples at finite strain by workers, those of earlier runs taken up again."""
    from dataset.finite_strain import n_groups, require_finite
    from tripillar.sweep.finite_samples import simulate_finite

    require_finite(response.design)
    advance = current().bars.begin("dataset", total=n_groups(settings.samples))
    return simulate_finite(response, settings, readout, workers, scheduler, advance)
