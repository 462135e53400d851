"""What every decoder is: ohms in, newtons out, and how sure they are, whatever it learned from and whatever fails.

A reading that no strain of the sensor explains is left out of its scan, on every road alike: `Decoder.lost` finds such
pillars, and `Decoder.without` is the decoder that does without them.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from common.storage.files import digest
from dataset.measurement import ReadingError
from dataset.samples import SampleError
from decoupler.data.columns import Component, Scaling, pillar_columns
from geometry.design import SensorDesign
from geometry.layout import FloatArray, Layout
from geometry.wiring import pillars_of_wires

BEYOND = 2.0  #: times as long as usual, or as short, at which no pillar arrives
SPREAD = 0.1  #: standard deviation of ln R under usual loads, where too few samples tell it
STRANGE = float(np.log(BEYOND**2) / SPREAD) ** 2  #: least χ² over its degrees of freedom of what is left out
MANY = 10  #: pillars left out of a scan, from which on its forces are not to be relied on
PATTERNS = 16  #: of pillars left out, whose decoders are kept


@dataclass(frozen=True, kw_only=True, eq=False)
class Decoded:
    """What a decoder tells of n scans; what it does not tell at once is None."""

    force_n: FloatArray  #: (n, rows, cols, n_axes)
    moment_nmm: FloatArray | None = None  #: (n, rows, cols, `Decoder.moments`)
    moment_deviation_nmm: FloatArray | None = None  #: of that shape: half-widths that hold 68 % of their errors
    contacts: list[Any] | None = None  #: (n,): `TouchContact` of each scan
    stated: tuple[FloatArray, FloatArray] | None = None  #: of `Decoder.deviations`
    tested: tuple[FloatArray, FloatArray] | None = None  #: of `Decoder.consistency`


@dataclass(frozen=True, kw_only=True, eq=False)
class Decoder(ABC):
    """From resistances (n, rows, cols, n_pillars) [Ω] to forces on units; never changed, only used."""

    design: SensorDesign | None  #: the sensor it was made for; None if that is unknown
    errors: ReadingError  #: of the readings that its deviations are for
    left_out: NDArray[np.bool_] | None = None  #: (rows, cols, n_pillars): pillars that say nothing; see `without`
    made_from: dict[str, Any] = field(default_factory=dict)  #: cache key, data hash, settings, how training ended
    moments: ClassVar[int] = 0  #: of a unit, beside its forces: see `TouchDecoder`

    if TYPE_CHECKING:  # fields of some, properties of others

        @property
        def dead(self) -> NDArray[np.bool_]:
            """Pillars (rows, cols, n_pillars) that are never looked at."""

        @property
        def component(self) -> Component: ...
        @property
        def layout(self) -> Layout: ...
        @property
        def output_scaling(self) -> Scaling:
            """Of forces, over those that it knows."""

        @property
        def is_identified(self) -> bool:
            """It is of one sensor, whose gains it knows."""

    @property
    def rows(self) -> int:
        return len(self.dead)

    @property
    def cols(self) -> int:
        return self.dead.shape[1]

    def follower(self) -> Any:
        """The same decoder for scans that come one after another."""
        return self

    @abstractmethod
    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces (n, rows, cols, n_axes) [N]."""

    @abstractmethod
    def half_widths(self, resistance_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % and 95 % of the errors of `forces`, of the same shape [N]."""

    @abstractmethod
    def deviations(
        self, resistance_ohm: FloatArray, weights: FloatArray, own: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % of the errors of `forces` [N], and the covariance (n, m, m) of m sums of loads.

        `weights` (rows·cols·k, m) are those of the k loads of each unit in each sum. `own` are relative deviations that
        each reading has besides, of the shape of the resistances.
        """

    def decoded(self, resistance_ohm: FloatArray, weights: FloatArray, own: FloatArray | None = None) -> "Decoded":
        """All that one decoding tells of scans; arguments are as of `deviations`, which costs more, and is left out."""
        return Decoded(force_n=self.forces(resistance_ohm))

    @abstractmethod
    def rest_resistances(self) -> FloatArray | None:
        """Resistances with nothing on the sensor, (rows, cols, n_pillars) [Ω]; None if its design is unknown."""

    @property
    @abstractmethod
    def usual_ohm(self) -> FloatArray | None:
        """Resistances about which usual loads move them, (rows, cols, n_pillars) [Ω]; None if nobody knows."""

    @property
    def usual_readings(self) -> tuple[FloatArray, FloatArray] | None:
        """Mean (P,) and covariance (P, P) of ln R of all P pillars under usual loads, noise apart.

        Of pillars that are not read they may be anything. None if unknown, and on bare rubber, where presses follow no
        covariance of all: by it 5 of 500 sound windows named a fault, and 69 of 278 pillars that were stuck were found.
        By presses fitted to all other readings it was 1 of 500, and 4 of 10.
        """
        return None

    def taken(self, resistance_ohm: FloatArray) -> FloatArray:
        """Resistances (n, rows, cols, n_pillars) of the component's pillars, (n, n_in) [Ω]; errors as of `columns`."""
        resistance_ohm = np.asarray(resistance_ohm, dtype=np.float64)
        columns = pillar_columns(resistance_ohm, self.component, self.layout, self.dead)
        if resistance_ohm.shape[1:3] != (self.rows, self.cols):
            given = " × ".join(map(str, resistance_ohm.shape[1:3]))
            raise SampleError(
                f"resistances are of {given} units, the model's sensor has {self.rows} × {self.cols}: "
                "train a model on data of this sensor."
            )
        return columns

    @abstractmethod
    def columns(self, resistance_ohm: FloatArray) -> FloatArray:
        """What is decoded of resistances (n, rows, cols, n_pillars) [Ω], (n, n_in); no such are a `SampleError`."""

    def without(self, pillars: NDArray[np.bool_]) -> Self:
        """The same decoder of scans in which some pillars (rows, cols, n_pillars) say nothing."""
        return replace(self, left_out=pillars if self.left_out is None else pillars | self.left_out)

    def read_by(self, errors: ReadingError) -> Self:
        """The same decoder for readings that err so."""
        return replace(self, errors=errors)

    @property
    def design_hash(self) -> str | None:
        """Hash of the design it was made for; None if that is unknown."""
        return None if self.design is None else digest(self.design)

    def lost(self, resistance_ohm: FloatArray) -> NDArray[np.bool_]:
        """Which resistances (n, rows, cols, n_pillars) [Ω] no strain of the sensor explains, of pillars that it reads.

        Those of a pillar `BEYOND` times as long as usual and more, or as short: an open contact, a short, another
        range of the electronics.
        """
        if self.usual_ohm is None or resistance_ohm.shape[1:] != self.usual_ohm.shape:
            return np.zeros(resistance_ohm.shape, dtype=bool)  # of another size, which is refused elsewhere
        low, high = self._reach
        return np.asarray((resistance_ohm < low) | (resistance_ohm > high))

    @cached_property
    def _reach(self) -> tuple[FloatArray, FloatArray]:
        usual_ohm, read = self.usual_ohm, self.read
        assert usual_ohm is not None
        return np.where(read, usual_ohm / BEYOND**2, -np.inf), np.where(read, usual_ohm * BEYOND**2, np.inf)

    @cached_property
    def read(self) -> NDArray[np.bool_]:
        """Which pillars it looks at, (rows, cols, n_pillars)."""
        found = np.zeros_like(self.dead)
        found[..., self.component.pillars(self.layout)] = True
        return found & ~self.dead

    @cached_property
    def is_blind(self) -> bool:
        """Most pillars that it looks at are left out: not faults of some, but readings of something else."""
        return self.left_out is not None and 2 * int((self.left_out & self.read).sum()) > int(self.read.sum())

    def unreliable(self, lost: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which scans have lost so many readings (n, rows, cols, n_pillars) that their forces are not relied on, (n,).

        Those of `MANY` pillars, or of all of a wire.
        """
        flat = lost.reshape(len(lost), -1)
        found = flat.sum(axis=1) >= MANY
        for wire in pillars_of_wires(self.rows, self.cols, self.layout):
            if len(wire) > 1:
                found |= flat[:, wire].all(axis=1)
        return np.asarray(found)

    @abstractmethod
    def consistency(
        self, resistance_ohm: FloatArray, force_n: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray] | None:
        """χ² of readings (n, rows, cols, n_pillars) [Ω] over its degrees of freedom, and its limit, each (n,).

        `force_n` are their forces, if `forces` has told them. Above the limit no load that the decoder knows explains a
        reading: a dead wire, another sensor, a load beyond its range. None if it does not say which loads it knows.
        Where most readings are left out (`lost`), as of kΩ, χ² is `STRANGE`, whatever the others say.
        """

    def sifted(self, resistance_ohm: FloatArray) -> "Iterator[tuple[NDArray[np.intp], Self]]":
        """Numbers of scans (n, rows, cols, n_pillars) [Ω] that one decoder takes, and that decoder."""
        lost = self.lost(resistance_ohm)
        if not lost.any():
            yield np.arange(len(lost)), self
            return
        self.columns(resistance_ohm)  # refuses what are no resistances by the scan's number, before they are parted
        patterns, which = np.unique(lost.reshape(len(lost), -1), axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            yield np.flatnonzero(which == number), self.doing_without(pattern.reshape(lost.shape[1:]))

    def doing_without(self, pillars: NDArray[np.bool_]) -> Self:
        """`without` of pillars that are left out, the last few of which are kept."""
        if not pillars.any():
            return self
        kept: dict[bytes, Self] = self.__dict__.setdefault("_without", {})
        key = pillars.tobytes()
        if key not in kept:
            if len(kept) >= PATTERNS:
                kept.pop(next(iter(kept)))
            kept[key] = self.without(pillars)
        return kept[key]

    def each(
        self, resistance_ohm: FloatArray, ask: Callable[[Self, FloatArray, Any], tuple[FloatArray, ...]]
    ) -> tuple[FloatArray, ...]:
        """What decoders of scans (n, rows, cols, n_pillars) [Ω] answer, each asked for those that it takes."""
        resistance_ohm = np.asarray(resistance_ohm)
        if not self.lost(resistance_ohm).any():  # as usual, without a copy
            return ask(self, resistance_ohm, slice(None))
        parts = [(which, ask(decoder, resistance_ohm[which], which)) for which, decoder in self.sifted(resistance_ohm)]
        found = tuple(np.empty((len(resistance_ohm), *values.shape[1:])) for values in parts[0][1])
        for which, answers in parts:
            for whole, values in zip(found, answers, strict=True):
                whole[which] = values
        return found
