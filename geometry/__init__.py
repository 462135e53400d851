"""The sensor's shape: from a design file to tetrahedra.

In: a design TOML (`read_design`). Out: CAD solids as STEP and STL, checked surfaces, and tetrahedra with region
labels. In the order of the data: `design.py` (the numbers), `design_file.py` (their TOML),
`layout.py` (places of electrodes, pillars and pads), `wiring.py` (crossings of the wires), `prism.py` (slab and pillars
as prisms), `cad.py` and `mould.py` (solids), `surface.py` (checked triangles), `mesh.py` (tetrahedra). The names below
load no CAD and no mesher.
"""

from common.errors import DesignError, FileFormatError, GeometryError, TriPillarError
from geometry.design import Array, Electrics, Material, Pad, SensorDesign, Unit
from geometry.design_file import design_from_toml, design_to_toml, read_design, write_design

__all__ = [
    "Array",
    "DesignError",
    "Electrics",
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
