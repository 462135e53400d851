"""Published silicones, unfilled: what one may cast around the pillars. Each number has the page that states it.

Batches differ by tens of percent: these are to begin with, until yours is measured.
"""

from dataclasses import dataclass, replace

from common.errors import DesignError
from geometry.design import SensorDesign


@dataclass(frozen=True, kw_only=True)
class Silicone:
    """A rubber's small-strain modulus, Yeoh's constants where they were published, and who did."""

    young_mpa: float  #: E = 6 c₁ of laws
    stiffening: float = 0.0  #: c₂/c₁ of Yeoh's law
    source: str


SOROTOKI = "Caasenbrood, Sorotoki, src/fem/materials/samples, github.com/BJCaasenbrood/SorotokiCode"
SILICONES = {
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


def surrounded(design: SensorDesign, name: str) -> SensorDesign:
    """A design whose pillars stand in a published silicone; `DesignError` if there is none of that name."""
    if name not in SILICONES:
        raise DesignError(
            f"{name} is neither a rubber file (.toml) nor a published silicone; these are {', '.join(SILICONES)}."
        )
    silicone = SILICONES[name]
    is_yeoh = design.matrix_material.model == "yeoh"
    matrix = replace(
        design.matrix_material, young_mpa=silicone.young_mpa, stiffening=silicone.stiffening if is_yeoh else 0.0
    )
    return replace(design, matrix_material=matrix)
