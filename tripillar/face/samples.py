"""Make labelled samples: of pads or of contacts, by linear or by finite strain, in one file or in a zarr directory."""

from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from common.errors import DesignError, require_type
from common.storage.files import write_text
from dataset.imperfections import Imperfections
from dataset.settings import DatasetSettings
from geometry.design import SensorDesign, with_model
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import (
    BROKEN,
    WIRES,
    Circuit,
    DesignLike,
    File,
    Flag,
    Options,
    Protocol,
    design_of,
    imperfections,
    job,
    to_write,
)

if TYPE_CHECKING:
    SensorLike = DesignLike | stages.ArrayResponse | stages.TwinFile
else:
    SensorLike = Path

Kind = Literal[Protocol, "table", "indent"]
RANGES = ("pressure_mpa", "shear_mpa")  #: of loads
OF_TESTS = 10**6  #: added to the seed of samples for tests
MAX_REDRAWN = 0.2  #: of all draws, beyond which what is left is said to be another distribution
NEEDED = Flag(required=True)  # on the command line, where a default would be written to a file unasked
SETTINGS = Options(
    DatasetSettings,
    *("seed", "cap", *RANGES, "history_s", "rate_hz", *(field.name for field in fields(Imperfections))),
    **dict.fromkeys(RANGES, tuple[float, float]),
    offset_ohm=Annotated[float, Flag(name=("--offset",))],
    drift_offset_ohm=Annotated[float, Flag(name=("--drift-offset",))],
    **BROKEN,
)


