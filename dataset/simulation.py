"""Samples from a response: tractions drawn by a protocol, superposed, turned into lengths and resistances.

Samples are drawn in blocks, each with random generators of its own. So a sample depends on the seed and its
number alone, not on how many are made with it, and a dataset can be extended without changing what it holds.
"""

import json
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import MISSING, asdict, dataclass, fields, replace
from typing import Any, cast

import numpy as np
import psutil

from dataset.imperfections import SEEDS, Imperfections
from dataset.indentation import VERSION, indented
from dataset.measurement import Readout
from dataset.protocols import INDENT, PROTOCOLS, SUMMARIES, forces
from dataset.resistance import conducted_lengths, largest_strains, pillar_lengths, pillar_resistances
from dataset.samples import SampleError, Samples, require_samples, require_variables
from dataset.variables import ARRAYS, LABELS, VARIABLES
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign, quantity
from geometry.errors import DesignError, TriPillarError, require_type
from geometry.layout import AXES, FloatArray, pillar_volumes
from geometry.storage.files import digest
from geometry.threads import one_blas_thread

METHOD = 2  #: raise when the same settings give other samples
BLOCK = 512  #: samples drawn with one generator; a block's arrays fit the processor's cache
MAX_SAMPLES = 1_000_000_000  #: of 36 units: 700 GB of forces and resistances in float32, compressed
IN_WORK = 1.2  #: memory that samples take while they are made and written, of their numbers alone
MAX_ROUNDS = 1000  #: draws of one sample before the protocol is held to be impossible under the cap


class LoadError(TriPillarError, ValueError):
    """Loads that the sensor cannot take."""


@dataclass(frozen=True, kw_only=True)
class DatasetSettings(Imperfections):
    """Settings of a dataset: its loads, and the sensor that measures them."""

    protocol: str = quantity(MISSING, "kind of loads", of=tuple(SUMMARIES))
    samples: int = quantity(MISSING, "number of samples", within=(1, MAX_SAMPLES))
    seed: int = quantity(0, "seed of all that is random", within=SEEDS)
    cap: float = quantity(
        0.3, "largest pillar strain |l − l₀|/l₀ of an accepted sample", above_0=True, within=(0, 1), below=True
    )


