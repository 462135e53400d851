"""The sensor's shape: from a design file to tetrahedra.

In: a design TOML (`read_design`). Out: CAD solids as STEP and STL, checked surfaces, and a cached tetrahedral
mesh with region labels. Open `design.py` first, then `layout.py` (where everything is), `cad.py`,
`surface.py` and `mesh.py`. The names below load no CAD and no mesher; import those modules where needed.
"""

from geometry.design import Array, Material, Pad, SensorDesign, Unit
from geometry.design_file import design_from_toml, design_to_toml, read_design, write_design
from geometry.errors import DesignError, FileFormatError, GeometryError, TriPillarError

__all__ = [
    "Array",
    "DesignError",
    "FileFormatError",
    "GeometryError",
    "Material",
    "Pad",
    "SensorDesign",
    "TriPillarError",
    "Unit",
    "design_from_toml",
    "design_to_toml",
    "read_design",
    "write_design",
]
