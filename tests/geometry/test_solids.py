"""Solids of sensor and mould against closed forms, their checked surfaces, and the files they are written to."""

from itertools import combinations

import numpy as np
import pytest
import trimesh
from trimesh import Trimesh

from geometry import Array, DesignError, GeometryError, SensorDesign, Unit
from geometry.cad import (
    STEP_TIME,
    array_solid,
    box,
    matrix_solid,
    pillar_solids,
    sensor_solids,
    slab_solid,
    unit_solid,
    write_solids,
)
from geometry.castability import castability
from geometry.layout import (
    LAYOUTS,
    SECTIONS,
    leans_both_ways,
    pillar_ends,
    pillar_volumes,
    unit_centres,
    upper_electrodes,
)
from geometry.mould import Mould, mould_solids, write_cad
from geometry.shares import pillar_shares
from geometry.surface import check_surface, surface_from_solid
from tests.fem.scenes import DIAGONAL, HEXAGON, of_section, round_of
from tests.geometry.closed_forms import oblique_width, union_mm3

UNIT = SensorDesign().unit
MOULD = Mould(wall_mm=4.0, plate_mm=2.5, clearance_mm=0.2)
EXACT = 1e-9  # rounding of the CAD kernel's integrals; every form below is exact


def bounds(solid) -> np.ndarray:
    box = solid.bounding_box(optimal=True)
    return np.array([tuple(box.min), tuple(box.max)])


def test_a_unit_is_one_body_of_its_closed_form_that_spans_its_footprint(design):
    """The same by shares of boxes, whose lines lie 1/200 of the footprint apart: within 0.2 %."""
    from build123d import CenterOf

    solid, unit = unit_solid(design.unit), design.unit
    assert solid.volume == pytest.approx(union_mm3(unit), rel=EXACT)
    pillars = pillar_solids(unit)
    assert [pillar.volume for pillar in pillars] == pytest.approx(pillar_volumes(unit), rel=EXACT)
    centres = [tuple(pillar.center(CenterOf.MASS)) for pillar in pillars]
    assert np.array(centres) == pytest.approx(pillar_ends(unit).mean(axis=1), abs=EXACT)
    lines = np.linspace(-0.51, 0.51, 201) * unit.footprint_mm, np.linspace(0.0, unit.height_mm, 41)
    boxes = np.diff(lines[0])[0] ** 2 * np.diff(lines[1])[0]
    assert pillar_shares(unit, lines[0], lines[0], lines[1]).sum() * boxes == pytest.approx(union_mm3(unit), rel=2e-3)
    assert solid.is_valid
    assert len(solid.solids()) == 1
    end = (unit.span_mm + oblique_width(unit)) / 2
    assert bounds(solid) == pytest.approx(np.array([[-end, -end, 0], [end, end, unit.height_mm]]), abs=1e-6)


def test_an_array_is_a_unit_at_every_centre_and_the_matrix_is_the_slab_without_it(design):
    """Surfaces enclose the same. Euler: V − F/2 is 2 a body and 2 less a tunnel; a unit, open at four ends, bores 3."""
    whole, array, matrix = unit_solid(design.unit), array_solid(design), matrix_solid(design)
    first, *others = array.solids()
    for unit, centre in zip((first, *others), unit_centres(design), strict=True):
        assert unit.volume == pytest.approx(whole.volume, rel=EXACT)
        assert bounds(unit) == pytest.approx(bounds(whole) + np.append(centre, 0.0), abs=1e-6)
    assert all(first.distance_to(other) > 0.1 for other in others)
    assert bounds(matrix) == pytest.approx(bounds(slab_solid(design)), abs=1e-6)
    assert matrix.is_valid
    assert len(matrix.solids()) == 1
    assert matrix.volume == pytest.approx(np.prod(design.slab_mm) - design.n_units * whole.volume, rel=EXACT)
    assert all(face.geom_type.name == "PLANE" for face in matrix.faces())
    for solid, euler in ((array, 2 * design.n_units), (matrix, 2 - 2 * 3 * design.n_units)):
        surface = surface_from_solid(solid)
        check_surface(surface, solid.volume, "body")
        assert surface.volume == pytest.approx(solid.volume, rel=1e-12)  # flat faces: exact but for rounding
        assert len(surface.vertices) - len(surface.faces) / 2 == euler


