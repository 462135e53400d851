"""The sensor as solids: pillars, unit, array and matrix drawn by build123d, and written as STEP and STL.

Coordinates: a unit's frame has its origin in the unit's centre on the base plane; the array is centred on the
origin, z from 0 to h. Importing this module takes seconds, build123d's own.
"""

import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from common.storage.files import replacing_in
from geometry.design import SensorDesign, Unit
from geometry.layout import unit_centres
from geometry.prism import SIDES, unit_prisms
from geometry.surface import check_surface, surface_from_solid

if TYPE_CHECKING:
    from build123d import Compound, Shape, Solid

Point = Sequence[float]

STEP_TIME = "2000-01-01T00:00:00"  #: stamp of every STEP file, so that one design always gives the same bytes


def prism(outline: Sequence[Point], along: Point) -> "Solid":
    """A flat outline of points (x, y, z) swept along a vector, square to it or not."""
    from build123d import Face, Solid, Vector, Wire

    return Solid.extrude(Face(Wire.make_polygon([Vector(*point) for point in outline])), Vector(*along))


def box(size_x_mm: float, size_y_mm: float, bottom_mm: float, top_mm: float) -> "Solid":
    """A box centred on the z axis."""
    from build123d import Location, Solid

    corner = Location((-size_x_mm / 2, -size_y_mm / 2, bottom_mm))
    return Solid.make_box(size_x_mm, size_y_mm, top_mm - bottom_mm).moved(corner)


def at_units(solid: "Solid", design: SensorDesign) -> list["Solid"]:
    """Copies of a solid drawn in the unit's frame, one at every unit of the array."""
    from build123d import Location

    return [solid.moved(Location((x, y, 0.0))) for x, y in unit_centres(design)]


def pillar_solids(unit: Unit, sides: int = SIDES) -> list["Solid"]:
    """The pillars in the unit's frame, each ending flush with z = 0 and z = h.

    The section is width × width perpendicular to the axis, or a circle of that diameter, drawn as a polygon: a
    horizontal cut is width × width·l/h, longer along the tilt. That swept along the axis is the whole pillar, and
    V = S·l exactly.

    >>> [round(pillar.volume, 6) for pillar in pillar_solids(Unit())]
    [40.0, 56.568542, 56.568542]
    """
    prisms = [(one.corners(sides), one.axis_mm) for one in unit_prisms(unit)]
    return [prism(corners[: len(corners) // 2].tolist(), axis.tolist()) for corners, axis in prisms]


def unit_solid(unit: Unit, sides: int = SIDES) -> "Solid":
    """The conductive body of one unit, in its own frame: its pillars, grown together at common electrodes."""
    first, *others = pillar_solids(unit, sides)
    return first.fuse(*others)


def array_solid(design: SensorDesign, sides: int = SIDES) -> "Compound":
    """The conductive bodies of all units, k = i·cols + j; they do not touch, whatever the pitch."""
    from build123d import Compound

    unit = unit_solid(design.unit, sides)
    unit.label = "unit"
    return Compound(children=at_units(unit, design), label="array")


def slab_solid(design: SensorDesign) -> "Solid":
    """Pillars and matrix together, as one block."""
    x, y, h = design.slab_mm
    return box(x, y, 0.0, h)


def matrix_solid(design: SensorDesign) -> "Solid":
    """The insulating rubber: the slab without the pillars."""
    return slab_solid(design).cut(*at_units(unit_solid(design.unit), design))


def sensor_solids(design: SensorDesign) -> dict[str, "Shape"]:
    """Everything that makes up the sensor, by the name of its files."""
    pillars = zip(design.unit.layout.body.pillar_names, pillar_solids(design.unit), strict=True)
    return {f"pillar_{name}": pillar for name, pillar in pillars} | {
        "unit": unit_solid(design.unit),
        "array": array_solid(design),
        "slab": slab_solid(design),
        "matrix": matrix_solid(design),
    }


def write_solids(solids: Mapping[str, "Shape"], folder: Path) -> list[Path]:
    """Write ``NAME.step``, the master, and ``NAME.stl`` of every solid; the same solids give the same bytes.

    Every surface is checked before any file is written: `GeometryError`.
    """
    surfaces = {name: surface_from_solid(solid) for name, solid in solids.items()}
    for name, surface in surfaces.items():
        check_surface(surface, solids[name].volume, name)
    with replacing_in(folder) as temporary:
        for name, solid in solids.items():
            _write_step(solid, name, temporary / f"{name}.step")
            surfaces[name].export(temporary / f"{name}.stl")
    return [folder / f"{name}.{kind}" for name in solids for kind in ("step", "stl")]


def _write_step(solid: "Shape", name: str, path: Path) -> None:
    from build123d import export_step

    solid.label = name
    step = BytesIO()  # the CAD kernel does not say when a disk is full
    export_step(solid, step, timestamp=STEP_TIME)
    path.write_bytes(_with_own_numbering(step.getvalue().decode()).encode())


def _with_own_numbering(step: str) -> str:
    """Count the parts of an assembly from 1: the CAD kernel counts on from one file to the next."""
    head, *uses = re.split(r"(?<=NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+", step)
    return head + "".join(f"{number}{use}" for number, use in enumerate(uses, start=1))
