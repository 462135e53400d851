"""Samples from a response: tractions drawn by a protocol, superposed, turned into lengths and resistances.

Samples are drawn in blocks, each with random generators of its own. So a sample depends on the seed and its
number alone, not on how many are made with it, and a dataset can be extended without changing what it holds.
"""

import json
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, fields, replace
from typing import Any, cast

import numpy as np
import psutil

from common.errors import DesignError, TriPillarError, require_type
from common.storage.files import digest
from common.threads import one_blas_thread
from dataset.histories import between, programme
from dataset.imperfections import Imperfections
from dataset.loads import displacements
from dataset.measurement import Readout
from dataset.memory import relaxed_forces, remembered
from dataset.protocols import INDENT, forces, scaled_indenters
from dataset.resistance import conducted_lengths, exact_resistances, largest_strains, pillar_lengths
from dataset.samples import SampleError, Samples, require_samples, require_variables
from dataset.settings import BLOCK, DatasetSettings
from dataset.variables import ARRAYS, LABELS, VARIABLES
from fem.array.response import ArrayResponse
from geometry.design import Memory, SensorDesign
from geometry.layout import FloatArray, rest_lengths

METHOD = 2  #: raise when the same settings give other samples
IN_WORK = 1.2  #: memory that samples take while they are made and written, of their numbers alone
SERIES = 3  #: spawn key of their random numbers
MAX_ROUNDS = 1000  #: draws of one sample before the protocol is held to be impossible under the cap

#: by numbers (m,) of samples and how often they were drawn before: arrays (m, ...), and which are accepted (m,)
Draw = Callable[[np.ndarray, int], tuple[Sequence[np.ndarray], np.ndarray]]


class LoadError(TriPillarError, ValueError):
    """Loads that the sensor cannot take."""


def dataset_cache_key(response: ArrayResponse, settings: DatasetSettings, readout: Readout | None = None) -> str:
    """Hash of all that a dataset depends on."""
    settings = settings.suited(response)
    through: list[Any] = [] if readout is None else [readout]
    if settings.protocol == INDENT:
        from dataset.indentation import VERSION  # loads contact, half of a process's start

        through += [INDENT, VERSION]
    else:
        through += scaled_indenters(settings.protocol, response.design)
    return digest("dataset", METHOD, BLOCK, response.content_hash, response.design, settings, *through)


def simulate(
    response: ArrayResponse,
    settings: DatasetSettings,
    progress: Callable[[int], None] = lambda samples: None,
    readout: Readout | None = None,
    only: Sequence[str] | None = None,
) -> Samples:
    """Simulate labelled samples.

    Parameters
    ----------
    response : ArrayResponse
    settings : DatasetSettings
    progress : function
        Called with the number of samples each block adds.
    readout : Readout, optional
        Electronics that resistances pass through, such as a crossbar with its crosstalk.
    only : sequence of str, optional
        Variables to keep beside forces and resistances, which saves memory; default: all.

    Raises
    ------
    LoadError
        If a sample's strain passes the cap in `MAX_ROUNDS` draws on end.
    DesignError, SampleError
        As `Imperfections.apply` does; if `only` names no variable.
    """
    require_type("settings", settings, DatasetSettings, "say the protocol and the number of samples")
    whole = range(settings.samples)
    return simulate_part(response, settings, whole, progress, readout, only, threads=os.cpu_count() or 1)


