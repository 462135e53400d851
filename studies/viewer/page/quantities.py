"""What the pillars of the page can be coloured by."""

from dataclasses import dataclass

import numpy as np

from geometry.layout import FloatArray

STEPS = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0])  #: ends of the colour bar, times a power of ten


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A field on the pillars."""

    title: str
    unit: str
    colours: str  #: colour map, as matplotlib names it
    signed: bool  #: whether the colour bar goes from −most to +most
    least: float  #: end of the colour bar where nothing is loaded

    def range_of(self, values: FloatArray) -> tuple[float, float]:
        """Ends of the colour bar, round numbers that hold all values."""
        most = max(float(np.abs(values).max(initial=0.0)), self.least)
        power = 10.0 ** np.floor(np.log10(most))
        end = float(power * STEPS[np.searchsorted(STEPS * power, most * (1 - 1e-9))])
        return (-end, end) if self.signed else (0.0, end)


QUANTITIES = {
    "displacement": Quantity(title="displacement", unit="mm", colours="viridis", signed=False, least=0.1),
    "vertical": Quantity(title="vertical displacement", unit="mm", colours="coolwarm_r", signed=True, least=0.1),
    "von-mises": Quantity(title="von Mises stress", unit="MPa", colours="inferno", signed=False, least=0.1),
    "pressure": Quantity(title="pressure", unit="MPa", colours="coolwarm", signed=True, least=0.1),
    "resistance": Quantity(title="change of resistance", unit="%", colours="coolwarm_r", signed=True, least=1.0),
}