@job(out=".nc .zarr")
def dataset(
    design: SensorLike | None = None,
    protocol: Annotated[Kind, NEEDED] = "three-axis",
    samples: Annotated[int, NEEDED] = 1000,
    *,
    out: Annotated[File | None, NEEDED] = None,
    loads: File | None = None,
    crossbar: Circuit | None = None,
    sense_ohm: float | None = None,
    correct: bool = True,
    strain: Literal["linear", "finite"] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    only: str | None = None,
    dtype: Literal["float64", "float32"] = "float64",
    test_share: float | None = None,
    **more: Annotated[Any, SETTINGS, WIRES],
) -> "stages.Samples | stages.StoredSamples":
    """Simulate labelled samples: forces on the pads, and the resistances they give.

    Parameters
    ----------
    design : SensorDesign, ArrayResponse, TwinFile or path, optional
        Design file (TOML), or a twin, of which each sample is another draw; default: the paper's sensor.
    protocol : str
        Loads: independent, each pad its own; contact, by a few indenters; three-axis, each pad along all axes; light,
        at most 10 N; -fz or -fx, along one axis; table, those of a table at random; indent, shapes pressed and dragged.
    samples : int
        Number of samples to make.
    out : path, optional
        NetCDF file to write, or zarr directory (.zarr).
    loads : path, optional
        Table of known loads (CSV), as of 'identify', for the protocol table.
    crossbar : str, optional
        Circuit to read the array through, as a board does; default: each pillar alone.
    sense_ohm : float, optional
        Sense or feedback resistor of the crossbar [Ω]; default: one that suits 10 kΩ.
    correct : bool
        Correct the crossbar's crosstalk, as a live sensor does.
    strain : str, optional
        Model: linear, or finite strain (stiff pads; linear rubber becomes neo-Hookean); default: the design's.
    workers : int, optional
        Worker processes of finite strain and of .zarr; default: one a core.
    scheduler : str, optional
        Address of a Dask scheduler to use instead of processes here, such as tcp://host:8786.
    only : str, optional
        Variables to keep, such as resistance,force; default: all.
    dtype : str
        Type of the numbers; float32 in .zarr alone.
    test_share : float, optional
        Share of the samples that go into a second file, such as data-test.nc: the same sensor under other loads; those
        of a table are divided.
    **more
        Fields of `inputs.Wires`, with a crossbar, and of `dataset.DatasetSettings`: seed, cap, pressure_mpa, shear_mpa,
        history_s, rate_hz of the loads; noise, bits, drift, drift_tilt, drift_pillar, drift_offset_ohm of readings;
        gain_spread, offset_ohm, specimen, dead_pillars, dead_rows, dead_cols of the sensor.

    Returns
    -------
    Samples
        ``force_n`` and ``resistance_ohm``, shape (samples, rows, cols, 3), of series (samples, time, rows, cols, 3),
        and what lies between; of a zarr directory the samples as stored.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> samples = tp.dataset(design, "contact", 50, noise=0.001, bits=12, gain_spread=0.1)
    >>> len(samples), samples.resistance_ohm.shape
    (50, (50, 1, 2, 3))
    """
    caller, path, beside = current(), None if out is None else Path(out), None
    in_leaves = path is not None and stages.is_zarr(path)
    if test_share is not None:
        if path is None:
            raise DesignError("test_share= writes a file beside out=: give out=, too.")
        beside = path.with_name(f"{path.stem}-test{path.suffix}")
        to_write("test_share", beside, read=(design, loads))
    for place in filter(None, (path, beside)):
        stages.require_zarr_place(place) if in_leaves else stages.require_dtype(dtype, place)
    sensor, twin, solved = _sensor(design)
    stages.require_pool(workers, scheduler)
    names = None if only is None else _variables(only)
    asked = imperfections(SETTINGS.of(more))
    in_time = bool(asked.get("history_s"))
    if "rate_hz" in asked and not in_time:
        raise DesignError(f"rate_hz={asked['rate_hz']:g} is of series over time: give history_s=, their seconds, too.")
    if protocol == "table" and loads is None:
        raise DesignError("protocol='table' draws from a table of loads: give loads=, too.")
    if protocol != "table" and loads is not None:
        raise DesignError(f"loads={loads} belongs to protocol='table': choose it, or leave loads= out.")
    if loads is not None:
        force_n = [each.force_n for each in stages.read_loads(Path(loads), sensor)]
        traction_mpa = np.reshape(force_n, (len(force_n), -1, 3)) / stages.forces(np.ones(3), sensor)
        asked["table_mpa"] = tuple(tuple(map(tuple, each)) for each in traction_mpa.tolist())
    settings = DatasetSettings(protocol=protocol, samples=samples, **asked)
    # refuses what the array lacks before anything is solved
    settings.dead_mask(sensor.array.rows, sensor.array.cols, sensor.unit.layout)
    wires = WIRES.of(more) | ({} if sense_ohm is None else {"sense_ohm": sense_ohm})
    readout = _readout(sensor, crossbar, settings.bits, correct, wires)
    usual = sensor.matrix_material.model != "linear" if twin is None else twin.is_at_strain
    is_finite = usual if strain is None else strain == "finite"
    if twin is not None and is_finite != usual:
        raise DesignError(
            f"strain={strain!r}: a twin's samples are of the rubber that it was identified with: leave it out."
        )
    is_solved = is_finite and twin is None
    if not (is_solved or in_leaves):
        if workers is not None or scheduler is not None:
            raise DesignError("workers= and scheduler= belong to strain='finite' and to directories, out=data.zarr.")
        stages.require_memory(sensor, settings, names)
    if is_finite or twin is not None:
        _ = settings.on_pads  # refuses others
    elif protocol == stages.INDENT:
        stages.require_pressable(sensor)
    if in_time and (is_finite or twin is not None):
        raise DesignError("history_s= moves linear rubber of a design: leave strain='finite' and twins out.")
    solved = solved or stages.respond(with_model(sensor, "linear"), caller.bars)[1]
    solved = replace(solved, design=sensor)
    if is_solved:
        stages.require_finite(sensor)
    if is_finite:
        answered = None
        if twin is not None and isinstance(decoder := twin.read_decoder(), stages.DecouplerAtStrain):
            answered = stages.StrainedDraws(decoder, solved).answered
        settings, factor = stages.borne(solved, settings, answered)
        if factor < 1.0:
            caller.say(f"finite strain bears {factor:g} of the loads that small strain does")
    said, settings = _loads_said(settings, solved), settings.suited(solved)

    def simulated(settings: DatasetSettings, path: Path | None) -> "tuple[Any, dict[str, Any]]":
        if is_solved:
            advance = caller.bars.begin("dataset", total=stages.n_groups(settings.samples))
            made = stages.simulate_finite(solved, settings, readout, workers, scheduler, advance)
            made = made if names is None else made.only(*names)
        else:
            advance = caller.bars.begin("dataset", total=settings.samples)
            leaves = stages.LeafJob(
                response=solved, settings=settings, readout=readout, twin=twin, only=names, dtype=dtype
            )
            if path is not None and in_leaves:
                story = stages.make_directory(leaves, path, workers, scheduler, lambda n: advance(n, ""))
                stored = stages.read_samples(path)
                card = path.with_name(f"{path.stem}-README.md")  # in it zarr takes none
                if story["kept"] < settings.samples or not card.exists():  # else a licence may be filled in
                    write_text(stored.card(), card)
                return stored, story
            made = leaves.whole(lambda n: advance(n, ""))
        if path is not None:
            made.write(path, dtype)
        return made, made.made_from | {"kept": 0}

    made: stages.Samples | stages.StoredSamples
    if test_share is not None:
        settings, of_test = _divided(settings, test_share)
        simulated(of_test, beside)
    made, story = simulated(settings, path)
    samples = settings.samples
    result = {"file": str(out), "samples": samples, "redrawn": story["redrawn"], "recipe": story["recipe"]}
    result |= {} if test_share is None else {"test_file": str(beside), "test_samples": of_test.samples}
    result |= {} if twin is None else {"twin": twin.decoder_hash}
    result |= {name: list(value) for name in RANGES if (value := getattr(settings, name)) is not None}
    kind = "series" if in_time else "samples"
    line = f"{samples} {kind}, {story['redrawn']} draws passed the cap of {settings.cap:g} and were redrawn"
    line += f"; {story['kept']} {kind} are of earlier runs" if story.get("kept") else ""
    if is_finite and (errors := stages.in_memory(made).error_estimate) is not None:
        result |= {"strain": "finite", "unsolved": story["unsolved"], "error_estimate": float(errors.mean())}
        line += (
            f", {story['unsolved']} had no solution and were redrawn, too; finite strain, estimated error "
            f"{errors.mean():.1e} on average, {errors.max():.1e} at most"
        )
        if sensor.matrix_material.model == "linear":
            line += "; linear rubber was taken for neo-Hookean of the same E and ν"
    redrawn = story["redrawn"] / (samples + story["redrawn"])
    if not in_time and redrawn > MAX_REDRAWN:
        line += (
            f"\n{redrawn:.0%} of all draws passed the cap, so light loads are more frequent than in the protocol: "
            "lower the loads by --pressure or --shear, or raise --cap"
        )
    result |= {} if in_time else {"redrawn_share": redrawn}
    line += "" if test_share is None else f"\n{of_test.samples} more for tests, under loads of their own"
    caller.answer(lambda: result, f"{said}{line}", path, beside)
    return made