def dataset_cache_key(response: ArrayResponse, settings: DatasetSettings, readout: Readout | None = None) -> str:
    """Hash of all that a dataset depends on."""
    through: list[Any] = [] if readout is None else [readout]
    through += [INDENT, VERSION] if settings.protocol == INDENT else []
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
    """Those samples of `simulate` that have these numbers, of which the first is a multiple of `BLOCK`."""
    require_type("response", response, ArrayResponse, "solve a design with fem.array_response, or read a file")
    require_conducted(response)
    require_variables(only or ())
    design, n = response.design, len(numbers)
    shapes = _kept_shapes(design, only, settings.protocol)
    arrays: dict[str, Any] = {name: np.empty((n, *shape)) for name, shape in shapes.items()}

    def fill(start: int) -> tuple[int, int]:
        kept = min(BLOCK, n - start)
        block, redrawn = _block(response, settings, (numbers.start + start) // BLOCK, readout, kept)
        for name, values in arrays.items():
            values[start : start + kept] = block[name][:kept]
        return kept, int(redrawn[:kept].sum())

    redrawn = 0
    # a block's matrix product is too small for two BLAS threads to share; two blocks side by side are not
    with one_blas_thread(), ThreadPoolExecutor(threads) as pool:
        for kept, again in pool.map(fill, range(0, n, BLOCK)):
            redrawn += again
            progress(kept)
    return Samples(
        design=design,
        **arrays,
        **settings.of_samples(design),
        made_from={
            **origin(response, settings, redrawn, readout),
            "recipe": dataset_cache_key(response, settings, readout),
        },
    )


def _kept_shapes(design: SensorDesign, only: Sequence[str] | None, protocol: str = "") -> dict[str, tuple[int, ...]]:
    """Shape of one sample of each variable that `simulate` keeps."""
    absent = {"effective_length_mm": not design.electrics.is_conduction, "moment_nmm": protocol != INDENT}
    by_design = [name for name in ARRAYS if not absent.get(name)]
    names = [name for name in by_design if only is None or name in (*LABELS, *only)]
    return {name: VARIABLES[name].shape(design.array.rows, design.array.cols) for name in names}


def require_memory(design: SensorDesign, samples: int, only: Sequence[str] | None = None) -> None:
    """Refuse more samples than memory holds, of all variables or those of `simulate`'s `only`."""
    needed = IN_WORK * samples * 8 * sum(map(math.prod, _kept_shapes(design, only).values()))
    free = psutil.virtual_memory().available
    if needed > free:
        raise DesignError(
            f"{samples} samples take {needed / 1e9:.0f} GB of memory on their way to a NetCDF file, {free / 1e9:.0f} "
            "GB are free: end the file's name in .zarr, or keep less of them by --only."
        )


def origin(response: ArrayResponse, settings: DatasetSettings, redrawn: int, readout: Readout | None) -> dict[str, Any]:
    """Attributes of a file: settings, protocol, response."""
    return {
        **settings.as_attributes(),
        **read_through(readout),
        "summary": SUMMARIES[settings.protocol],
        "redrawn": redrawn,
        "response_hash": response.content_hash,
        "mesh_hash": response.mesh_hash,
        "residual": response.residual,
    }


def measured_again(
    samples: Samples, imperfections: Imperfections, seed: int, readout: Readout | None = None
) -> Samples:
    """Measure the same loads with a sensor of these imperfections, however `samples` were measured.

    From the lengths, which are exact: to the last bit what `simulate` gives with the same loads, imperfections, seed
    and readout. Samples without lengths or design are a `SampleError`; other errors are those of `Imperfections.apply`.
    """
    require_samples("samples", samples)
    require_type("imperfections", imperfections, Imperfections, "say what is wrong with the sensor")
    design, lengths = samples.design, samples.length_mm
    if design is not None and design.electrics.is_conduction:
        lengths = samples.effective_length_mm
    if design is None or lengths is None:
        raise SampleError("samples without lengths and design cannot be measured again: take what simulate gave.")
    other = {spec.name for spec in fields(Imperfections)} | {"readout", "recipe"}
    kept = {name: value for name, value in samples.made_from.items() if name not in other}
    return replace(
        samples,
        resistance_ohm=read_resistances(_exact(lengths, design), imperfections, seed, readout),
        **imperfections.of_samples(design),
        made_from={**kept, **imperfections.as_attributes(), **read_through(readout), "noise_seed": seed},
    )


def require_conducted(response: ArrayResponse) -> None:
    """Refuse the response of a design of conduction that holds none."""
    if response.design.electrics.is_conduction and response.conducted is None:
        raise DesignError("the design asks for conduction, its response holds none: make the response again.")


def read_resistances(
    exact_ohm: FloatArray, imperfections: Imperfections, seed: int, readout: Readout | None, first: int = 0
) -> FloatArray:
    """Exact resistances (n, rows, cols, 3) [Ω] as a sensor of these imperfections reads them, from sample `first` on.

    Each block has a stream of noise that no loads use.
    """
    blocks = [
        imperfections.apply(
            exact_ohm[start : start + BLOCK],
            np.random.default_rng([seed, (first + start) // BLOCK, MAX_ROUNDS]),
            readout,
        )
        for start in range(0, len(exact_ohm), BLOCK)
    ]
    return np.concatenate(blocks)


def _exact(length_mm: FloatArray, design: SensorDesign) -> FloatArray:
    """Resistances [Ω] of pillars of these lengths, effective ones of conduction."""
    return pillar_resistances(length_mm, pillar_volumes(design.unit), design.resistivity_ohm_mm)


def displacements(response: ArrayResponse, traction_mpa: FloatArray, axes: tuple[str, ...] = AXES) -> FloatArray:
    """Displacement of the upper electrodes (n, n_units, 2, 3) [mm] under tractions (n, n_units, 3) [MPa].

    Tractions along other axes than `axes` are known to be 0 and are skipped.
    """
    n, n_units, _ = traction_mpa.shape
    loaded = [AXES.index(axis) for axis in axes]
    influence = response.influence_mm_per_n.reshape(n_units * 6, n_units, 3)[:, :, loaded]
    newtons = traction_mpa[:, :, loaded].reshape(n, -1) * response.design.pad.size_mm**2
    return (newtons @ influence.reshape(n_units * 6, -1).T).reshape(n, n_units, 2, 3)


def labelled(
    traction_mpa: FloatArray,
    displacement_mm: FloatArray,
    effective_mm: FloatArray | None,
    design: SensorDesign,
    settings: DatasetSettings,
    readout: Readout | None,
    first: int = 0,
) -> dict[str, Any]:
    """All variables (n, rows, cols, ...) of samples from number `first` on; of conduction with effective lengths."""
    grid = (len(traction_mpa), design.array.rows, design.array.cols)
    traction, displacement = traction_mpa.reshape(*grid, 3), displacement_mm.reshape(*grid, 2, 3)
    length = pillar_lengths(displacement, design.unit)
    effective = length if effective_mm is None else effective_mm.reshape(length.shape)
    return {
        "traction_mpa": traction,
        "force_n": forces(traction, design),
        "displacement_mm": displacement,
        "length_mm": length,
        "resistance_ohm": read_resistances(_exact(effective, design), settings, settings.seed, readout, first),
    } | ({} if effective_mm is None else {"effective_length_mm": effective})


def below_cap(
    draw: Callable[[np.ndarray, int], tuple[Sequence[np.ndarray], np.ndarray]],
    n: int,
    rounds: int,
    settings: DatasetSettings,
    design: SensorDesign,
) -> tuple[list[np.ndarray], np.ndarray]:
    """Draw n samples, and those again that are not accepted: arrays (n, ...) and how often each was drawn again (n,).

    `draw` takes the numbers (m,) of those that are wanted and how often they were drawn before; it gives arrays
    (m, ...) and which samples are accepted (m,). A sample drawn in vain in all rounds is a `LoadError`.
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
    raise LoadError(
        f"protocol '{settings.protocol}' strained some pillar beyond cap={settings.cap:g} in {rounds} draws on end: "
        f"raise the cap, or lower the forces by a smaller pad (size_mm={design.pad.size_mm:g})."
    )


def _block(
    response: ArrayResponse, settings: DatasetSettings, number: int, readout: Readout | None, kept: int
) -> tuple[dict[str, FloatArray], np.ndarray]:
    """All samples of one block by variable, and how often each was redrawn; contacts only as far as wanted."""
    design = response.design
    pressed = indented(design, settings.seed, number, kept)

    def draw(waiting: np.ndarray, attempt: int) -> tuple[list[FloatArray], np.ndarray]:
        if settings.protocol == INDENT:
            drawn = pressed(waiting, attempt)
        else:
            protocol, generator = PROTOCOLS[settings.protocol], np.random.default_rng([settings.seed, number, attempt])
            traction = protocol.draw(generator, len(waiting), design)
            drawn = [traction, displacements(response, traction, protocol.axes)]
        return drawn, ~(largest_strains(drawn[1], design.unit) > settings.cap)

    (traction, displacement, *moment), redrawn = below_cap(draw, BLOCK, MAX_ROUNDS, settings, design)
    effective = None
    if design.electrics.is_conduction and response.conducted is not None:
        effective = conducted_lengths(response.conducted, traction * design.pad.size_mm**2)
    found = labelled(traction, displacement, effective, design, settings, readout, number * BLOCK)
    if moment:  # of contacts
        found["moment_nmm"] = moment[0].reshape(-1, design.array.rows, design.array.cols, 2)
    return found, redrawn


def read_through(readout: Readout | None) -> dict[str, str]:
    """The electronics as a file's attribute."""
    return {} if readout is None else {"readout": json.dumps(asdict(cast("Any", readout)))}
