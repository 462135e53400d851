"""Published silicones, unfilled: what one may cast around the pillars. Each number has the page that states it.

Batches differ by tens of percent: these are to begin with, until yours is measured.
"""

import reprlib
from dataclasses import dataclass, replace
from typing import Any

from common.errors import DesignError
from geometry.design import SensorDesign

POISSON = 0.49  #: of a silicone, unless told: they keep their volume


@dataclass(frozen=True, kw_only=True)
class Silicone:
    """A rubber's small-strain modulus, Yeoh's constants where they were published, and who did."""

    young_mpa: float  #: E = 6 c₁ of laws
    stiffening: float = 0.0  #: c₂/c₁ of Yeoh's law
    source: str


SOROTOKI = "Caasenbrood, Sorotoki, src/fem/materials/samples, github.com/BJCaasenbrood/SorotokiCode"
SILICONES = {
    "dragon-skin-10": Silicone(
        young_mpa=0.216, stiffening=0.0069, source=f"c₁ = 0.036, c₂ = 0.00025 (and c₃ = 0.000023) MPa: {SOROTOKI}"
    ),
    "dragon-skin-30": Silicone(young_mpa=0.922, stiffening=0.0104, source=f"c₁ = 0.1536, c₂ = 0.0016 MPa: {SOROTOKI}"),
    "ecoflex-00-30": Silicone(young_mpa=0.0504, stiffening=0.0119, source=f"c₁ = 0.0084, c₂ = 0.0001 MPa: {SOROTOKI}"),
    "ecoflex-00-50": Silicone(young_mpa=0.087, stiffening=0.0069, source=f"c₁ = 0.0145, c₂ = 0.0001 MPa: {SOROTOKI}"),
    "elastosil-m4601": Silicone(
        young_mpa=0.72,
        source="neo-Hookean, C₁₀ = 0.12 MPa: Soft Robotics Toolkit, softroboticstoolkit.com/book/fr-modeling",
    ),
    "pdms-10-1": Silicone(
        young_mpa=2.0, source="20 MPa over the mixing ratio: Wang et al., J. Appl. Polym. Sci. 131 (2014) 41050"
    ),
    "sylgard-184-25c": Silicone(
        young_mpa=1.32, source="cured at 25 °C: Johnston et al., J. Micromech. Microeng. 24 (2014) 035017"
    ),
    "sylgard-184-200c": Silicone(
        young_mpa=2.97, source="cured at 200 °C: Johnston et al., J. Micromech. Microeng. 24 (2014) 035017"
    ),
}


def of_silicone(table: Any, model: str = "linear") -> Any:
    """The table of a material with the numbers of the published silicone that it names; any other as it is.

    A table names one by its key `silicone`; its name alone may stand for the table. `model` is that of a table that
    states none. `DesignError` if no silicone has that name, or the modulus is given, too.
    """
    if isinstance(table, str):
        table = {"silicone": table}
    if not isinstance(table, dict) or "silicone" not in table:
        return table
    name, given = table["silicone"], {key: value for key, value in table.items() if key != "silicone"}
    if not isinstance(name, str) or name not in SILICONES:
        raise DesignError(f"{reprlib.repr(name)} is no published silicone; these are {', '.join(SILICONES)}.")
    if "young_mpa" in given:
        raise DesignError(f"silicone = '{name}' has a modulus of its own: leave out young_mpa, or the name.")
    found = SILICONES[name]
    is_yeoh = given.get("model", model) == "yeoh"
    own = {"young_mpa": found.young_mpa, "poisson": POISSON}
    return own | ({"stiffening": found.stiffening} if is_yeoh else {}) | given


def surrounded(design: SensorDesign, name: str) -> SensorDesign:
    """A design whose pillars stand in a published silicone; `DesignError` if there is none of that name."""
    if name not in SILICONES:
        raise DesignError(
            f"{name} is neither a rubber file (.toml) nor a published silicone; these are {', '.join(SILICONES)}."
        )
    matrix = design.matrix_material
    numbers = of_silicone({"silicone": name, "model": matrix.model, "poisson": matrix.poisson})
    return replace(design, matrix_material=replace(matrix, **{"stiffening": 0.0} | numbers))
