"""Counts to forces, of live scans and of whole recordings: crosstalk out, calibration, tare, model."""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geometry.errors import FileFormatError
from geometry.layout import AXES, PILLARS, FloatArray
from geometry.storage.netcdf import write_netcdf
from hardware.link.frames import Info
from hardware.link.reception import Scan
from hardware.link.scanner import Scanner
from hardware.readout.calibration import SensorCalibration
from hardware.readout.crossbar import Corrector
from hardware.readout.description import SensorDescription, describe
from hardware.readout.wrench import Wrench, net_values, net_wrench, wrench_weights
from hardware.recording import Recording

if TYPE_CHECKING:
    from decoupler.evaluation.faults import Fault, FaultTest
    from decoupler.model.decoupler import Decoupler

CHUNK = 2048  #: frames worked on together
LOOKED_S = 1.0  #: from one window that is looked at for faults, which takes as long as 50 scans, to the next


@dataclass(frozen=True, kw_only=True, eq=False)
class Forces:
    """Forces of n scans; k components, as the model gives them."""

    force_n: FloatArray  #: (n, rows, cols, k)
    resistance_ohm: FloatArray  #: (n, rows, cols, 3): pillars z, x, y as the model saw them
    saturated: NDArray[np.bool_]  #: (n, rows, cols, 3): counts at 0 or full scale, which only bound a resistance
    time_s: FloatArray | None = None  #: (n,), of a recording: the board's clock
    model: "Decoupler | None" = field(default=None, repr=False)  #: knows the deviations; None if there are none
    faults: "dict[str, int]" = field(default_factory=dict)  #: of a recording: named ones, and in how many windows
    weights: FloatArray = field(repr=False)  #: (rows·cols·k, 6): `wrench_weights` of the sensor
    description: SensorDescription = field(repr=False)  #: of what does not change from scan to scan

    @cached_property
    def deviations(self) -> tuple[FloatArray | None, FloatArray | None]:
        """Half-widths that hold 68 % of the forces' errors, of their shape [N], and the net wrench's covariance.

        The latter is (n, 6, 6), as `net_wrench` takes it; both are None if the model knows none. Computed when first
        asked for, which takes twenty times as long as the forces.
        """
        if self.model is None:
            return None, None
        n = len(self.resistance_ohm)
        parts = [self.model.deviations(self.resistance_ohm[k : k + CHUNK], self.weights) for k in range(0, n, CHUNK)]
        deviation_n, covariance = (np.concatenate(each) for each in zip(*parts, strict=True))
        return deviation_n, covariance

    @property
    def deviation_n(self) -> FloatArray | None:
        """Half-widths that hold 68 % of the forces' errors, of their shape [N]; None if the model knows none."""
        return self.deviations[0]

    @cached_property
    def wrench(self) -> Wrench:
        """Net force, net moment and centre of pressure, with deviations if the model knows them."""
        return net_wrench(self.force_n, self.weights, self.deviations[1])

    @cached_property
    def chi2(self) -> FloatArray | None:
        """χ² over its degrees of freedom if a load that the model knows is on the sensor, (n,); None if unknown."""
        test = None if self.model is None else self.model.load_test
        return None if test is None else test.chi2(self.force_n.reshape(len(self.force_n), -1))

    @property
    def unexplained(self) -> NDArray[np.bool_]:
        """Which scans no load explains that the model knows, (n,): χ² is beyond the 99.9 % of readings at rest."""
        if self.chi2 is None or self.model is None or self.model.load_test is None:
            return np.zeros(len(self.force_n), dtype=bool)
        return np.asarray(~(self.chi2 <= self.model.load_test.limit))


