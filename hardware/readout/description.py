"""The sensor as a stream or a recording states it once: where its pads are, and what its numbers mean."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.layout import AXES, PILLARS, FloatArray, unit_centres
from hardware.link.frames import Info
from hardware.readout.wrench import SIGNS, pad_positions
from hardware.recording.topics import plain_numbers

if TYPE_CHECKING:
    from decoupler.touch.touch_file import AnyDecoder

FRAME = "tripillar"  #: name of the frame of the touched surface
UNITS = {"force": "N", "moment": "N mm", "length": "mm", "resistance": "ohm", "time": "s"}
MEANING = "origin: middle of the array on the touched surface; x along columns, y along rows, z out of the sensor"
SIGN_MEANING = "a force along axis k times signs[k] is a component of the vector on the sensor; fz > 0 is compression"
CLOCK = "start of the scan by the board's clock, put on the host's Unix clock; late by the link's least delay"


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorDescription:
    """All of a sensor that does not change from frame to frame; places are in the frame of `MEANING`."""

    rows: int  #: units along y
    cols: int  #: units along x
    axes: tuple[str, ...]  #: the k components of each force
    signs: tuple[float, ...]  #: (k,): times a force, the component of the vector on the sensor
    position_mm: FloatArray  #: (rows, cols, 3): centres of pads, of units under touch; NaN if no design is known
    normal: FloatArray  #: (rows, cols, 3): unit vectors out of the sensor
    pad_mm: float  #: side of a pad; NaN if unknown
    range_n: FloatArray  #: (rows, cols, k, 2): least and largest force in the model's training
    rest_ohm: FloatArray  #: (rows, cols, 3): resistances with nothing on the sensor, as the model expects them
    dead: NDArray[np.bool_]  #: (rows, cols, 3): pillars that the model does not look at
    twin_deviation: FloatArray | None  #: (rows, cols, 3): of gain and offset of an identified twin, over R at rest
    design_hash: str = ""  #: empty if the model states no design
    model_hash: str = ""  #: of what the model was made of, its training or its pairs; empty if it does not say
    board: dict[str, int | str] = field(default_factory=dict)  #: serial, firmware, rate_hz, bits, scan_mode

    @property
    def position_m(self) -> FloatArray:
        """Centres of the pads [m]."""
        return 1e-3 * self.position_mm

    def require_positions(self) -> None:
        """Refuse a sensor of which nobody knows where its pads are."""
        if np.isnan(self.position_mm).any():
            raise DesignError(
                "the model states no design, so where its pads are is unknown: train on data that state their design."
            )

    def plain(self) -> dict[str, Any]:
        """The description for JSON: numbers, text, and a list of units row by row; unknown numbers are None."""
        pads = [
            {
                "row": i,
                "col": j,
                "position_mm": plain_numbers(self.position_mm[i, j]),
                "normal": plain_numbers(self.normal[i, j]),
                "low_n": plain_numbers(self.range_n[i, j, :, 0]),
                "high_n": plain_numbers(self.range_n[i, j, :, 1]),
                "rest_ohm": plain_numbers(self.rest_ohm[i, j]),
                "dead": self.dead[i, j].tolist(),
                "twin_deviation": [] if self.twin_deviation is None else plain_numbers(self.twin_deviation[i, j]),
            }
            for i, j in np.ndindex(self.rows, self.cols)
        ]
        return {
            "frame": FRAME,
            "frame_meaning": MEANING,
            "rows": self.rows,
            "cols": self.cols,
            "axes": list(self.axes),
            "signs": list(self.signs),
            "sign_meaning": SIGN_MEANING,
            "pillars": list(PILLARS),
            "units": UNITS,
            "clock": CLOCK,
            "pad_mm": plain_numbers(np.array([self.pad_mm]))[0],
            "design_hash": self.design_hash,
            "model_hash": self.model_hash,
            "board": self.board,
            "pads": pads,
        }


def describe(model: "AnyDecoder", info: Info) -> SensorDescription:
    """The sensor on a board, as a model knows it."""
    rows, cols, axes, pillars = model.rows, model.cols, model.component.axes, model.component.pillars
    shape, unknown = (rows, cols, len(PILLARS)), np.full((rows, cols, len(PILLARS)), np.nan)
    scaling, rest_ohm = model.output_scaling, model.rest_resistances()
    limits = np.stack([scaling.centre - scaling.half_range, scaling.centre + scaling.half_range], axis=-1)
    rest_ohm = unknown if rest_ohm is None else rest_ohm
    deviation = None
    if model.ensemble is not None:
        deviation, read = unknown.copy(), [PILLARS.index(pillar) for pillar in pillars]
        drawn = model.ensemble.resistance + model.ensemble.offset_ohm / rest_ohm[..., read].reshape(-1)
        deviation[..., read] = np.sqrt((drawn**2).mean(axis=0)).reshape(rows, cols, -1)
    return SensorDescription(
        rows=rows,
        cols=cols,
        axes=axes,
        signs=tuple(SIGNS[AXES.index(axis)] for axis in axes),
        position_mm=unknown if model.design is None else _places(model.design, model.knows_touch),
        normal=np.broadcast_to([0.0, 0.0, 1.0], shape),
        pad_mm=np.nan if model.design is None else model.design.pad.size_mm,
        range_n=limits.reshape(rows, cols, len(axes), 2),
        rest_ohm=rest_ohm,
        dead=np.zeros(shape, dtype=bool) if model.dead is None else model.dead,
        twin_deviation=deviation,
        design_hash=model.design_hash or "",
        model_hash=str(model.made_from.get("recipe") or model.made_from.get("identified_on", "")),
        board={
            "serial": info.serial,
            "firmware": ".".join(map(str, info.firmware)),
            "rate_hz": info.rate_hz,
            "bits": info.bits,
            "scan_mode": info.scan_mode.name,
        },
    )


def _places(design: SensorDesign, of_units: bool) -> FloatArray:
    if not of_units:
        return pad_positions(design)
    x, y = unit_centres(design).T
    return np.stack([x, y, 0.0 * x], axis=1).reshape(design.array.rows, design.array.cols, 3)
