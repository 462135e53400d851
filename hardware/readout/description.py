"""The sensor as a stream or a recording states it once: where its pads are, and what its numbers mean."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from geometry.layout import AXES, SONG2018, FloatArray, Layout
from geometry.layout_file import layout_text
from hardware.link.frames import Info
from hardware.readout.wrench import SIGNS, pad_positions

if TYPE_CHECKING:
    from decoupler.model.decoder import Decoder

FRAME = "tripillar"  #: name of the frame of the touched surface
NORMAL = (0.0, 0.0, 1.0)  #: out of the sensor
OF_BOARD = ("serial", "firmware", "rate_hz", "bits", "scan_mode")  #: what is said of its board
#: what is said of every sensor
COMMON: dict[str, Any] = {
    "frame": FRAME,
    "frame_meaning": (
        "origin: middle of the array on the touched surface; x along columns, y along rows, z out of the sensor"
    ),
    "sign_meaning": (
        "a force along axis k times signs[k] is a component of the vector on the sensor; fz > 0 is compression"
    ),
    "units": {"force": "N", "moment": "N mm", "length": "mm", "resistance": "ohm", "time": "s"},
    "clock": "start of the scan by the board's clock, put on the host's Unix clock; late by the link's least delay",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorDescription:
    """All of a sensor that does not change from frame to frame; places are in the frame of `COMMON`."""

    rows: int  #: units along y
    cols: int  #: units along x
    axes: tuple[str, ...]  #: the k components of each force
    position_mm: FloatArray  #: (rows, cols, 3): centres of pads, of units under touch; NaN if no design is known
    pad_mm: float  #: side of a pad; NaN if unknown
    range_n: FloatArray  #: (rows, cols, k, 2): least and largest force in the model's training
    rest_ohm: FloatArray  #: (rows, cols, P): resistances with nothing on the sensor, as the model expects them
    dead: NDArray[np.bool_]  #: (rows, cols, P): pillars that the model does not look at
    design_hash: str = ""  #: empty if the model states no design
    model_hash: str = ""  #: of what the model was made of, its training or its pairs; empty if it does not say
    board: dict[str, int | str] = field(default_factory=dict)  #: `OF_BOARD`
    layout: Layout = SONG2018  #: of a unit, whose P pillars stand in its order

    @property
    def full_scale_n(self) -> float:
        """Largest force in the model's training, at least 1 N."""
        return max(float(np.abs(self.range_n).max()), 1.0)

    def require_positions(self) -> None:
        """Refuse a sensor of which nobody knows where its pads are."""
        if np.isnan(self.position_mm).any():
            raise DesignError(
                "the model states no design, so where its pads are is unknown: train on data that state their design."
            )

    def plain(self) -> dict[str, Any]:
        """The description for JSON: numbers, text, and a list of units row by row; unknown numbers are None."""
        low_n, high_n = np.moveaxis(self.range_n, -1, 0)
        by_unit = {"position_mm": self.position_mm, "low_n": low_n, "high_n": high_n, "rest_ohm": self.rest_ohm}
        return COMMON | {
            "rows": self.rows,
            "cols": self.cols,
            "layout": layout_text(self.layout),
            "pillars": list(self.layout.pillar_names),
            "axes": list(self.axes),
            "signs": [SIGNS[AXES.index(axis)] for axis in self.axes],
            "pad_mm": plain_numbers(np.array([self.pad_mm]))[0],
            "design_hash": self.design_hash,
            "model_hash": self.model_hash,
            "board": self.board,
            "pads": [
                {"row": i, "col": j, "normal": list(NORMAL), "dead": self.dead[i, j].tolist()}
                | {name: plain_numbers(values[i, j]) for name, values in by_unit.items()}
                for i, j in np.ndindex(self.rows, self.cols)
            ],
        }


def plain_numbers(values: FloatArray) -> list[float | None]:
    """A row of numbers for JSON, to six significant digits; None in place of NaN."""
    return [float(f"{value:.6g}") if value == value else None for value in values.tolist()]


def describe(model: "Decoder", info: Info) -> SensorDescription:
    """The sensor on a board, as a model knows it."""
    axes, scaling, design = model.component.axes, model.output_scaling, model.design
    shape, places = (model.rows, model.cols, len(info.layout.pillars)), np.full((model.rows, model.cols, 3), np.nan)
    rest_ohm = model.rest_resistances()
    limits = np.stack([scaling.centre - scaling.half_range, scaling.centre + scaling.half_range], axis=-1)
    return SensorDescription(
        rows=model.rows,
        cols=model.cols,
        axes=axes,
        position_mm=places if design is None else pad_positions(design, of_units=model.moments > 0),
        pad_mm=np.nan if design is None else design.pad.size_mm,
        range_n=limits.reshape(*shape[:2], len(axes), 2),
        rest_ohm=np.full(shape, np.nan) if rest_ohm is None else rest_ohm,
        dead=model.dead,
        design_hash=model.design_hash or "",
        model_hash=str(model.made_from.get("recipe") or model.made_from.get("identified_on", "")),
        board={name: info.plain()[name] for name in OF_BOARD},
        layout=info.layout,
    )