def simulate_part(
    response: ArrayResponse,
    settings: DatasetSettings,
    numbers: range,
    progress: Callable[[int], None] = lambda samples: None,
    readout: Readout | None = None,
    only: Sequence[str] | None = None,
    threads: int = 1,
) -> Samples:
    """Those samples of `simulate` that have these numbers, of which the first is a multiple of `settings.block`."""
    require_type("response", response, ArrayResponse, "solve a design with fem.array_response, or read a file")
    require_conducted(response)
    require_variables(only or ())
    settings, response = settings.suited(response), as_read(response, readout)
    design, n, size = response.design, len(numbers), settings.block
    shapes = _kept_shapes(design, only, settings.protocol, settings.moments)
    make = _block if settings.moments is None else _series
    arrays: dict[str, Any] = {name: np.empty((n, *shape)) for name, shape in shapes.items()}

    def fill(start: int) -> tuple[int, int]:
        kept = min(size, n - start)
        block, redrawn = make(response, settings, (numbers.start + start) // size, readout, kept)
        for name, values in arrays.items():
            values[start : start + kept] = block[name][:kept]
        return kept, int(redrawn[:kept].sum())

    redrawn = 0
    # a block's matrix product is too small for two BLAS threads to share; two blocks side by side are not
    with one_blas_thread(), ThreadPoolExecutor(threads) as pool:
        for kept, again in pool.map(fill, range(0, n, size)):
            redrawn += again
            progress(kept)
    return Samples(
        design=design,
        **arrays,
        time_s=settings.time_s,
        **settings.of_samples(design),
        made_from={
            **origin(response, settings, redrawn, readout),
            "recipe": dataset_cache_key(response, settings, readout),
        },
    )


def _kept_shapes(
    design: SensorDesign, only: Sequence[str] | None, protocol: str = "", moments: int | None = None
) -> dict[str, tuple[int, ...]]:
    """Shape of one sample, or series, of each variable that `simulate` keeps."""
    absent = {"effective_length_mm": not design.electrics.is_conduction, "moment_nmm": protocol != INDENT}
    by_design = [name for name in ARRAYS if not absent.get(name)]
    names = [name for name in by_design if only is None or name in (*LABELS, *only)]
    size = design.array.rows, design.array.cols, design.unit.layout
    return {name: VARIABLES[name].shape(*size, moments) for name in names}


def require_memory(design: SensorDesign, settings: DatasetSettings, only: Sequence[str] | None = None) -> None:
    """Refuse more samples than memory holds, of all variables or those of `simulate`'s `only`."""
    kind = "samples" if settings.moments is None else "series"
    shapes = _kept_shapes(design, only, settings.protocol, settings.moments)
    needed = IN_WORK * settings.samples * 8 * sum(map(math.prod, shapes.values()))
    free = psutil.virtual_memory().available
    if needed > free:
        raise DesignError(
            f"{settings.samples} {kind} take {needed / 1e9:.0f} GB of memory on their way to a NetCDF file, "
            f"{free / 1e9:.0f} GB are free: end the file's name in .zarr, or keep less of them by --only."
        )


def origin(response: ArrayResponse, settings: DatasetSettings, redrawn: int, readout: Readout | None) -> dict[str, Any]:
    """Attributes of a file: settings, protocol, response."""
    return {
        **settings.as_attributes(),
        **read_through(readout),
        "summary": settings.summary(response.design),
        "redrawn": redrawn,
        "response_hash": response.content_hash,
        "mesh_hash": response.mesh_hash,
        "residual": response.residual,
    }


def measured_again(samples: Samples, imperfections: Imperfections, seed: int) -> Samples:
    """Measure the same loads with a sensor of these imperfections, however `samples` were measured.

    From the lengths, which are exact: to the last bit what `simulate` gives with the same loads, imperfections and
    seed. Samples without lengths or design are a `SampleError`; other errors are those of `Imperfections.apply`.
    """
    require_samples("samples", samples, timed=True)
    require_type("imperfections", imperfections, Imperfections, "say what is wrong with the sensor")
    design, lengths = samples.design, samples.length_mm
    if design is not None and design.electrics.is_conduction:
        lengths = samples.effective_length_mm
    if design is None or lengths is None:
        raise SampleError("samples without lengths and design cannot be measured again: take what simulate gave.")
    rise = _rise(samples.length_mm, design, imperfections, samples.time_s)
    exact_ohm = exact_resistances(lengths, design, rise)
    other = {spec.name for spec in fields(Imperfections)} | {"readout", "recipe"}
    kept = {name: value for name, value in samples.made_from.items() if name not in other}
    return replace(
        samples,
        design=design,
        resistance_ohm=read_resistances(exact_ohm, imperfections, seed, None, design),
        **imperfections.of_samples(design),
        made_from={**kept, **imperfections.as_attributes(), "noise_seed": seed},
    )


def as_read(response: ArrayResponse, readout: Readout | None) -> ArrayResponse:
    """The response of the design as it shows to these electronics."""
    return response if readout is None else replace(response, design=readout.seen(response.design))


def require_conducted(response: ArrayResponse) -> None:
    """Refuse the response of a design of conduction that holds none."""
    if response.design.electrics.is_conduction and response.conducted is None:
        raise DesignError("the design asks for conduction, its response holds none: make the response again.")


def read_resistances(
    exact_ohm: FloatArray,
    imperfections: Imperfections,
    seed: int,
    readout: Readout | None,
    design: SensorDesign,
    first: int = 0,
) -> FloatArray:
    """Exact resistances (n, rows, cols, n_pillars) [Ω] as a sensor of this design and these imperfections reads them.

    Their first is sample number `first`. Each block, and each of series (n, time, rows, cols, n_pillars), has a stream
    of noise that no loads use.
    """
    size = BLOCK if exact_ohm.ndim == 4 else 1
    blocks = [
        imperfections.apply(
            exact_ohm[start : start + size],
            stream(seed, (first + start) // size, MAX_ROUNDS, of_series=size == 1),
            readout,
            design.electrics,
            design.unit.layout,
        )
        for start in range(0, len(exact_ohm), size)
    ]
    return np.concatenate(blocks)


def _rise(
    length_mm: FloatArray | None, design: SensorDesign, specimen: Imperfections, time_s: FloatArray | None
) -> FloatArray | float:
    """Rise of ln R by a specimen's memory over lengths (n, time, rows, cols, n_pillars) [mm]; 0 without a time."""
    memory = design.pillar_material.memory
    if length_mm is None or time_s is None or memory == Memory():
        return 0.0
    strain = length_mm / rest_lengths(design.unit) - 1.0
    own = specimen.memory_of(memory, design.array.rows, design.array.cols, design.unit.layout)
    return np.stack([remembered(one, np.diff(time_s), own) for one in strain])


def labelled(
    traction_mpa: FloatArray,
    displacement_mm: FloatArray,
    effective_mm: FloatArray | None,
    design: SensorDesign,
    settings: DatasetSettings,
    readout: Readout | None,
    first: int = 0,
) -> dict[str, Any]:
    """All variables (n, rows, cols, ...) of samples from number `first` on; of conduction with effective lengths.

    Of series (n, time, ...) tractions are those that displace electrodes so, once the rubber has settled.
    """
    grid = (*traction_mpa.shape[:-2], design.array.rows, design.array.cols)
    traction, displacement = traction_mpa.reshape(*grid, 3), displacement_mm.reshape(*grid, -1, 3)
    prony = design.pillar_material.prony
    length = pillar_lengths(displacement, design.unit)
    effective = length if effective_mm is None else effective_mm.reshape(length.shape)
    rise = _rise(length, design, settings, settings.time_s)
    if settings.time_s is not None:
        traction = np.stack([relaxed_forces(one, np.diff(settings.time_s), prony) for one in traction])
    exact_ohm = exact_resistances(effective, design, rise)
    return {
        "traction_mpa": traction,
        "force_n": forces(traction, design),
        "displacement_mm": displacement,
        "length_mm": length,
        "resistance_ohm": read_resistances(exact_ohm, settings, settings.seed, readout, design, first),
    } | ({} if effective_mm is None else {"effective_length_mm": effective})


def below_cap(
    draw: Draw,
    n: int,
    rounds: int,
    settings: DatasetSettings,
    design: SensorDesign,
) -> tuple[list[np.ndarray], np.ndarray]:
    """Draw n samples, and those again that are not accepted: arrays (n, ...) and how often each was drawn again (n,).

    A sample drawn in vain in all rounds is a `LoadError`.
    """
    waiting, redrawn = np.arange(n), np.zeros(n, dtype=np.int64)
    kept: list[np.ndarray] = []
    for attempt in range(rounds):
        drawn, accepted = draw(waiting, attempt)
        kept = kept or list(drawn)  # in the first round these are all
        for values, new in zip(kept, drawn, strict=True):
            values[waiting] = new
        waiting = waiting[~accepted]
        redrawn[waiting] += 1
        if not len(waiting):
            return kept, redrawn
    loads = settings.loads_said(design)
    raise LoadError(
        f"protocol '{settings.protocol}' strained some pillar beyond cap={settings.cap:g} in {rounds} draws on end: "
        + (f"lower the loads, {loads}, or raise the cap." if loads else "raise the cap.")
    )


def stream(*seed: int, of_series: bool) -> np.random.Generator:
    """A stream of random numbers of blocks or of series, which share none, whatever their numbers.

    NumPy takes seeds that differ by zeros at their end for one: a spawn key parts those of series from the others, and
    from those of specimens.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(SERIES,) if of_series else ()))


def _pad_loads(response: ArrayResponse, settings: DatasetSettings, *seed: int, of_series: bool = False) -> Draw:
    """What draws loads of a protocol on pads, tractions and displacements, each attempt with a generator of its own."""
    design, protocol = response.design, settings.on_pads

    def draw(waiting: np.ndarray, attempt: int) -> tuple[list[FloatArray], np.ndarray]:
        traction = protocol.draw(stream(*seed, attempt, of_series=of_series), len(waiting), design, settings.loads)
        moved = displacements(response, traction, protocol.axes)
        return [traction, moved], ~(largest_strains(moved, design.unit) > settings.cap)

    return draw


def _block(
    response: ArrayResponse, settings: DatasetSettings, number: int, readout: Readout | None, kept: int
) -> tuple[dict[str, FloatArray], np.ndarray]:
    """All samples of one block by variable, and how often each was redrawn; contacts only as far as wanted."""
    design = response.design
    if settings.protocol == INDENT:
        from dataset.indentation import indented, tiled_lengths

        draw: Draw = indented(design, settings.seed, settings.cap, number, kept)
    else:
        draw = _pad_loads(response, settings, settings.seed, number)
    (traction, displacement, *of_contact), redrawn = below_cap(draw, BLOCK, MAX_ROUNDS, settings, design)
    effective = tiled_lengths(design, of_contact[1], kept) if of_contact else _effective(response, traction)
    found = labelled(traction, displacement, effective, design, settings, readout, number * BLOCK)
    if of_contact:
        found["moment_nmm"] = of_contact[0].reshape(-1, design.array.rows, design.array.cols, 2)
    return found, redrawn


def _series(
    response: ArrayResponse, settings: DatasetSettings, number: int, readout: Readout | None, kept: int
) -> tuple[dict[str, FloatArray], np.ndarray]:
    """All of one series (1, time, ...) by variable, and how many of its loads were redrawn (1,)."""
    design, time_s, again = response.design, settings.time_s, np.zeros(1, dtype=np.int64)
    assert time_s is not None
    generator = stream(settings.seed, number, MAX_ROUNDS + 1, of_series=True)
    corner_s, level, load = programme(generator, settings.history_s)

    def draw(_: np.ndarray, attempt: int) -> tuple[list[FloatArray], np.ndarray]:
        draw_loads = _pad_loads(response, settings, settings.seed, number, attempt, of_series=True)
        drawn, redrawn = below_cap(draw_loads, load.max() + 1, MAX_ROUNDS, settings, design)
        again[:] += redrawn.sum()
        at = level.reshape(-1, 1)
        series = [between(time_s, corner_s, at * one.reshape(len(one), -1)[load]) for one in drawn]
        traction, moved = (one.reshape(-1, *like.shape[1:]) for one, like in zip(series, drawn, strict=True))
        return [traction[None], moved[None]], np.array([largest_strains(moved, design.unit).max() <= settings.cap])

    (traction, moved), redrawn = below_cap(draw, 1, MAX_ROUNDS, settings, design)
    effective = _effective(response, traction)
    return labelled(traction, moved, effective, design, settings, readout, number), again + redrawn


def _effective(response: ArrayResponse, traction_mpa: FloatArray) -> FloatArray | None:
    """Effective lengths of linear conduction under tractions (..., n_units, 3) [MPa]; None where there is none."""
    if response.conducted is None:
        return None
    newtons = traction_mpa.reshape(-1, response.design.n_units, 3) * response.design.pad.size_mm**2
    return conducted_lengths(response.conducted, newtons)


def read_through(readout: Readout | None) -> dict[str, str]:
    """The electronics as a file's attribute."""
    return {} if readout is None else {"readout": json.dumps(asdict(cast("Any", readout)))}
