"""Counts to forces, of live scans and of whole recordings: crosstalk out, calibration, tare, model."""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from common.bounded import require_memory
from common.errors import FileFormatError
from common.storage.netcdf import Content, Named, labelled
from common.threads import one_blas_thread
from dataset.imperfections import OPEN_OHM
from geometry.layout import AXES, FloatArray
from hardware.link.frames import Info
from hardware.link.reception import Scan
from hardware.link.scanner import Scanner
from hardware.readout.calibration import SensorCalibration
from hardware.readout.crossbar import Corrector
from hardware.readout.description import SensorDescription, describe
from hardware.readout.memory import MemoryReader
from hardware.readout.wrench import NET, Wrench, net_wrench, wrench_weights
from hardware.recording import Recording

if TYPE_CHECKING:
    import xarray as xr

    from decoupler.evaluation.faults import FaultTest
    from decoupler.model.decoder import Decoder
    from decoupler.rubber.belief import SensorFilter

CHUNK_FRAMES = 2048  #: frames worked on together
Progress = Callable[[int], Any]
BYTES_A_COUNT = 48  #: of memory that the forces of a recording take, a count of its frames
NAMED = 3  #: pillars left out that are named in a line
LOOKED_S = 1.0  #: from one window that is looked at for faults, which takes as long as 50 scans, to the next
OF_ALL_SCANS = ("model", "faults", "weights", "description")  #: values of `Forces` that are not by scan


