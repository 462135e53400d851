"""The resistances and forces that the page shows: of the array as simulated, or of a sensor live or recorded."""

import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from common.errors import TriPillarError
from dataset.loads import displacements, loads_of
from dataset.measurement import measured
from dataset.protocols import PROTOCOLS, forces
from dataset.resistance import (
    effective_lengths,
    exact_resistances,
    largest_factors,
    pillar_lengths,
    pillar_strains,
    rest_resistances,
)
from decoupler.data.columns import component_named, force_columns
from decoupler.inverse.sensor_model import ModelInverse, SensorModel
from decoupler.model.decoder import Decoder
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.layout import FloatArray, untold
from hardware.link.reception import Scan
from hardware.readout.forces import Forces
from hardware.readout.wrench import OF_MOMENTS, on_all_axes
from hardware.session import live
from tripillar.terminal.force_view import RATE_OVER, RENEWED_S, STALE_S, contact_lines, notes_on, pace

N_LOADS = 2000  #: of each protocol, that the response's inverse is fitted to
MAX_STRAIN = 0.35  #: of a pillar under these loads: a little past the 30 % of the datasets

#: forces (rows, cols, 3) [N] along x, y, z from resistances (rows, cols, P) [Ω]; NaN where unknown
Decouple = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """The array at one moment: its loads, its resistances, and the forces decoupled from these."""

    traction_mpa: FloatArray  #: (n_units, 3): on the pads, z negative pushing down
    applied_n: FloatArray  #: (rows, cols, 3): forces on the pads, Fz positive in compression; NaN where unknown
    resistance_ohm: FloatArray  #: (rows, cols, P): of each unit's P pillars
    change: FloatArray  #: (rows, cols, P): of the resistances from rest, relative
    force_n: FloatArray  #: (rows, cols, 3): decoupled, along x, y, z; NaN where the model gives none
    strain: FloatArray  #: (rows, cols, P): of each pillar |l − l₀|/l₀, under the load; infinite where turned over
    half_width_n: FloatArray | None = None  #: (rows, cols, 3): that holds 68 % of the forces' errors, of a sensor
    moment_nmm: FloatArray | None = None  #: (rows, cols, 3): of touch, about each unit's middle; NaN where unknown
    moment_half_width_nmm: FloatArray | None = None  #: of that shape


@dataclass(frozen=True, eq=False)
class PressedSensor:
    """The simulated sensor: exact resistances under loads, and what a decoupler makes of them."""

    response: ArrayResponse
    decouple: Decouple

    def read(self, traction_mpa: FloatArray, noise: float, draw: np.random.Generator) -> Reading:
        """Reading under tractions (n_units, 3) [MPa] with relative noise of the resistances."""
        design = self.response.design
        moved_mm, newtons = displacements(self.response, traction_mpa[None]), traction_mpa[None] * design.pad.size_mm**2
        lengths_mm = by_unit(effective_lengths(self.response, moved_mm, newtons)[0], design)
        ohm = measured(exact_resistances(lengths_mm, design), noise, None, draw)
        return Reading(
            traction_mpa=traction_mpa, applied_n=by_unit(forces(traction_mpa, design), design), resistance_ohm=ohm,
            change=ohm / rest_resistances(design) - 1.0, force_n=self.decouple(ohm),
            strain=self._strains(moved_mm[0]),
        )  # fmt: skip

    def follow(self, scan: Forces) -> Reading:
        """Reading of a sensor's scan; strains are those under the forces found, since nobody knows what acts."""
        traction_mpa, rest_ohm = tractions(scan.force_n, self.response.design), rest_resistances(self.response.design)
        strain = self._strains(displacements(self.response, traction_mpa[None])[0])
        return Reading(
            traction_mpa=traction_mpa, applied_n=np.full_like(scan.force_n, np.nan), resistance_ohm=scan.resistance_ohm,
            change=scan.resistance_ohm / rest_ohm - 1.0, force_n=scan.force_n, strain=strain,
            half_width_n=scan.deviation_n, moment_nmm=moments(scan.moment_nmm),
            moment_half_width_nmm=None if (half := moments(scan.moment_deviation_nmm)) is None else np.abs(half),
        )  # fmt: skip

    def _strains(self, moved_mm: FloatArray) -> FloatArray:
        """Strains (rows, cols, P) of all pillars whose electrodes moved."""
        unit = self.response.design.unit
        return by_unit(pillar_strains(moved_mm, pillar_lengths(moved_mm, unit), unit), self.response.design)


def net_forces(model: Decoder) -> Decouple:
    """The forces of a trained model."""
    return lambda resistance_ohm: on_all_axes(model.forces(resistance_ohm[None])[0], model.component.axes)