def _divided(settings: DatasetSettings, share: float) -> tuple[DatasetSettings, DatasetSettings]:
    """Settings of samples to learn from, and of those to test with: other loads of the same sensor."""
    n_test = round(share * settings.samples) if 0 < share < 1 else 0
    if not 0 < n_test < settings.samples:
        raise DesignError(
            f"test_share={share:g} of {settings.samples} samples leaves none for tests, or none to learn from: give "
            "one such as 0.1."
        )
    learned, tested = replace(settings, samples=settings.samples - n_test), replace(settings, samples=n_test)
    if settings.table_mpa is not None:
        order = np.random.default_rng(settings.seed).permutation(len(settings.table_mpa)).tolist()
        n_rows = round(share * len(order))
        if not 0 < n_rows < len(order):
            raise DesignError(f"test_share={share:g} divides no table of {len(order)} loads: give more loads.")
        rows = [settings.table_mpa[row] for row in order]
        learned = replace(learned, table_mpa=tuple(rows[n_rows:]))
        tested = replace(tested, table_mpa=tuple(rows[:n_rows]))
    return learned, replace(tested, seed=settings.seed + OF_TESTS)


def _loads_said(settings: DatasetSettings, response: "stages.ArrayResponse") -> str:
    """A line on loads that are not the paper's; else nothing."""
    if settings.table_mpa is not None:
        return f"{settings.summary(response.design)}\n"
    suited = settings.suited(response)
    if suited.loads == stages.PAPERS:
        return ""
    said = suited.loads_said(response.design)
    if suited == settings:
        return f"loads: {said}\n"
    return f"the paper's loads strain this design's pillars beyond the cap of {settings.cap:g}; its own: {said}\n"


def _sensor(source: "SensorLike | None") -> "tuple[SensorDesign, stages.TwinFile | None, stages.ArrayResponse | None]":
    """The design, the twin it is of, and the response that was given."""
    if isinstance(source, Path | str):
        if not stages.states_twin(Path(source)):
            return design_of(source), None, None
        source = stages.read_twin(Path(source))
    if source is None or isinstance(source, SensorDesign):
        return design_of(source), None, None
    if isinstance(source, stages.ArrayResponse):
        return source.design, None, source
    require_type("design", source, stages.TwinFile, "give a design, a response or what decoupler.twin.read_twin gave")
    return source.design, source, None


def _variables(only: str) -> tuple[str, ...]:
    """Variables to keep beside forces and resistances, which a data set cannot do without."""
    known = {name.rpartition("_")[0]: name for name in stages.ARRAYS}
    asked = [name.strip() for name in only.split(",")]
    unknown = [name for name in asked if name not in known]
    if unknown:
        raise DesignError(f"only={only}: no variable '{unknown[0]}'; there are {', '.join(known)}.")
    if not {"force", "resistance"} <= set(asked):
        raise DesignError(f"only={only}: a data set holds force and resistance at least: name them, too.")
    return tuple(name for short, name in known.items() if short in asked)


def _readout(
    sensor: SensorDesign, crossbar: str | None, bits: int | None, correct: bool, wires: dict[str, float]
) -> "stages.Readout | None":
    """The electronics that resistances pass through; None: each pillar is read alone."""
    if crossbar is None:
        if wires or not correct:
            raise DesignError("sense_ohm=, switch_ohm=, line_ohm= and correct=False belong to crossbar=: give it, too.")
        return None
    of_array: dict[str, Any] = {"rows": sensor.array.rows, "cols": sensor.array.cols, "layout": sensor.unit.layout}
    mode, shunts = stages.scan_mode_named(crossbar), stages.shunts_of(sensor)
    wired = stages.Crossbar.suited(mode, bits=bits, shunt_siemens=shunts, **of_array, **wires)
    return stages.CrossbarReadout(crossbar=wired, corrected=correct)