@dataclass(frozen=True, kw_only=True, eq=False)
class Forces:
    """Forces of n scans, live or of a recording; k components, as the model gives them.

    `forces[3]` are those of one scan, without the first axis n, `forces[3:9]` those of some.
    """

    force_n: FloatArray  #: (n, rows, cols, k)
    resistance_ohm: FloatArray  #: (n, rows, cols, P): of the P pillars of each unit as the model saw them
    saturated: NDArray[np.bool_]  #: (n, rows, cols, P): counts at 0 or full scale, which only bound a resistance
    left_out: NDArray[np.bool_]  #: (n, rows, cols, P): readings that no strain explains, which the forces do without
    time_s: Any = None  #: (n,): start of each scan; live on the Unix clock, of a recording the board's
    stamp_ns: Any = None  #: (n,): the same on the Unix clock [ns], which only grows
    device_us: Any = None  #: (n,): the board's clock as sent [µs], modulo 2³²
    sequence: Any = None  #: (n,): frames sent since the board's start, modulo 2¹⁶
    model: "Decoder | None" = field(default=None, repr=False)  #: knows the deviations; None if there are none
    faults: Mapping[str, int] = field(default_factory=dict)  #: of pillars and wires, and in how many windows of scans
    moment_nmm: FloatArray | None = None  #: (n, rows, cols, 2 or 3): of touch, the moments of `Touched.load`
    moment_deviation_nmm: FloatArray | None = None  #: of that shape: half-widths that hold 68 % of their errors
    contacts: Any = None  #: (n,): of touch, `TouchContact` of each scan
    stated: tuple[FloatArray | None, FloatArray | None] | None = field(default=None, repr=False)  #: known `deviations`
    tested: tuple[FloatArray, FloatArray] | None = field(default=None, repr=False)  #: known `consistency`
    memory_rise: FloatArray | None = None  #: (n, rows, cols, P): of ln R, taken for the rubber's memory and taken away
    memory_deviation: FloatArray | None = None  #: of that shape: relative, that this leaves of the resistances
    memory_tested: Any = None  #: (n,): whether readings had tested the rubber's law, which is not applied before
    weights: FloatArray = field(repr=False)  #: (rows·cols·k, 6): `wrench_weights` of the sensor
    description: SensorDescription = field(repr=False)  #: of what does not change from scan to scan

    def __getitem__(self, which: int | slice) -> "Forces":
        """Forces of some scans; what has been computed of all goes along, such as deviations and net load."""

        def some(values: Any) -> Any:
            if isinstance(values, Wrench):
                return Wrench(**{name: some(each) for name, each in vars(values).items()})
            return (
                tuple(map(some, values)) if isinstance(values, tuple) else values if values is None else values[which]
            )

        chosen = copy(self)
        vars(chosen).update({name: some(each) for name, each in vars(self).items() if name not in OF_ALL_SCANS})
        return chosen

    @cached_property
    def deviations(self) -> tuple[FloatArray | None, FloatArray | None]:
        """Half-widths that hold 68 % of the forces' errors, of their shape [N], and the net wrench's covariance.

        The latter is (n, 6, 6), as `net_wrench` takes it; both are None if the model knows none. Computed when first
        asked for, which takes twenty times as long as the forces.
        """
        if self.stated is not None:
            return self.stated
        if self.model is None:
            return None, None
        ohms = self._decoded_ohm
        chunks = [slice(k, k + CHUNK_FRAMES) for k in range(0, len(ohms), CHUNK_FRAMES)]
        own = [] if self.memory_deviation is None else [self.memory_deviation.reshape(ohms.shape)]
        parts = [self.model.deviations(ohms[k], self.weights, *(each[k] for each in own)) for k in chunks]
        deviation_n, covariance = (np.concatenate(each) for each in zip(*parts, strict=True))
        return deviation_n.reshape(self.force_n.shape), covariance.reshape(*self.force_n.shape[:-3], 6, 6)

    @property
    def _decoded_ohm(self) -> FloatArray:
        """Resistances (n, rows, cols, P) as they were decoded: those left out as open."""
        return np.where(self.left_out, OPEN_OHM, self.resistance_ohm).reshape(-1, *self.resistance_ohm.shape[-3:])

    @property
    def deviation_n(self) -> FloatArray | None:
        """Half-widths that hold 68 % of the forces' errors, of their shape [N]; None if the model knows none."""
        return self.deviations[0]

    @cached_property
    def wrench(self) -> Wrench:
        """Net force, net moment and centre of pressure, with deviations if the model knows them."""
        load = self.force_n if self.moment_nmm is None else np.concatenate([self.force_n, self.moment_nmm], axis=-1)
        return net_wrench(load, self.weights, self.deviations[1])

    @cached_property
    def consistency(self) -> tuple[FloatArray, FloatArray] | None:
        """χ² over its degrees of freedom if a load that the model knows is on the sensor, and its limit, each (n,)."""
        if self.tested is not None or self.model is None:
            return self.tested
        ohms = self._decoded_ohm
        tested = self.model.consistency(ohms, self.force_n.reshape(len(ohms), *self.force_n.shape[-3:]))
        return tested and (tested[0].reshape(self.force_n.shape[:-3]), tested[1].reshape(self.force_n.shape[:-3]))

    @property
    def chi2(self) -> FloatArray | None:
        """χ² over its degrees of freedom, (n,); None if the model does not say which loads it knows."""
        return self.consistency and self.consistency[0]

    @property
    def unexplained(self) -> NDArray[np.bool_]:
        """Which scans no load explains that the model knows, (n,): χ² is beyond the 99.9 % of readings at rest."""
        if self.consistency is None:
            return np.zeros(self.force_n.shape[:-3], dtype=bool)
        return np.asarray(~(self.consistency[0] <= self.consistency[1]))

    @cached_property
    def unreliable(self) -> NDArray[np.bool_]:
        """Which scans have lost so many readings that their forces are not to be relied on, (n,)."""
        lost = self.left_out.reshape(-1, *self.left_out.shape[-3:])
        flags = np.zeros(len(lost), dtype=bool) if self.model is None else self.model.unreliable(lost)
        return flags.reshape(self.force_n.shape[:-3])

    def named_out(self) -> list[tuple[int, int, str]]:
        """Row, column and name of each pillar that is left out of any of the scans."""
        lost = self.left_out.reshape(-1, *self.left_out.shape[-3:]).any(axis=0)
        names = self.description.layout.pillar_names
        return [(row, col, names[pillar]) for row, col, pillar in np.argwhere(lost).tolist()]

    def said_out(self) -> str:
        """The same in words, the first few of them."""
        lost = self.named_out()
        named = ", ".join(f"{name} of row {row}, col {col}" for row, col, name in lost[:NAMED])
        return f"{named} and {len(lost) - NAMED} more" if len(lost) > NAMED else named

    def net(self) -> dict[str, FloatArray]:
        """Values of the wrench by their names in files and streams; unknown deviations are left out."""
        named = {name: getattr(self.wrench, attribute) for name, (attribute, _) in NET.items()}
        return {name: values for name, values in named.items() if values is not None}

    def content(self) -> Content:
        """The forces of a recording with their deviations, net wrench and χ², as they are written to NetCDF."""
        over_units = ("frame", "row", "col", "axis")
        variables = {
            "force_n": Named(over_units, self.force_n, {"units": "N"}),
            "saturated": Named(("frame", "row", "col", "pillar"), self.saturated.astype(np.int8)),
            "left_out": Named(("frame", "row", "col", "pillar"), self.left_out.astype(np.int8)),
        }
        if self.deviation_n is not None:
            meaning = "half-width that holds 68 % of errors"
            variables["deviation_n"] = Named(over_units, self.deviation_n, {"units": "N", "meaning": meaning})
        if self.moment_nmm is not None:
            attributes = {"units": "N mm", "meaning": "moments of the pressure about the unit's middle, of x p and y p"}
            variables["moment_nmm"] = Named(("frame", "row", "col", "place"), self.moment_nmm[..., :2], attributes)
        if self.chi2 is not None:
            meaning = "chi squared over its degrees of freedom if a known load is on the sensor"
            variables["chi2"] = Named(("frame",), self.chi2, {"units": "1", "meaning": meaning})
        for name, values in self.net().items():
            place = "place" if "centre" in name else "direction"
            variables[name] = Named(("frame", place), values, {"units": NET[name][1]})
        pillars = self.description.layout.pillar_names
        labels = {"axis": self.description.axes, "direction": AXES, "place": AXES[:2], "pillar": pillars}
        return Content(
            data_vars=variables,
            coords={"time_s": Named(("frame",), self.time_s, {"units": "s"}), **labelled(labels)},
            attrs={"sensor": json.dumps(self.description.plain())},
        )

    def to_xarray(self) -> "xr.Dataset":
        """The same as xarray has it."""
        return self.content().to_xarray()


