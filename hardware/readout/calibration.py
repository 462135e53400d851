"""The calibration of one sensor on its board: switches and wires, gain and offset of each pillar, its state at rest.

One JSON file, of `tripillar tare` or `identify --as-designed`, holds all of it. A model made for the sensor as
designed gets (R − offset)/gain · R₀/R_rest of the crossbar's resistances R: gain and offset are those of the pillar,
R_rest was last measured with nothing on the sensor, and R₀ follows from the design.
"""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import FileFormatError
from common.storage.files import write_text
from common.storage.seal import opened_json, sealed_json
from common.storage.text_file import read_text
from dataset.imperfections import OPEN_OHM
from decoupler.readings import MIN_WHOLE_OHM
from geometry.layout import SONG2018, FloatArray, Layout
from geometry.layout_file import layout_from_text, layout_text
from hardware.link.frames import Info
from hardware.readout.crossbar import Crossbar

KIND, VERSION = "tripillar calibration", 1
BROKEN_TIMES = 20.0  #: a pillar with this many times its designed resistance is broken: it has no state at rest


@dataclass(frozen=True, kw_only=True)
class Electronics:
    """Properties of a board's crossbar that its INFO frame does not state; see `Crossbar`."""

    switch_ohm: float = Crossbar.switch_ohm
    line_ohm: float = Crossbar.line_ohm
    amplifier_gain: float = Crossbar.amplifier_gain

    def __post_init__(self) -> None:
        self.crossbar(Info())  # refuses what no crossbar has

    def crossbar(self, info: Info) -> Crossbar:
        """The crossbar of a board with these electronics."""
        return Crossbar(
            rows=info.rows,
            cols=info.cols,
            scan_mode=info.scan_mode,
            sense_ohm=float(info.sense_ohm),
            bits=info.bits,
            layout=info.layout,
            **asdict(self),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorCalibration:
    """Calibration of a sensor of rows × cols units; arrays have the shape (rows, cols, P), P pillars a unit."""

    gain: FloatArray  #: R = gain · R as designed + offset
    offset_ohm: FloatArray  #: [Ω]
    rest_ohm: FloatArray | None = None  #: (R − offset)/gain with nothing on the sensor; None: as designed [Ω]
    electronics: Electronics = field(default_factory=Electronics)
    serial: int | None = None  #: of the board it was made with; None or 0: unknown
    made_from: dict[str, Any] = field(default_factory=dict)  #: pairs, noise, when
    layout: Layout = SONG2018  #: of a unit; files that state none are of the paper's

    @classmethod
    def as_designed(cls, rows: int, cols: int, layout: Layout = SONG2018) -> "SensorCalibration":
        """The calibration of a sensor of which nothing is known."""
        shape = rows, cols, len(layout.pillars)
        return cls(gain=np.ones(shape), offset_ohm=np.zeros(shape), layout=layout)

    @property
    def is_tare_only(self) -> bool:
        """Every gain is 1 and every offset 0."""
        return bool((self.gain == 1.0).all() and (self.offset_ohm == 0.0).all())

    def tared(self, measured_ohm: FloatArray) -> "SensorCalibration":
        """The same with another state at rest: resistances (rows, cols, P) [Ω] of the crossbar, NaN where open."""
        return replace(self, rest_ohm=self.as_designed_ohm(np.where(np.isnan(measured_ohm), OPEN_OHM, measured_ohm)))

    def as_designed_ohm(self, measured_ohm: FloatArray) -> FloatArray:
        """Resistances that a sensor as designed would show, (..., rows, cols, P) [Ω]; kept above 0."""
        return np.maximum((measured_ohm - self.offset_ohm) / self.gain, MIN_WHOLE_OHM)

    def tare_factor(self, rest_as_designed_ohm: FloatArray) -> FloatArray:
        """R₀/R_rest of every pillar, (rows, cols, P), for R₀ of the same shape or (P,) [Ω]; 1 for a broken one.

        What has changed at rest is taken for a change of the rubber's resistivity: a factor.
        """
        if self.rest_ohm is None:
            return np.ones_like(self.gain)
        is_whole = self.rest_ohm < BROKEN_TIMES * rest_as_designed_ohm
        return np.where(is_whole, rest_as_designed_ohm / self.rest_ohm, 1.0)

    def require_for(self, info: Info, source: str = "the calibration") -> None:
        """Refuse a board that this was not made with."""
        rows, cols, _ = self.gain.shape
        info.require_array(source, rows, cols, self.layout, "calibrate this sensor")
        if self.serial and info.serial and self.serial != info.serial:
            raise FileFormatError(
                f"{source} was made with board {self.serial}, this is board {info.serial}: calibrate this sensor."
            )

    def to_json(self) -> str:
        """The JSON text of calibration files and of recordings."""
        plain = {name: each.tolist() if isinstance(each, np.ndarray) else each for name, each in vars(self).items()}
        plain |= {"electronics": asdict(self.electronics), "layout": layout_text(self.layout)}
        return sealed_json({"kind": KIND, "version": VERSION} | plain)

    @classmethod
    def from_json(cls, text: str, source: str = "the calibration") -> "SensorCalibration":
        """Read back what `to_json` wrote.

        Raises
        ------
        FileFormatError
            If it is no calibration, states another hash than its content's, or a number in it makes no sense.
        """
        try:
            plain = opened_json(text)
            if plain.get("kind") != KIND or plain.get("version") != VERSION:
                raise ValueError(f"kind {plain.get('kind')!r}, version {plain.get('version')!r}")
            gain, offset = (np.array(plain[name], dtype=np.float64) for name in ("gain", "offset_ohm"))
            rest = None if plain["rest_ohm"] is None else np.array(plain["rest_ohm"], dtype=np.float64)
            at_rest, layout = gain if rest is None else rest, layout_from_text(plain.get("layout", ""))
            if gain.ndim != 3 or {gain.shape, offset.shape, at_rest.shape} != {(*gain.shape[:2], len(layout.pillars))}:
                raise ValueError(f"gain of shape {gain.shape}, offset_ohm of {offset.shape}, rest of {at_rest.shape}")
            if not (np.isfinite(gain + offset).all() and (gain > 0).all() and (at_rest > 0).all()):
                raise ValueError("a gain or a resistance at rest that is not above 0, or an offset that is not finite")
            if not isinstance(plain["serial"], int | None):
                raise ValueError(f"serial {plain['serial']!r}")
            return cls(
                gain=gain,
                offset_ohm=offset,
                rest_ohm=rest,
                electronics=Electronics(**plain["electronics"]),
                serial=plain["serial"],
                made_from=plain["made_from"],
                layout=layout,
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileFormatError(
                f"{source} is no calibration ({error}): give a file made by 'tripillar tare' or 'identify'."
            ) from None


def read_calibration(path: Path) -> SensorCalibration:
    """Read a calibration file; `SensorCalibration.from_json` says what is refused."""
    text = read_text(path, "give a file made by 'tripillar tare'", FileFormatError)
    return SensorCalibration.from_json(text, source=str(path))


def write_calibration(calibration: SensorCalibration, path: Path) -> None:
    """Write a calibration file, whole or not at all."""
    write_text(calibration.to_json() + "\n", path)
