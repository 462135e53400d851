"""The casting mould: three printed parts in which a sensor is made from conductive and insulating rubber.

The paper gives no drawing. Here (steps: docs/sensor.md) conductive rubber is cured in the troughs of ``mould_pillars``
under the wedges of ``mould_lid``; the rubber in the lid's vents then holds every unit in its place in ``mould_tray``,
which is filled with silicone. It opens, as every vertical line meets a unit in a single piece: oblique pillars are no
undercut for a lid that is lifted straight up. The one exception is the heel of a pillar that leans from an upright
one's foot, which juts out by (oblique width − width)/2 under the wall of its trough: 0.41 mm, past which rubber bends.
The upper half of a round oblique pillar is shaped by the wedge, the lower one by the trough.

Parts are drawn closed, in the sensor's coordinates; print the lid upside down. None has been printed yet.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.errors import DesignError
from common.quantity import Sound, positive, quantity
from common.storage.files import require_folder
from geometry.cad import at_units, box, pillar_solids, prism, sensor_solids, unit_solid, write_solids
from geometry.design import SensorDesign, Unit
from geometry.layout import pillar_ends, pillar_sections, pillar_widths, upper_electrodes
from geometry.prism import unit_prisms

if TYPE_CHECKING:
    from build123d import Solid


@dataclass(frozen=True, kw_only=True)
class Mould(Sound):
    """Settings for printing the mould's parts. Lengths in mm."""

    wall_mm: float = positive(5.0, "width of the rim around the slab, on every part")
    plate_mm: float = positive(3.0, "thickness of the lid and of the floors")
    clearance_mm: float = quantity(0.15, "gap between a wedge of the lid and each wall of its trough", within=(0, 10))


def mould_solids(design: SensorDesign, mould: Mould) -> dict[str, "Solid"]:
    """The mould's parts, by the name of their files; `DesignError` if the clearance leaves no wedges.

    The lid has wedges below and, for every unit, a vent over each upper electrode and a window, centred and half as
    wide as the room beside the pillars, so that it meets no wedge.
    """
    from build123d import Location

    unit, plate_mm, rim_mm = design.unit.body, mould.plate_mm, 2 * mould.wall_mm
    widths = pillar_widths(unit)
    if mould.clearance_mm >= min(widths) / 2:
        raise DesignError(
            f"clearance_mm={mould.clearance_mm:g} leaves no wedges on the lid: it must be below half of "
            f"pillar_width_mm, {min(widths) / 2:g}; 0.1 to 0.2 suits most printers."
        )
    (x, y, h), room_mm = design.slab_mm, _room_mm(unit)
    below, above = box(x + rim_mm, y + rim_mm, -plate_mm, h), box(x + rim_mm, y + rim_mm, h, h + plate_mm)
    trough = unit_solid(unit).fuse(*_wedges(unit, clearance_mm=0.0))
    openings = [box(room_mm / 2, room_mm / 2, h, h + plate_mm)] if room_mm > 0 else []
    for top, (at_x, at_y, _) in enumerate(upper_electrodes(unit)):
        w = max(width for width, at in zip(widths, unit.layout.pillar_top, strict=True) if at == top)
        openings.append(box(w, w, h, h + plate_mm).moved(Location((at_x, at_y, 0.0))))
    lid = above.cut(*(hole for part in openings for hole in at_units(part, design)))
    wedges = [wedge for part in _wedges(unit, mould.clearance_mm) for wedge in at_units(part, design)]
    return {
        "mould_tray": below.cut(box(x, y, 0.0, h)),
        "mould_pillars": below.cut(*at_units(trough, design)),
        "mould_lid": lid.fuse(*wedges),
    }


def write_cad(design: SensorDesign, folder: Path, mould: Mould | None = None) -> list[Path]:
    """Write STEP and STL of the sensor's parts and of the mould to cast it in; see `cad.write_solids`."""
    require_folder(folder)
    parts = mould_solids(design, mould or Mould())  # refuses pillars that are too thin to be drawn, too
    return write_solids(sensor_solids(design) | parts, folder)


def _room_mm(unit: Unit) -> float:
    """Side of the largest centred square that has no pillar in or below it [mm]."""
    beside = np.abs(pillar_ends(unit)[..., :2]) - pillar_sections(unit)[:, None] / 2
    opposite = (np.diff(np.sign(pillar_ends(unit)[..., :2]), axis=1) != 0)[:, 0]
    return 2 * float(np.where(opposite, 0.0, beside.min(axis=1)).max(axis=1).min())


def _wedges(unit: Unit, clearance_mm: float) -> list["Solid"]:
    """The space above each oblique pillar up to z = h, beside an upright one at its foot: right-angled prisms.

    `clearance_mm` comes off the faces that slide along a trough's walls, not off those that shape rubber.
    """
    h = unit.height_mm
    wedges: list[Solid] = []
    pillars = list(zip(unit.layout.pillars, unit_prisms(unit), pillar_widths(unit), strict=True))
    upright_at = {pillar.foot: (pillar.section, width) for pillar, straight, width in pillars if straight.is_upright}
    for pillar, straight, width in pillars:
        if straight.is_upright:
            continue
        s, foot = float(np.linalg.norm(straight.axis_mm[:2])), upright_at.get(pillar.foot)
        along = straight.axis_mm[:2] / s
        b = float(np.abs(straight.turn @ along) @ straight.section_mm) / 2  # along x, along y or turned: one extent
        sideways = straight.turn[int(abs(straight.turn[0] @ along) > 0)]
        side = float(np.abs(straight.turn @ sideways) @ straight.section_mm) / 2 - clearance_mm
        # corners (distance from the foot's middle, z): a square pillar's upper face rises from (-b, 0) to (s - b, h)
        start = clearance_mm - b if foot is None else foot[1] / 2
        corners = [(start, h), (s - b, h), (start, h * (start + b) / s)]
        is_flat = straight.is_rectangular and foot in (None, ("square", width))
        if not is_flat:  # from the middle of a round pillar, or of an upright one of another section, up
            start = clearance_mm - b if foot is None else 0.0
            low = (0.0, 0.0) if pillar.is_round else (start, h * (start + b) / s)
            corners = [
                (start, h),
                (s if pillar.is_round else s - b, h),
                low,
                *([(start, 0.0)] if start < low[0] else []),
            ]
        outline = np.array([[*(x * along - side * sideways), z] for x, z in corners])
        wedge = prism((outline + straight.base_mm).tolist(), [*(2 * side * sideways), 0.0])
        wedges += [wedge] if is_flat else wedge.cut(*pillar_solids(unit)).solids()
    return wedges