class ForceReader:
    """Turns counts of one board into the forces on its sensor, in one thread.

    A model mixes the pillars of all units, so readings that are saturated, or that no strain explains, are left out of
    their scan: `Forces.left_out` says which, and `Forces.unreliable` where too many are.

    Without a calibration the sensor is taken to be as designed; without `crosstalk` each crossing is taken as read
    alone. With `causal`, what the rubber remembers is taken out of the readings, which then have an order: a reader is
    of one sequence of scans. `FileFormatError` if model or calibration are of another array or design, if both know
    gains, or if there is a state at rest or a memory and the model states no design.
    """

    def __init__(
        self,
        info: Info,
        model: "Decoder",
        calibration: SensorCalibration | None = None,
        crosstalk: bool = True,
        causal: "SensorFilter | None" = None,
    ) -> None:
        info.require_array("the model", model.rows, model.cols, model.layout, "take a model trained for this array")
        self.model = model
        self.calibration = calibration or SensorCalibration.as_designed(info.rows, info.cols, layout=info.layout)
        self.calibration.require_for(info)
        self.crossbar = self.calibration.electronics.crossbar(info)
        self._invert = Corrector(self.crossbar).correct if crosstalk else self.crossbar.uncorrected
        made_for = self.calibration.made_from.get("design_hash")
        if made_for and model.design_hash and made_for != model.design_hash:
            raise FileFormatError(
                f"the calibration is for a sensor of design {made_for}, the model for one of {model.design_hash}: "
                "take a model of that design, or calibrate by the model's."
            )
        if model.is_identified and not self.calibration.is_tare_only:
            raise FileFormatError(
                "the model is identified from this sensor's pairs, and the calibration knows its gains too: give a "
                "calibration that only holds a tare, or a model of the sensor as designed."
            )
        rest_ohm = model.rest_resistances()
        needs = "the tare" if self.calibration.rest_ohm is not None else "the rubber" if causal is not None else ""
        if needs and rest_ohm is None:
            raise FileFormatError(
                f"the model states no design, so what the sensor should show at rest is unknown: leave {needs} out, or "
                "train on data that state their design or hold samples without a load."
            )
        contact_ohm = 0.0 if model.design is None else 2.0 * model.design.electrics.contact_ohm
        self.memory = None if causal is None or rest_ohm is None else MemoryReader(causal, rest_ohm, contact_ohm)
        self._tare_factor = self.calibration.tare_factor(
            np.ones(self.calibration.gain.shape[-1]) if rest_ohm is None else rest_ohm
        )
        self.description = describe(model, info)
        self._weights = wrench_weights(self.description.position_mm, model.component.axes, model.moments)
        self._decoder = model
        if rest_ohm is not None:
            # this board's steps, which a plain divider amplifies, for those of training
            usual_ohm = rest_ohm if model.usual_ohm is None else model.usual_ohm
            steps = float(np.median(self.crossbar.step_deviation(usual_ohm[None])))
            noise = math.hypot(model.errors.noise, steps)
            self._decoder = model.read_by(replace(model.errors, noise=noise, bits=None))
            _ = self._decoder.consistency(rest_ohm[None])  # prepared before the first scan

    @cached_property
    def fault_test(self) -> "FaultTest | None":
        """Test that names broken pillars and wires in windows of scans; None if the model knows too little for it."""
        from decoupler.evaluation.faults import FaultTest  # as heavy as the model, which not every reader has

        return None if self._decoder.design is None else FaultTest.of(self._decoder)

    def measured(self, counts: NDArray[Any]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Resistances (n, rows, cols, P) [Ω] that counts (n, n_crossings) stand for, and which are saturated."""
        readings, saturated = self.crossbar.fractions(counts)
        return self._invert(readings), self.crossbar.as_pillars(saturated)

    def forces(self, counts: NDArray[Any], seconds: FloatArray | None = None, progress: Progress = id) -> Forces:
        """Forces of n scans from their counts, (n, n_crossings), in the order of `geometry.wiring.crossings`.

        A rubber that remembers is followed over `seconds` (n,), each since the scan before; 0 each by default.
        `progress` is told the scans of each part without its crosstalk, which takes nine tenths of the time.
        """
        parts = []
        for k in range(0, len(counts), CHUNK_FRAMES):
            parts.append(self.measured(counts[k : k + CHUNK_FRAMES]))
            progress(len(parts[-1][0]))
        whole = parts[0] if len(parts) == 1 else [np.concatenate(each) for each in zip(*parts, strict=True)]
        measured_ohm, saturated = whole
        resistance_ohm = self.calibration.as_designed_ohm(measured_ohm) * self._tare_factor
        left_out = self.model.lost(resistance_ohm) | saturated
        read: dict[str, Any] = {"resistance_ohm": resistance_ohm}
        if self.memory is not None:
            read = self.memory.settled(resistance_ohm, np.zeros(len(counts)) if seconds is None else seconds)
        ohms = np.where(left_out, OPEN_OHM, read["resistance_ohm"])
        decoded = self._decoder.decoded(ohms, self._weights, read.get("memory_deviation"))
        return Forces(
            saturated=saturated,
            left_out=left_out,
            model=self._decoder,
            weights=self._weights,
            description=self.description,
            **read,
            **vars(decoded),
        )


class LiveSensor:
    """A sensor whose scans become forces; iterate over it for those of one scan after another.

    The scanner is entered; model, calibration and what is refused are as of `ForceReader`.
    """

    def __init__(
        self,
        scanner: Scanner,
        model: "Decoder",
        calibration: SensorCalibration,
        causal: "SensorFilter | None" = None,
    ) -> None:
        self.scanner, self.model = scanner, model
        # scans come one after another
        self._reader = ForceReader(scanner.info, model.follower(), calibration, causal=causal)
        self._last: Scan | None = None
        self._window: list[FloatArray] = []
        self._faults: dict[str, int] = {}
        self._look_s = -math.inf  # when the next window begins
        self._known: tuple[float, Forces] | None = None  # when deviations were last computed, and of what
        self.description = self._reader.description  #: where the pads are, and what does not change from scan to scan

    def __iter__(self) -> Iterator[Forces]:
        """Forces of each scan as it comes; ends with a recording. A board that falls silent is waited for."""
        return map(self.forces, self.scanner)

    def forces(self, scan: Scan, renewed_s: float = 0.0) -> Forces:
        """Forces of one scan, without the first axis of `Forces`; its faults are those of the last window.

        Deviations up to `renewed_s` old [s] are kept rather than computed anew, for who asks for those of every scan.
        """
        scans = self._reader.forces(scan.frame.counts[None], np.array([self._since_last(scan)]))
        test = self._reader.fault_test
        if test is not None and scan.received_s >= self._look_s:
            self._window.append(scans.resistance_ohm[0])
            if len(self._window) == test.window:
                self._faults = {str(fault): 1 for fault in test.named(np.stack(self._window))}
                self._window, self._look_s = [], scan.received_s + LOOKED_S
        forces = replace(
            scans[0],
            time_s=np.float64(scan.time_s),
            stamp_ns=np.int64(scan.stamp_ns),
            device_us=np.uint32(scan.frame.device_us),
            sequence=np.uint16(scan.frame.sequence),
            faults=self._faults,
        )
        if forces.stated is not None:
            return forces
        if self._known is None or scan.received_s >= self._known[0] + renewed_s:
            self._known = scan.received_s, forces
            return forces
        return replace(forces, stated=self._known[1].deviations)

    def _since_last(self, scan: Scan) -> float:
        """Seconds since the scan before: of the board's clock, and of the host's over a restart."""
        last, self._last = self._last, scan
        if last is None or self._reader.memory is None:
            return 0.0
        if scan.run != last.run:
            return max(scan.received_s - last.received_s, 0.0)
        return 1e-6 * ((scan.frame.device_us - last.frame.device_us) % 2**32)


@one_blas_thread()  # `Decoupler.forces` has a thread a core of its own
def replay(
    recording: Recording,
    model: "Decoder",
    calibration: SensorCalibration | None = None,
    crosstalk: bool = True,
    causal: "SensorFilter | None" = None,
    progress: Progress = id,
) -> Forces:
    """Forces of every frame of a recording; a `FileFormatError` if memory is too small for them.

    A calibration is used instead of the one that the recording holds; all else is as of `ForceReader`. What a rubber
    remembers is followed from the first frame on.
    """
    n_bytes, mend = BYTES_A_COUNT * recording.counts.size, "record shorter pieces, or watch it by speed="
    require_memory(n_bytes, f"the recording: forces of {len(recording.counts):,} frames", mend)
    if calibration is None and recording.calibration:
        calibration = SensorCalibration.from_json(recording.calibration, "the recording's calibration")
    reader = ForceReader(recording.info, model.follower(), calibration, crosstalk, causal)
    forces = reader.forces(recording.counts, np.diff(recording.time_s, prepend=recording.time_s[:1]), progress)
    return replace(
        forces,
        time_s=recording.time_s,
        device_us=recording.device_us,
        sequence=recording.sequence,
        faults={} if reader.fault_test is None else reader.fault_test.named_in(forces.resistance_ohm),
    )
