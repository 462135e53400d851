"""Imperfections of a real sensor: its pillars differ, its readings are noisy, and some pillars cannot be read.

`Imperfections` describes one specimen and how it is read; `Imperfections.apply` takes exact resistances to measured
ones: gain and offset of each pillar, drift, noise, then the converter, and last what is dead reads as open.
"""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from common.quantity import quantity
from common.storage.files import stated
from dataset.measurement import SENSE_OHM, ReadingError, Readout, measured
from dataset.memory import AnyMemory, PillarMemory
from geometry.design import Electrics, Memory, SensorDesign, Unit
from geometry.layout import FloatArray, Layout
from geometry.wiring import crossing_of_pillar, crossings

PAPERS = Unit().layout  #: of arrays that state none
OPEN_OHM = 1e9  #: reading of an open circuit: finite, as files need it, and far above any pillar

SEEDS = (0, 2**63 - 1)  #: of random numbers: what files can hold

Place = tuple[int, int, str]  #: array row, array column and name of a pillar


@dataclass(frozen=True, kw_only=True)
class Imperfections(ReadingError):
    """One physical specimen and how it is read; the default is a perfect sensor. Wires are as in `geometry.wiring`."""

    gain_spread: float = quantity(
        0.0, "spread of the pillars' gains: each is uniform in 1 ± this", within=(0, 1), below=True
    )
    offset_ohm: float = quantity(0.0, "standard deviation of the pillars' offsets [Ω]", within=(0, 1e6))
    specimen: int = quantity(0, "seed of gains and offsets; each is another specimen", within=SEEDS)
    memory_spread: float = quantity(
        0.0, "relative standard deviation, from pillar to pillar, of what its rubber remembers", True, within=(0, 1)
    )
    temperature_rise: float = quantity(
        0.0, "temperature above that of the stated resistivity [K]", True, within=(-200.0, 300.0)
    )
    dead_pillars: tuple[Place, ...] = quantity((), "broken pillar, such as 0,3,z; can be repeated")
    dead_rows: tuple[int, ...] = quantity((), "number of a broken row wire, counted from 0; can be repeated")
    dead_cols: tuple[int, ...] = quantity((), "number of a broken column wire, counted from 0; can be repeated")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.noise > 0.1:  # ten deviations from a negative resistance
            raise DesignError(f"noise={self.noise:g} must be from 0 to 0.1; 0.001 is 0.1 % of the resistance.")
        if not (isinstance(self.dead_pillars, tuple) and all(map(_is_place, self.dead_pillars))):
            raise DesignError(
                f"dead_pillars={self.dead_pillars!r} must hold a row and a column from 0 on and the name of a pillar "
                "each, such as ((0, 3, 'z'),)."
            )
        for name in ("dead_rows", "dead_cols"):
            wires = getattr(self, name)
            if not (isinstance(wires, tuple) and all(map(_is_index, wires))):
                raise DesignError(f"{name}={wires!r} must hold numbers of wires from 0 on, such as (4, 5).")

    def gain_and_offset(
        self, rows: int, cols: int, electrics: Electrics | None = None, layout: Layout = PAPERS
    ) -> tuple[FloatArray, FloatArray]:
        """Factor [1] and offset [Ω] of every pillar of this specimen, each of shape (rows, cols, n_pillars).

        Both are drawn whatever their size, so that a wider spread is the same specimen with larger deviations. Factors
        are of the rubber: with `electrics` they are those at its temperature, and offsets make of the contacts that are
        in a design's exact resistances those of its own electrodes. A pillar with two contacts shares each with the
        pillars of that electrode.
        """
        # a spawn key keeps this stream apart from those of loads and noise, which have none, whatever their seed
        generator = np.random.default_rng(np.random.SeedSequence(self.specimen, spawn_key=(0,)))
        shape = (rows, cols, len(layout.pillars))
        gain = 1.0 + self.gain_spread * generator.uniform(-1.0, 1.0, shape)
        offset = self.offset_ohm * generator.standard_normal(shape)
        if electrics is None:
            return gain, offset
        gain = self.warmed(gain, electrics)
        if electrics.contact_ohm:
            offset = offset + self._contacts(rows, cols, electrics, layout) - gain * electrics.contacts_ohm
        return gain, offset

    def warmed(self, gain: Any, electrics: Electrics) -> Any:
        """Factors of the rubber (...) at its temperature; a `DesignError` if none is left."""
        factor = 1.0 + electrics.temperature_coefficient * self.temperature_rise
        if factor <= 0.0:
            raise DesignError(
                f"temperature_rise={self.temperature_rise:g} leaves no resistance at temperature_coefficient="
                f"{electrics.temperature_coefficient:g}: lower one of the two."
            )
        return gain if factor == 1.0 else factor * gain

    def _contacts(self, rows: int, cols: int, electrics: Electrics, layout: Layout) -> FloatArray:
        """Resistances of both contacts of each pillar together (rows, cols, n_pillars) [Ω]."""
        factors = self._factors(2, electrics.contact_spread, (rows, cols, len(layout.terminals)))
        return np.asarray(electrics.contact_ohm * of_both_ends(factors, layout))

    def memory_of(self, memory: Memory, rows: int, cols: int, layout: Layout = PAPERS) -> AnyMemory:
        """What the pillars of this specimen remember (rows, cols, n_pillars), of a rubber that remembers so much."""
        if not self.memory_spread:
            return memory
        return PillarMemory.spread(memory, self._factors(1, self.memory_spread, (6, rows, cols, len(layout.pillars))))

    def _factors(self, stream: int, spread: float, shape: tuple[int, ...]) -> FloatArray:
        """Factors of this specimen, as of `log_normal`; each kind has a stream of its own."""
        generator = np.random.default_rng(np.random.SeedSequence(self.specimen, spawn_key=(stream,)))
        return np.asarray(log_normal(generator.standard_normal(shape), spread))

    def dead_mask(self, rows: int, cols: int, layout: Layout = PAPERS) -> NDArray[np.bool_]:
        """Which pillars cannot be read, shape (rows, cols, n_pillars): broken themselves or on a broken wire.

        A pillar or wire that the array does not have is a `DesignError`.

        Examples
        --------
        >>> Imperfections(dead_rows=(0,)).dead_mask(1, 1).tolist()  # that of pillars z and x
        [[[True, True, False]]]
        """
        wires_of = crossings(rows, cols, layout)
        counts = (wires_of.max(axis=0) + 1).tolist()
        given = ("row", self.dead_rows), ("column", self.dead_cols)
        for (kind, wires), n_wires in zip(given, counts, strict=True):
            if max(wires, default=0) >= n_wires:
                raise DesignError(
                    f"an array of {rows} × {cols} units has no {kind} wire {max(wires)}: its {kind} wires are 0 to "
                    f"{n_wires - 1}."
                )
        dead, names = np.zeros((rows, cols, len(layout.pillars)), dtype=bool), layout.pillar_names
        for row, col, pillar in self.dead_pillars:
            if pillar not in names:
                raise DesignError(
                    f"dead_pillars={row},{col},{pillar} names no pillar: write row,col and one of {', '.join(names)}."
                )
            if row >= rows or col >= cols:
                raise DesignError(
                    f"an array of {rows} × {cols} units has no pillar {row},{col},{pillar}: its rows are 0 to "
                    f"{rows - 1}, its columns 0 to {cols - 1}."
                )
            dead[row, col, names.index(pillar)] = True
        row_wire, column_wire = wires_of.T
        on_dead_wire = np.isin(row_wire, self.dead_rows) | np.isin(column_wire, self.dead_cols)
        return dead | on_dead_wire[crossing_of_pillar(rows, cols, layout)]

    def apply(
        self,
        exact_ohm: FloatArray,
        generator: np.random.Generator,
        readout: Readout | None = None,
        electrics: Electrics | None = None,
        layout: Layout = PAPERS,
    ) -> FloatArray:
        """Exact resistances (n, rows, cols, n_pillars) [Ω] as this specimen shows them and its electronics read them.

        Series are (n, time, rows, cols, n_pillars). With `electrics` contacts and temperature are those of
        `gain_and_offset`. They are finite and above 0, `OPEN_OHM` where a pillar cannot be read. A `readout` is
        electronics in place of a converter that reads each pillar alone; a dead pillar is open to them. The generator
        gives one number of noise a resistance whatever the settings. A pillar or wire that the array does not have, an
        offset that outweighs a resistance, one that the converter cannot tell, or other `bits` than the readout's are a
        `DesignError`.
        """
        if readout is not None and readout.bits != self.bits:
            raise DesignError(f"bits={self.bits}, but the readout's converter has {readout.bits}: give both the same.")
        rows, cols = exact_ohm.shape[-3:-1]
        gain, offset = self.gain_and_offset(rows, cols, electrics, layout)
        dead = self.dead_mask(rows, cols, layout)
        ohms = gain * exact_ohm + offset
        ohms[..., dead] = SENSE_OHM  # anything in the converter's range: it is not what will be read
        if (ohms <= 0).any():
            raise DesignError(
                f"offset_ohm={self.offset_ohm:g} takes a pillar's resistance to {ohms.min():.4g} Ω: lower it, or "
                "choose another specimen."
            )
        if readout is None:
            ohms = self.read(ohms, generator)
        else:
            ohms = measured(self.drifted(ohms, generator), self.noise, None, generator)
            ohms[..., dead] = OPEN_OHM
            ohms = readout.measured(ohms.reshape(-1, rows, cols, len(layout.pillars)), generator).reshape(ohms.shape)
        ohms[..., dead] = OPEN_OHM
        return ohms

    def of_samples(self, design: SensorDesign) -> dict[str, Any]:
        """Noise, converter and dead pillars of samples that were read so, by their names in `Samples`."""
        dead = self.dead_mask(design.array.rows, design.array.cols, design.unit.layout)
        return {"noise": self.noise, "bits": self.bits, "dead": dead}

    def as_attributes(self) -> dict[str, Any]:
        """Every field as a NetCDF attribute can hold it; what is None, empty or no drift is left out."""
        plain = stated(self) | {"dead_pillars": [",".join(map(str, place)) for place in self.dead_pillars]}
        return {name: value for name, value in plain.items() if value is not None and value != []}


