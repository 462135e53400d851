"""From counts to forces, one scan or many: crosstalk out, calibration, tare, model."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.errors import FileFormatError
from geometry.layout import FloatArray
from hardware.link.frames import Info
from hardware.readout.calibration import SensorCalibration
from hardware.readout.correction import Corrector


class ForceModel(Protocol):
    """What forces need of a trained model; `decoupler.Decoupler` has it."""

    @property
    def rows(self) -> int: ...

    @property
    def cols(self) -> int: ...

    @property
    def design_hash(self) -> str | None:
        """Of the sensor it was made for; None if unknown."""

    @property
    def is_fine_tuned(self) -> bool:
        """It knows gain and offset of one sensor's pillars by itself."""

    @property
    def knows_uncertainty(self) -> bool: ...

    @property
    def reading_noise(self) -> float:
        """Relative standard deviation that its deviations take readings at rest to have."""

    def read_by(self, noise: float) -> "ForceModel":
        """The same with deviations for readings of another."""

    def rest_resistances(self) -> FloatArray | None:
        """What its sensor shows with nothing on it, (rows, cols, 3) [Ω]; None if that is unknown."""

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces [N], shape (n, rows, cols, k), from pillars z, x, y [Ω], shape (n, rows, cols, 3)."""

    def deviations(self, resistance_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % and 95 % of the forces' errors, of their shape [N]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Forces:
    """Of n scans; k components as the model gives them."""

    force_n: FloatArray  #: (n, rows, cols, k)
    resistance_ohm: FloatArray  #: (n, rows, cols, 3): pillars z, x, y as the model saw them
    saturated: NDArray[np.bool_]  #: (n, rows, cols, 3): counts at 0 or full scale, which bound a resistance, no more


class ForceReader:
    """Counts of one board to the forces on its sensor.

    A model mixes the pillars of all units, so one that is saturated makes the forces of its whole scan an
    extrapolation. They are given all the same, finite, and `Forces.saturated` says so. Not for several threads at once.

    Parameters
    ----------
    info : Info
        Of the board.
    model : ForceModel
        Trained for this array; its design says what the sensor shows at rest.
    calibration : SensorCalibration, optional
        Of this very sensor; without one it is taken to be as designed.
    crosstalk : bool
        Whether counts hold the crossbar's crosstalk, to be taken out. False takes each crossing as read alone.

    Raises
    ------
    FileFormatError
        If model or calibration are of another array or design, if both know gains, or if there is a state at rest and
        the model states no design.
    """

    def __init__(
        self, info: Info, model: ForceModel, calibration: SensorCalibration | None = None, crosstalk: bool = True
    ) -> None:
        if (model.rows, model.cols) != (info.rows, info.cols):
            raise FileFormatError(
                f"the board has {info.rows} × {info.cols} units, the model {model.rows} × {model.cols}: "
                f"take a model trained for {info.rows} × {info.cols} units."
            )
        self.info, self.model = info, model
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
        self._rest_ohm = np.ones(3) if rest_ohm is None else rest_ohm
        self._unsure = (
            model  # a plain divider amplifies its converter's steps, so deviations are wider than in training
        )
        if rest_ohm is not None and model.knows_uncertainty:
            steps = float(np.median(self.crossbar.step_deviation(rest_ohm[None])))
            if steps > model.reading_noise:
                self._unsure = model.read_by(steps)

    def _require_fit(self) -> None:
        calibration, model = self.calibration, self.model
        made_for = calibration.made_from.get("design_hash")
        if made_for and model.design_hash and made_for != model.design_hash:
            raise FileFormatError(
                f"the calibration is for a sensor of design {made_for}, the model for one of {model.design_hash}: "
                "take a model of that design, or calibrate by the model's."
            )
        if model.is_fine_tuned and not calibration.is_tare_only:
            raise FileFormatError(
                "the model is fine-tuned to its sensor's pillars, and the calibration knows their gains too: give a "
                "calibration that only holds a tare, or the model before fine-tuning."
            )

    def measured(self, counts: NDArray[Any]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Resistances as the crossbar gives them (n, rows, cols, 3) [Ω] from counts (n, rows·cols·3), and which of them
        are saturated."""
        readings, saturated = self.crossbar.fractions(counts)
        return self._invert(readings), self.crossbar.as_pillars(saturated)

    def forces(self, counts: NDArray[Any]) -> Forces:
        """Forces of n scans from their counts, (n, rows·cols·3), in the order of `geometry.wiring.crossings`."""
        measured_ohm, saturated = self.measured(counts)
        resistance_ohm = self.calibration.modelled(measured_ohm, self._rest_ohm)
        return Forces(force_n=self.model.forces(resistance_ohm), resistance_ohm=resistance_ohm, saturated=saturated)

    def deviations(self, found: Forces) -> FloatArray | None:
        """Half-widths that hold 68 % of the errors of forces, of their shape [N]; None if the model knows none."""
        return self._unsure.deviations(found.resistance_ohm)[0] if self.model.knows_uncertainty else None
