"""The mould's volumes in closed form, and that its parts fit, fill and open."""

import numpy as np
import pytest
from build123d import Location

from geometry import DesignError
from geometry.cad import array_solid, unit_solid
from geometry.layout import unit_centres, upper_electrodes
from geometry.mould import Mould, mould_solids, write_cad
from tests.geometry.closed_forms import oblique_width

MOULD = Mould(wall_mm=4.0, plate_mm=2.5, clearance_mm=0.2)
EXACT = 1e-9  # rounding of the CAD kernel's integrals


def overlap_mm3(a, b) -> float:
    common = a & b
    return sum(solid.volume for solid in common.solids()) if common else 0.0


def rim_area(design) -> float:
    x, y, _ = design.slab_mm
    return (x + 2 * MOULD.wall_mm) * (y + 2 * MOULD.wall_mm)


def test_volumes_follow_their_closed_forms(design):
    unit, n, c, t = design.unit, design.n_units, MOULD.clearance_mm, MOULD.plate_mm
    s, h, w, ow = unit.span_mm, unit.height_mm, unit.pillar_width_mm, oblique_width(unit)
    parts = mould_solids(design, MOULD)

    def wedges(c: float) -> float:
        """Right-angled prisms: legs s − c along x, s − (w + ow)/2 along y, both as steep as the pillars."""
        return (w - 2 * c) * ((s - c) ** 2 + (s - (w + ow) / 2) ** 2) * h / (2 * s)

    expected = {
        "mould_tray": rim_area(design) * (h + t) - np.prod(design.slab_mm),
        "mould_pillars": rim_area(design) * (h + t) - n * (unit_solid(unit).volume + wedges(0.0)),
        "mould_lid": rim_area(design) * t - n * (2 * w**2 + ((s - w) / 2) ** 2) * t + n * wedges(c),
    }
    assert {name: part.volume for name, part in parts.items()} == pytest.approx(expected, rel=EXACT)
    assert all(part.is_valid and len(part.solids()) == 1 for part in parts.values())


def test_lid_lifts_straight_off(small_design):
    parts, units = mould_solids(small_design, MOULD), array_solid(small_design)
    for lift_mm in (0.0, 0.5, 3.0, 9.0):
        lid = parts["mould_lid"].moved(Location((0, 0, lift_mm)))
        assert overlap_mm3(lid, parts["mould_pillars"]) == pytest.approx(0.0, abs=EXACT)
        assert sum(overlap_mm3(lid, unit) for unit in units.solids()) == pytest.approx(0.0, abs=EXACT)
    assert overlap_mm3(parts["mould_lid"], parts["mould_tray"]) == pytest.approx(0.0, abs=EXACT)


def test_lid_is_open_over_upper_electrodes_and_at_the_centre_of_every_unit(design):
    lid_top = max(mould_solids(design, MOULD)["mould_lid"].faces(), key=lambda face: face.center().Z)
    boxes = [wire.bounding_box(optimal=True) for wire in lid_top.inner_wires()]
    openings = [(b.center().X, b.center().Y, b.size.X, b.size.Y) for b in boxes]
    w, room = design.unit.pillar_width_mm, design.unit.span_mm - design.unit.pillar_width_mm
    vents = [(*(centre + top[:2]), w, w) for centre in unit_centres(design) for top in upper_electrodes(design.unit)]
    windows = [(*centre, room / 2, room / 2) for centre in unit_centres(design)]
    found, expected = (sorted(np.round(o, 6).tolist()) for o in (openings, vents + windows))
    assert found == expected


def test_units_lift_out_but_for_the_heel_of_the_y_pillar(small_design):
    """The heel is a prism of width w, as far out as the oblique pillar is wider than z, and as steep."""
    unit = small_design.unit
    depth = (oblique_width(unit) - unit.pillar_width_mm) / 2
    heel = unit.pillar_width_mm * depth**2 * unit.height_mm / (2 * unit.span_mm)
    pillar_mould = mould_solids(small_design, MOULD)["mould_pillars"]
    for lift_mm in (1.0, 4.0, 8.0):
        for lifted in array_solid(small_design).moved(Location((0, 0, lift_mm))).solids():
            assert overlap_mm3(lifted, pillar_mould) == pytest.approx(heel, rel=1e-6)


def test_clearance_that_leaves_no_wedge_is_refused(small_design):
    with pytest.raises(DesignError, match=r"clearance_mm=1 leaves no wedges .* pillar_width_mm, 1;"):
        mould_solids(small_design, Mould(clearance_mm=1.0))


def test_everything_is_written_as_step_and_stl(small_design, tmp_path):
    mould = ("mould_tray", "mould_pillars", "mould_lid")
    parts = ["pillar_z", "pillar_x", "pillar_y", "unit", "array", "slab", "matrix", *mould]
    written = write_cad(small_design, tmp_path / "cad", MOULD)
    assert [path.name for path in written] == [f"{part}.{kind}" for part in parts for kind in ("step", "stl")]
    assert {path.name for path in (tmp_path / "cad").iterdir()} == {path.name for path in written}
    assert all(path.stat().st_size > 0 for path in written)