def log_normal(draws: Any, spread: float) -> Any:
    """Factors above 0 of mean 1 and this standard deviation, by standard normal draws (...), an array or a tensor."""
    sigma = math.sqrt(math.log1p(spread**2))
    logarithms = sigma * draws - sigma**2 / 2.0
    return logarithms.exp() if hasattr(logarithms, "exp") else np.exp(logarithms)


def of_both_ends(electrodes: Any, layout: Layout = PAPERS) -> Any:
    """Values of a unit's electrodes (..., e), upper ones first, summed over both ends of pillars (..., n_pillars)."""
    return electrodes[..., layout.pillar_terminals].sum(-1)


def stated_imperfections(attributes: Mapping[str, Any], rows: int, cols: int, layout: Layout = PAPERS) -> Imperfections:
    """The imperfections that a file's attributes state; one that is missing or makes no sense stays at its default."""
    found = Imperfections()
    for name in {spec.name for spec in fields(Imperfections)} & set(attributes):
        with suppress(DesignError):
            more = replace(found, **{name: _from_attribute(name, attributes[name])})
            if name.startswith("dead_"):
                more.dead_mask(rows, cols, layout)  # refuses what the array does not have
            found = more
    return found


def place_of(text: str) -> Place:
    """Place of a pillar from "row,col,pillar", the form of the command line and of a file's attributes.

    >>> place_of("0,3,z")
    (0, 3, 'z')
    """
    found = re.fullmatch(r"\s*(\d{1,9})\s*,\s*(\d{1,9})\s*,\s*(\w+)\s*", text)
    if found is None:
        raise DesignError(f"{text!r} is no place of a pillar: write row,col,pillar, such as 0,3,z.")
    row, col, pillar = found.groups()
    return int(row), int(col), pillar


def _from_attribute(name: str, value: Any) -> Any:
    """A field from its attribute, which a NetCDF library may hand over as NumPy's; a list of one comes as a scalar."""
    plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    if not name.startswith("dead_"):
        return plain
    items = plain if isinstance(plain, list) else [plain]
    return tuple(place_of(str(item)) for item in items) if name == "dead_pillars" else tuple(items)


def _is_index(value: object) -> bool:
    return type(value) is int and value >= 0


def _is_place(value: object) -> bool:
    return (
        isinstance(value, tuple | list)
        and len(value) == 3
        and all(map(_is_index, value[:2]))
        and isinstance(value[2], str)
    )