@pytest.mark.parametrize(
    ("damaged", "says"),
    [
        (lambda vertices, triangles: (vertices, triangles[1:]), "'unit' is not watertight: 3 of 66 edges"),
        (lambda vertices, triangles: (vertices, triangles[:, ::-1]), r"faces inward \(volume -141.823 mm³\)"),
        # a volume three times as far off as is allowed
        (lambda vertices, triangles: (1.000001 * vertices, triangles), r"encloses .* mm³, its solid 141.823376 mm³"),
        (lambda vertices, triangles: (np.nan * vertices, triangles), r"encloses .* mm³, its solid 141.823376 mm³"),
    ],
)
def test_damaged_surfaces_are_refused_and_nothing_is_written(damaged, says, tmp_path):
    unit = unit_solid(UNIT)
    whole = surface_from_solid(unit)
    with pytest.raises(GeometryError, match=says):
        check_surface(Trimesh(*damaged(whole.vertices, whole.faces), process=False), union_mm3(UNIT), "unit")
    with pytest.raises(GeometryError, match="'lidless' is not watertight"):
        write_solids({"whole": unit, "lidless": unit.faces()[0]}, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_files_hold_the_solids_exactly_and_one_design_gives_the_same_bytes_twice(small_design, tmp_path):
    """Also within one process, where the CAD kernel goes on counting parts, and under another path."""
    from build123d import import_step

    solids = sensor_solids(small_design)
    for at in ("first", "second"):
        written = write_cad(small_design, tmp_path / at, MOULD)
    names = [*solids, "mould_tray", "mould_pillars", "mould_lid"]
    assert [path.name for path in written] == [f"{name}.{kind}" for name in names for kind in ("step", "stl")]
    for name, solid in solids.items():
        read = import_step(tmp_path / "first" / f"{name}.step")
        assert len(read.solids()) == len(solid.solids())
        assert read.volume == pytest.approx(solid.volume, rel=EXACT)
        check_surface(trimesh.load_mesh(tmp_path / "first" / f"{name}.stl"), solid.volume, name)
    first, second = ({path.name: path.read_bytes() for path in (tmp_path / at).iterdir()} for at in ("first", "second"))
    assert first == second
    assert len(first) == 2 * len(names)
    assert STEP_TIME.encode() in first["unit.step"]  # the two may be written within a second


def test_round_pillars_have_as_many_sides_as_asked():
    """Of the same volume: for the mesher fewer than for the mould."""
    unit = Unit(layout=round_of(LAYOUTS["upright-four"]))
    alone = SensorDesign(unit=unit, array=Array(rows=1, cols=1))
    for sides in (8, 24):
        assert [len(pillar.faces()) for pillar in pillar_solids(unit, sides)] == [sides + 2] * 4
        array = array_solid(alone, sides)
        assert len(array.faces()) == 4 * (sides + 2)
        assert array.volume == pytest.approx(pillar_volumes(unit).sum(), rel=EXACT)


def overlap_mm3(a, b) -> float:
    common = a & b
    return sum(solid.volume for solid in common.solids()) if common else 0.0


def test_the_mould_s_volumes_follow_their_closed_forms_and_its_lid_is_open_where_it_must_be(design):
    """Over upper electrodes and at the centre of every unit."""
    unit, n, t, (x, y, _) = design.unit, design.n_units, MOULD.plate_mm, design.slab_mm
    s, h, w, ow = unit.span_mm, unit.height_mm, unit.pillar_width_mm, oblique_width(unit)
    parts, rim_mm2 = mould_solids(design, MOULD), (x + 2 * MOULD.wall_mm) * (y + 2 * MOULD.wall_mm)

    def wedges(c: float) -> float:
        """Right-angled prisms: legs s − c along x, s − (w + ow)/2 along y, both as steep as the pillars."""
        return (w - 2 * c) * ((s - c) ** 2 + (s - (w + ow) / 2) ** 2) * h / (2 * s)

    expected = {
        "mould_tray": rim_mm2 * (h + t) - np.prod(design.slab_mm),
        "mould_pillars": rim_mm2 * (h + t) - n * (unit_solid(unit).volume + wedges(0.0)),
        "mould_lid": rim_mm2 * t - n * (2 * w**2 + ((s - w) / 2) ** 2) * t + n * wedges(MOULD.clearance_mm),
    }
    assert {name: part.volume for name, part in parts.items()} == pytest.approx(expected, rel=EXACT)
    assert all(part.is_valid and len(part.solids()) == 1 for part in parts.values())
    lid_top = max(parts["mould_lid"].faces(), key=lambda face: face.center().Z)
    boxes = [wire.bounding_box(optimal=True) for wire in lid_top.inner_wires()]
    openings = [(b.center().X, b.center().Y, b.size.X, b.size.Y) for b in boxes]
    vents = [(*(centre + top[:2]), w, w) for centre in unit_centres(design) for top in upper_electrodes(unit)]
    windows = [(*centre, (s - w) / 2, (s - w) / 2) for centre in unit_centres(design)]
    found, wanted = (sorted(np.round(o, 6).tolist()) for o in (openings, vents + windows))
    assert found == wanted


def test_the_lid_lifts_straight_off_and_units_lift_out_but_for_the_heel_of_the_y_pillar(small_design):
    """The heel is a prism of width w, as far out as the oblique pillar is wider than z, and as steep."""
    from build123d import Location

    parts, units, unit = mould_solids(small_design, MOULD), array_solid(small_design), small_design.unit
    depth = (oblique_width(unit) - unit.pillar_width_mm) / 2
    heel = unit.pillar_width_mm * depth**2 * unit.height_mm / (2 * unit.span_mm)
    for lift_mm in (0.0, 1.0):
        lid, lifted = (part.moved(Location((0, 0, lift_mm))) for part in (parts["mould_lid"], units))
        assert overlap_mm3(lid, parts["mould_pillars"]) == pytest.approx(0.0, abs=EXACT)
        assert sum(overlap_mm3(lid, each) for each in units.solids()) == pytest.approx(0.0, abs=EXACT)
        for each in lifted.solids() if lift_mm else ():
            assert overlap_mm3(each, parts["mould_pillars"]) == pytest.approx(heel, rel=1e-6)
    assert overlap_mm3(parts["mould_lid"], parts["mould_tray"]) == pytest.approx(0.0, abs=EXACT)
    with pytest.raises(DesignError, match=r"clearance_mm=1 leaves no wedges .* pillar_width_mm, 1;"):
        mould_solids(small_design, Mould(clearance_mm=1.0))


def test_pillars_of_a_section_that_is_only_listed_are_moulded(monkeypatch):
    """Lid, block and rubber fill the slab and meet nowhere."""
    monkeypatch.setitem(SECTIONS, "hexagon", HEXAGON)
    unit = Unit(layout=of_section(LAYOUTS["six-pillar"], "hexagon"))
    design = SensorDesign(unit=unit, array=Array(rows=1, cols=1))
    parts, (x, y, h) = mould_solids(design, Mould(clearance_mm=0.0)), design.slab_mm
    filling = parts["mould_lid"], parts["mould_pillars"], unit_solid(unit)
    assert [overlap_mm3(one, other) for one, other in combinations(filling, 2)] == pytest.approx([0.0] * 3, abs=1e-6)
    room = box(x, y, 0.0, h)
    assert sum(overlap_mm3(part, room) for part in filling) == pytest.approx(room.volume, rel=1e-9)


@pytest.mark.parametrize(
    "layout",
    [
        *LAYOUTS.values(),
        DIAGONAL,
        *(pytest.param(round_of(one), marks=pytest.mark.long) for one in (*LAYOUTS.values(), DIAGONAL)),
    ],
)
def test_units_of_every_layout_are_drawn_and_moulded(layout):
    """Lid, block and rubber fill the slab and meet nowhere; rubber lifts out but for heels of its drawing."""
    from build123d import Location

    unit = Unit(layout=layout)
    design, solid = SensorDesign(unit=unit, array=Array(rows=1, cols=1)), unit_solid(unit)
    assert solid.is_valid
    parts = mould_solids(design, Mould(clearance_mm=0.0))
    assert all(part.is_valid and len(part.solids()) == 1 for part in parts.values())
    lid, block = parts["mould_lid"], parts["mould_pillars"]
    assert overlap_mm3(lid, block) + overlap_mm3(lid, solid) + overlap_mm3(block, solid) == pytest.approx(0.0, abs=1e-6)
    x, y, h = design.slab_mm
    room = box(x, y, 0.0, h).volume
    filled = sum(overlap_mm3(part, box(x, y, 0.0, h)) for part in (lid, block, solid))
    assert filled == pytest.approx(room, rel=1e-9)
    on_upright = {one.foot for one in layout.pillars if one.name.startswith("z")}
    heels = sum(one.foot in on_upright for one in layout.pillars if not one.name.startswith("z"))
    run_mm = 2 * h * np.tan(np.radians(castability(design).demould_deg)) if heels else np.inf
    heel = unit.pillar_width_mm * castability(design).undercut_mm ** 2 * h / run_mm
    share = 2 / 3 if layout.pillars[0].is_round else 1.0  # heels are thinner toward a round one's sides, by 1 − y²
    caught = [overlap_mm3(solid.moved(Location((0, 0, lift_mm))), block) for lift_mm in (1.0, 2.5, 4.5)]
    assert caught[0] <= caught[1] * (1 + 1e-3) + 1e-9  # of one that is higher than the first lift
    assert caught[1:] == pytest.approx([caught[1]] * 2, rel=1e-3, abs=1e-9)  # nothing further up is in the way
    if leans_both_ways(unit).any():  # whose heels are of no even depth
        assert caught[1] < heels * heel
    else:
        assert caught[:2] == pytest.approx([share * heels * heel] * 2, rel=1e-3, abs=1e-9)