def inverse_forces(response: ArrayResponse) -> Decouple:
    """The forces of the response's own inverse, where there is no trained model; pressure alone if no more is told."""
    design, told = response.design, component_named("fz" if untold(response.design.unit) else "all")
    generator, ranges = np.random.default_rng(0), loads_of(response)
    drawn = [PROTOCOLS[name].draw(generator, N_LOADS, design, ranges) for name in ("contact", "three-axis")]
    loads = np.concatenate(drawn)
    within = largest_factors(displacements(response, loads), design.unit, MAX_STRAIN)
    loads *= np.minimum(within, 1.0)[:, None, None]  # a pillar that turns over cannot be inverted
    force_n = force_columns(by_unit(forces(loads, design), design), told)
    forward = SensorModel.of(response, told)
    inverse = ModelInverse.about(forward, force_n, np.ones(forward.n_pillars, dtype=bool), noise=0.0)

    def decoupled(resistance_ohm: FloatArray) -> FloatArray:
        force_n = inverse.values(resistance_ohm.reshape(1, -1)).reshape(design.n_units, -1)
        return on_all_axes(by_unit(force_n, design), told.axes)

    return decoupled


def by_unit(values: FloatArray, design: SensorDesign) -> FloatArray:
    """(..., n_units, n) as (..., rows, cols, n)."""
    return values.reshape(*values.shape[:-2], design.array.rows, design.array.cols, values.shape[-1])


def tractions(force_n: FloatArray, design: SensorDesign) -> FloatArray:
    """Tractions (n_units, 3) [MPa] on the pads from forces (rows, cols, 3) [N]; unknown forces count as 0."""
    return np.nan_to_num(force_n).reshape(-1, 3) / forces(np.ones(3), design)


def moments(load_nmm: FloatArray | None) -> FloatArray | None:
    """Moments (..., 3) [N mm] about x, y and z from those of `Touched.load` (..., 2 or 3); NaN where there is none."""
    if load_nmm is None:
        return None
    kinds = load_nmm.shape[-1]
    found = load_nmm @ OF_MOMENTS[:kinds, 3:]
    return np.where(OF_MOMENTS[:kinds, 3:].any(axis=0), found, np.nan)


class SensorFeed:
    """The board on a port or the frames of a recording, for all who look at the page.

    Open from entering to leaving the with block; each `look` renews `scan`, `trouble`, `link`, `is_stale`, `faults` and
    `ended`, and calls `listeners` where one has changed. Forces of `scan` are along x, y and z, NaN where the model
    gives none. Parameters and errors are those of `hardware.session.live`.
    """

    def __init__(
        self, port: str, model: Decoder, calibration: Path | str | None = None,
        clock: Callable[[], float] = time.monotonic, **settings: Any,
    ) -> None:  # fmt: skip
        self.port = port
        self.scan: Forces | None = None
        self.trouble = self.link = ""  #: of the newest scan; rate and losses, or why no scans come
        self.faults: list[str] = []  #: what is wrong with the newest scan, in words
        self.contacts: list[str] = []  #: what a decoder of touch finds in it, in words
        self.ended = False  #: a recording has been played to its end
        self.is_stale = False  #: no scan has come for `STALE_S`, so what is shown is no longer so
        self.listeners: set[Callable[[], None]] = set()
        self._given, self._settings = (port, model, calibration), settings
        self._open, self._clock = ExitStack(), clock
        self._newest: deque[Scan] = deque(maxlen=RATE_OVER)

    def __enter__(self) -> Self:
        self._sensor = self._open.enter_context(live(*self._given, **self._settings))
        self._heard_s = self._clock()
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def look(self) -> bool:
        """Take the newest scan, if one has come, without waiting; returns whether anything is new."""
        before, scanner, last = (self.trouble, self.link, self.ended), self._sensor.scanner, None
        while (later := scanner.get(timeout=0.0)) is not None:
            last = later
            self._newest.append(last)
        try:
            if last is not None:
                found = self._sensor.forces(last, RENEWED_S)
                self.faults, self.contacts, self.trouble = notes_on(found), contact_lines(found), ""
                axes = self._sensor.model.component.axes
                half_n = None if found.deviation_n is None else on_all_axes(found.deviation_n, axes)
                self.scan = replace(found, force_n=on_all_axes(found.force_n, axes), stated=(half_n, None))
        except TriPillarError as error:  # of one scan; the next may be sound
            self.trouble, last = str(error), None
        now_s = self._clock()
        self._heard_s = now_s if last is not None else self._heard_s
        told = f"{pace(self._newest):.0f} scans/s, {scanner.stats.lost} lost"
        self.ended, self.is_stale = scanner.ended, not scanner.ended and now_s - self._heard_s > STALE_S
        if self.is_stale:
            told = f"no scan for {now_s - self._heard_s:.0f} s{f': {scanner.trouble}' if scanner.trouble else ''}"
        self.link = "recording ended" if scanner.ended else told
        is_new = last is not None or before != (self.trouble, self.link, self.ended)
        for tell in list(self.listeners) if is_new else ():
            tell()
        return is_new

    def play_again(self) -> None:
        """Start a recording from its beginning."""
        try:
            self._open.close()
            self.__enter__()
        except TriPillarError as error:  # the file is gone, perhaps
            self.trouble = str(error)