class ForceReader:
    """Turns counts of one board into the forces on its sensor.

    A model mixes the pillars of all units, so one that is saturated makes the forces of its whole scan an
    extrapolation. They are given all the same, finite, and `Forces.saturated` says so. Not for several threads at once.

    Parameters
    ----------
    info : Info
        Of the board.
    model : Decoupler
        Trained for this array; its design says what the sensor shows at rest.
    calibration : SensorCalibration, optional
        Of this very sensor; without one it is taken to be as designed.
    crosstalk : bool
        True takes the crossbar's crosstalk out. False takes each crossing as read alone.

    Raises
    ------
    FileFormatError
        If model or calibration are of another array or design, if both know gains, or if there is a state at rest and
        the model states no design.
    """

    def __init__(
        self, info: Info, model: "Decoupler", calibration: SensorCalibration | None = None, crosstalk: bool = True
    ) -> None:
        if (model.rows, model.cols) != (info.rows, info.cols):
            raise FileFormatError(
                f"the board has {info.rows} × {info.cols} units, the model {model.rows} × {model.cols}: "
                f"take a model trained for {info.rows} × {info.cols} units."
            )
        self.model = model
        self.calibration = calibration or SensorCalibration.as_designed(info.rows, info.cols)
        self.calibration.require_for(info)
        self.crossbar = self.calibration.electronics.crossbar(info)
        self._invert = Corrector(self.crossbar).correct if crosstalk else self.crossbar.uncorrected
        self._require_fit()
        rest_ohm = model.rest_resistances()
        if self.calibration.rest_ohm is not None and rest_ohm is None:
            raise FileFormatError(
                "the model states no design, so what the sensor should show at rest is unknown: leave the tare out, "
                "or train on data that state their design."
            )
        self._tare_factor = self.calibration.tare_factor(np.ones(3) if rest_ohm is None else rest_ohm)
        self.description = describe(model, info)
        self._weights = wrench_weights(self.description.position_mm, model.component.axes)
        self._uncertain = model if model.knows_uncertainty else None
        if rest_ohm is not None and self._uncertain:
            steps = float(np.median(self.crossbar.step_deviation(rest_ohm[None])))
            if steps > model.reading_noise:  # a plain divider amplifies its converter's steps
                self._uncertain = model.read_by(steps)
        if self._uncertain:
            _ = self._uncertain.load_test  # prepared before the first scan

    @cached_property
    def fault_test(self) -> "FaultTest | None":
        """Test that names broken pillars and wires in windows of scans; None if the model knows too little for it."""
        from decoupler.evaluation.faults import FaultTest  # as heavy as the model, which not every reader has

        return None if self._uncertain is None else FaultTest.of(self._uncertain)

    def _require_fit(self) -> None:
        calibration, model = self.calibration, self.model
        made_for = calibration.made_from.get("design_hash")
        if made_for and model.design_hash and made_for != model.design_hash:
            raise FileFormatError(
                f"the calibration is for a sensor of design {made_for}, the model for one of {model.design_hash}: "
                "take a model of that design, or calibrate by the model's."
            )
        if model.is_identified and not calibration.is_tare_only:
            raise FileFormatError(
                "the model is identified from this sensor's pairs, and the calibration knows its gains too: give a "
                "calibration that only holds a tare, or a model of the sensor as designed."
            )

    def measured(self, counts: NDArray[Any]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Resistances (n, rows, cols, 3) [Ω] that counts (n, rows·cols·3) stand for, and which are saturated."""
        readings, saturated = self.crossbar.fractions(counts)
        return self._invert(readings), self.crossbar.as_pillars(saturated)

    def forces(self, counts: NDArray[Any]) -> Forces:
        """Forces of n scans from their counts, (n, rows·cols·3), in the order of `geometry.wiring.crossings`."""
        measured_ohm, saturated = self.measured(counts)
        resistance_ohm = self.calibration.as_designed_ohm(measured_ohm) * self._tare_factor
        force_n = self.model.forces(resistance_ohm)
        return Forces(
            force_n=force_n,
            resistance_ohm=resistance_ohm,
            saturated=saturated,
            model=self._uncertain,
            weights=self._weights,
            description=self.description,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanForces:
    """Forces of one scan; k components, as the model gives them."""

    time_s: float  #: start of the scan, Unix time [s]
    force_n: FloatArray  #: (rows, cols, k)
    resistance_ohm: FloatArray  #: (rows, cols, 3): pillars z, x, y as the model saw them
    saturated: NDArray[np.bool_]  #: (rows, cols, 3): counts at 0 or full scale, which only bound a resistance
    source: Forces = field(repr=False)  #: the same, with n = 1
    faults: "tuple[Fault, ...]" = ()  #: of pillars and wires, in the last whole window of scans

    @property
    def deviation_n(self) -> FloatArray | None:
        """Half-widths that hold 68 % of the forces' errors, (rows, cols, k) [N]; None if the model knows none."""
        return None if self.source.deviation_n is None else self.source.deviation_n[0]

    @property
    def wrench(self) -> Wrench:
        """Net force, net moment and centre of pressure, n = 1, with deviations if the model knows them."""
        return self.source.wrench

    @property
    def chi2(self) -> float | None:
        """χ² over its degrees of freedom if a load that the model knows is on the sensor; None if unknown."""
        return None if self.source.chi2 is None else float(self.source.chi2[0])

    @property
    def is_explained(self) -> bool:
        """A load that the model knows explains the scan, or nothing is known of loads."""
        return not self.source.unexplained[0]


class LiveSensor:
    """A sensor whose scans become forces; iterate over it for those of one scan after another.

    Parameters
    ----------
    scanner : Scanner
        Entered.
    model : Decoupler
        Trained for this array.
    calibration : SensorCalibration
        Of this sensor.

    Raises
    ------
    FileFormatError
        If board, model and calibration do not belong together.
    """

    def __init__(self, scanner: Scanner, model: "Decoupler", calibration: SensorCalibration) -> None:
        self.scanner, self.model = scanner, model
        self._reader = ForceReader(scanner.info, model, calibration)
        self._window: list[FloatArray] = []
        self._faults: tuple[Fault, ...] = ()
        self._look_s = -math.inf  # when the next window begins

    @property
    def description(self) -> SensorDescription:
        """Where the pads are, and what does not change from scan to scan."""
        return self._reader.description

    def __iter__(self) -> Iterator[ScanForces]:
        """Forces of each scan as it comes; ends with a recording. A board that falls silent is waited for."""
        return map(self.forces, self.scanner)

    def forces(self, scan: Scan) -> ScanForces:
        """Forces of one scan."""
        found = self._reader.forces(scan.frame.counts[None])
        test = self._reader.fault_test
        if test is not None and scan.received_s >= self._look_s:
            self._window.append(found.resistance_ohm[0])
            if len(self._window) == test.window:
                self._faults, self._window = test.named(np.stack(self._window)), []
                self._look_s = scan.received_s + LOOKED_S
        return ScanForces(
            time_s=scan.time_s,
            force_n=found.force_n[0],
            resistance_ohm=found.resistance_ohm[0],
            saturated=found.saturated[0],
            source=found,
            faults=self._faults,
        )


def replay(
    recording: Recording,
    model: "Decoupler",
    calibration: SensorCalibration | None = None,
    crosstalk: bool = True,
) -> Forces:
    """Forces of every frame of a recording.

    Parameters
    ----------
    recording : Recording
    model : Decoupler
        Trained for this array.
    calibration : SensorCalibration, optional
        Used instead of the one that the recording holds.
    crosstalk : bool
        True takes the crossbar's crosstalk out.

    Raises
    ------
    FileFormatError
        As `ForceReader` does, and if the recording's calibration makes no sense.
    """
    if calibration is None and recording.calibration:
        calibration = SensorCalibration.from_json(recording.calibration, "the recording's calibration")
    reader = ForceReader(recording.info, model, calibration, crosstalk)
    parts = [reader.forces(recording.counts[k : k + CHUNK]) for k in range(0, len(recording.counts), CHUNK)]
    resistance_ohm = np.concatenate([part.resistance_ohm for part in parts])
    return Forces(
        force_n=np.concatenate([part.force_n for part in parts]),
        resistance_ohm=resistance_ohm,
        faults={} if reader.fault_test is None else reader.fault_test.named_in(resistance_ohm),
        saturated=np.concatenate([part.saturated for part in parts]),
        time_s=recording.time_s,
        model=parts[0].model,
        weights=parts[0].weights,
        description=reader.description,
    )


def write_forces(recording: Recording, forces: Forces, axes: tuple[str, ...], path: Path) -> None:
    """Write the forces of a recording as NetCDF, whole or not at all.

    `axes` names the model's components. The recording's calibration and hashes go along: they should be those used.
    """
    import xarray as xr

    over_units = ("frame", "row", "col", "axis")
    variables: dict[str, Any] = {
        "force_n": (over_units, forces.force_n, {"units": "N"}),
        "saturated": (("frame", "row", "col", "pillar"), forces.saturated.astype(np.int8)),
    }
    if forces.deviation_n is not None:
        meaning = {"units": "N", "meaning": "half-width that holds 68 % of errors"}
        variables["deviation_n"] = (over_units, forces.deviation_n, meaning)
    if forces.chi2 is not None:
        meaning = {"units": "1", "meaning": "chi squared over its degrees of freedom if a known load is on the sensor"}
        variables["chi2"] = (("frame",), forces.chi2, meaning)
    for name, (values, unit) in net_values(forces.wrench).items():
        place = "place" if "centre" in name else "direction"
        variables[name] = (("frame", place), values, {"units": unit})
    coordinates = {"axis": list(axes), "pillar": list(PILLARS), "direction": list(AXES), "place": list(AXES[:2])}
    data = xr.Dataset(
        variables,
        coords={"time_s": ("frame", recording.time_s, {"units": "s"}), **coordinates},
        attrs=asdict(recording.statistics)
        | {"calibration": recording.calibration, "sensor": json.dumps(forces.description.plain())}
        | dict(recording.made_from),
    )
    write_netcdf(data, path)
