"""Settings of a dataset: what loads the sensor, within which ranges, and how it is read."""

from dataclasses import MISSING, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from common.errors import DesignError
from common.quantity import quantity
from common.storage.files import digest
from dataset.imperfections import SEEDS, Imperfections
from dataset.loads import CAP, PAPERS, Loads, Range, loads_of
from dataset.protocols import INDENT, LIGHT_N, SUMMARIES, TABLE, Listed, Protocol, listed, pad_protocol
from geometry.design import SensorDesign
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

BLOCK = 512  #: samples drawn with one generator; a block's arrays fit the processor's cache
MAX_MPA = 100.0  #: of loads
MAX_MOMENTS = 1_000_000  #: of a history
MAX_SAMPLES = 1_000_000_000  #: of 36 units: 700 GB of forces and resistances in float32, compressed


@dataclass(frozen=True, kw_only=True)
class DatasetSettings(Imperfections):
    """Settings of a dataset: its loads, and the sensor that measures them."""

    protocol: str = quantity(MISSING, "kind of loads", of=tuple(SUMMARIES))
    samples: int = quantity(MISSING, "number of samples", within=(1, MAX_SAMPLES))
    seed: int = quantity(0, "seed of the random loads and noise", within=SEEDS)
    cap: float = quantity(
        CAP, "largest strain of a pillar; loads past it are drawn again", above_0=True, within=(0, 1), below=True
    )
    pressure_mpa: Range | None = quantity(
        None,
        "least and largest pressure on a pad [MPa]; default: 1 5, the paper's, or what the design bears",
        True,
        within=(0, MAX_MPA),
        count=2,
    )
    shear_mpa: Range | None = quantity(
        None,
        "least and largest shear [MPa], 0 and the largest within a friction cone; default: a fifth of the pressure",
        True,
        within=(0, MAX_MPA),
        count=2,
    )
    table_mpa: Listed | None = quantity(None, "tractions on the pads of each load of a table [MPa]", True)
    history_s: float = quantity(
        0.0,
        "seconds of a series of presses, holds, ramps and touches that each sample becomes; 0: samples without a time",
        True,
        within=(0, 1e6),
    )
    rate_hz: float = quantity(50.0, "moments of a series a second [Hz]", True, above_0=True, within=(1e-6, 1e4))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.moments is not None and not 2 <= self.moments <= MAX_MOMENTS:
            raise DesignError(
                f"history_s={self.history_s:g} at rate_hz={self.rate_hz:g} are {self.moments} moments: 2 to "
                f"{MAX_MOMENTS} are allowed; change one of the two."
            )
        if self.moments is not None and self.protocol == INDENT:
            raise DesignError(f"history_s={self.history_s:g} takes loads on pads, protocol '{INDENT}' has none.")
        if (self.protocol == TABLE) != bool(self.table_mpa):
            raise DesignError(f"protocol='{self.protocol}': '{TABLE}' takes its loads from a table, and it alone does.")
        for name, axis in (("pressure_mpa", "z"), ("shear_mpa", "x")):
            if (given := getattr(self, name)) is not None:
                self._require_range(name, given, axis)

    def _require_range(self, name: str, given: Range, axis: str) -> None:
        """Refuse a range that is none, or that the protocol does not take."""
        said = f"{name}={given[0]:g} {given[1]:g}"
        if self.protocol in (INDENT, TABLE) or axis not in self.on_pads.axes:
            raise DesignError(f"{said}: protocol '{self.protocol}' has no such loads on pads: leave it out.")
        if not 0 < given[1] >= given[0]:
            raise DesignError(f"{said} must be the least and the largest, above 0: write them in this order.")
        protocol = self.on_pads
        if given[0] > 0 and (protocol.is_light or (axis == "x" and "z" in protocol.axes)):
            why = "its touches begin at nothing" if protocol.is_light else "its shear lies within a friction cone"
            raise DesignError(f"{said}: protocol '{self.protocol}' takes 0 as the least, {why}: write 0 {given[1]:g}.")

    @property
    def on_pads(self) -> Protocol:
        """The protocol that loads pads; a `DesignError` if it does not."""
        return pad_protocol(self.protocol) if self.table_mpa is None else listed(self.table_mpa)

    def as_attributes(self) -> dict[str, Any]:
        """As of `Imperfections`; of a table's loads, which the samples hold, a hash."""
        found = super().as_attributes()
        table = found.pop("table_mpa", None)
        return found if table is None else found | {"table_hash": digest(table)}

    @property
    def loads(self) -> Loads:
        """Ranges of the loads on pads."""
        return Loads.of(self.pressure_mpa, self.shear_mpa)

    def suited(self, response: "ArrayResponse") -> "DatasetSettings":
        """The same with a design's own range of loads, where none is given and it does not bear the paper's."""
        if self.protocol in (INDENT, TABLE):
            return self
        protocol, of_pressure = self.on_pads, "z" in self.on_pads.axes
        name = "pressure_mpa" if of_pressure else "shear_mpa"
        if getattr(self, name) is not None or (own := loads_of(response, self.cap)) == PAPERS:
            return self
        low, high = own.normal_mpa if of_pressure or protocol.is_light else own.tangential_mpa
        if protocol.is_light and high * response.design.pad.size_mm**2 >= LIGHT_N:
            return self
        found: dict[str, Any] = {name: (0.0 if protocol.is_light else low, high)}
        return replace(self, **found)

    @property
    def moments(self) -> int | None:
        """Number of moments of a history; None without one."""
        return round(self.history_s * self.rate_hz) if self.history_s else None

    @property
    def time_s(self) -> FloatArray | None:
        """Times of a history's moments (t,) [s]; None without one."""
        return None if self.moments is None else np.arange(self.moments) / self.rate_hz

    @property
    def block(self) -> int:
        """Samples drawn with one generator; a series has its own."""
        return BLOCK if self.moments is None else 1

    def loads_said(self, design: SensorDesign) -> str:
        """The ranges of the loads on pads in words; those that the protocol has no say in are left out."""
        return "" if self.protocol in (INDENT, TABLE) else self.loads.said(design, self.on_pads.axes)

    def summary(self, design: SensorDesign) -> str:
        """One line for people about the loads."""
        return SUMMARIES[INDENT] if self.protocol == INDENT else self.on_pads.said(self.loads, design)
