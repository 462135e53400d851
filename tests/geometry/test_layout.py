"""Where everything of a design is, against the tables of the design page and independent routes."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from fem.pictures.parts import pillar_surface
from geometry import Array, DesignError, Pad, SensorDesign, Unit
from geometry.cad import sensor_solids, unit_solid
from geometry.castability import castability, conductive_mm3
from geometry.layout import (
    AXES,
    LAYOUTS,
    SECTIONS,
    SONG2018,
    Electrode,
    Layout,
    Pillar,
    electrode_centres,
    electrode_squares,
    pad_squares,
    pillar_ends,
    pillar_sections,
    pillar_volumes,
    require_told,
    rest_lengths,
    unit_centres,
    upper_electrodes,
)
from geometry.mould import Mould, mould_solids
from geometry.prism import MESHED_SIDES, SIDES, Prism, pillar_prisms, prisms_at, slab_prism, unit_prisms
from geometry.shares import pillar_shares
from geometry.wiring import unit_crossings
from tests.fem.scenes import BESIDE, DIAGONAL, HEXAGON, of_section, round_of

EXACT = 1e-14  # rounding


def test_papers_unit_in_the_orders_of_the_file_contract():
    """U1 and U2 over L1's row; z stands from L1 to U1, x leans from L2 to U1, y from L1 to U2."""
    assert (AXES, SONG2018.upper_names, SONG2018.pillar_top) == (("x", "y", "z"), ("U1", "U2"), (0, 0, 1))
    assert SONG2018.pillar_names == ("z", "x", "y")
    U1, U2, L1, L2 = [-5.0, -5.0, 10.0], [-5.0, 5.0, 10.0], [-5.0, -5.0, 0.0], [5.0, -5.0, 0.0]
    assert electrode_centres(Unit()).tolist() == [U1, U2, L1, L2]
    assert upper_electrodes(Unit()).tolist() == [U1, U2]
    assert pillar_ends(Unit()).tolist() == [[L1, U1], [L2, U1], [L1, U2]]
    oblique, wide = 10 * np.sqrt(2), 2 * np.sqrt(2)
    assert rest_lengths(Unit()) == pytest.approx([10.0, oblique, oblique], rel=EXACT)
    assert pillar_volumes(Unit()) == pytest.approx([40.0, 4 * oblique, 4 * oblique], rel=EXACT)
    assert pillar_sections(Unit()) == pytest.approx(np.array([[2, 2], [wide, 2], [2, wide]]), rel=EXACT)


SENSING = {
    "song2018": (((1,), (2,), (0,)), 3),
    "six-pillar": (((1, 5), (2,), (0, 3, 4)), 6),
    "eight-pillar": (((1, 5), (3, 7), (0, 2, 4, 6)), 6),
    "upright-four": (((0, 1, 2, 3), (0, 1, 2, 3), (0, 1, 2, 3)), 3),
    "single": (((0,), (0,), (0,)), 1),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_pillars_by_what_they_sense_and_what_they_tell_of_a_rigid_plate(name):
    """A plate moves by u + θ × p, a pillar d lengthens by d·(u + θ × p)/|d|."""
    unit = Unit(layout=LAYOUTS[name])
    along = np.subtract(*pillar_ends(unit).transpose(1, 0, 2)[::-1])
    assert (along[:, 2] == unit.height_mm).all()
    lengthened = np.hstack([along, np.cross(pillar_ends(unit)[:, 1], along)])
    told = tuple(unit.layout.sensing(axis) for axis in AXES), np.linalg.matrix_rank(lengthened)
    assert told == SENSING[name]


def test_a_reference_has_a_resistance_and_a_crossing_and_is_no_part_of_the_body():
    """It may lean both ways and cross any pillar; the line between its ends is as long as a cube's diagonal."""
    unit, paper = Unit(layout=BESIDE), SensorDesign(array=Array(rows=1, cols=2))
    design = replace(paper, unit=unit)
    assert rest_lengths(unit)[3] == pytest.approx(np.sqrt(300.0), rel=EXACT)
    assert pillar_volumes(unit)[3] == pytest.approx(9 * np.sqrt(300.0), rel=EXACT)
    assert (unit_crossings(BESIDE) >= 0).all()
    assert [BESIDE.sensing(axis) for axis in AXES] == [SONG2018.sensing(axis) for axis in AXES]
    assert (unit.body, unit.footprint_mm) == (Unit(), Unit().footprint_mm)
    assert replace(unit, span_mm=3.0).layout == BESIDE  # as narrow as the paper's may be
    lines = np.linspace(-8.0, 8.0, 9), np.linspace(-8.0, 8.0, 9), np.linspace(0.0, 10.0, 5)
    for of in (
        lambda one: pillar_prisms(one),
        lambda one: castability(one),
        lambda one: pillar_shares(one.unit, *lines).tolist(),
        lambda one: {name: solid.volume for name, solid in sensor_solids(one).items()},
        lambda one: {name: solid.volume for name, solid in mould_solids(one, Mould()).items()},
        lambda one: len(pillar_surface(one.unit)[0]),
    ):
        assert of(design) == of(paper)


def test_units_run_along_x_first_with_squares_of_electrodes_and_pads():
    pad = Pad(size_mm=4.0, offset_x_mm=-5.0, offset_y_mm=2.0)
    design = SensorDesign(array=Array(rows=2, cols=3, pitch_mm=16.0), pad=pad)
    squares = electrode_squares(design).reshape(6, 2, 4)
    for k, (x, y) in enumerate(unit_centres(design)):
        i, j = divmod(k, 3)
        assert (x, y) == ((j - 1) * 16.0, (i - 0.5) * 16.0)
        assert pad_squares(design)[k].tolist() == [x - 7, y, x - 3, y + 4]
        for e, (ex, ey, _) in enumerate(upper_electrodes(design.unit)):
            assert squares[k, e].tolist() == [x + ex - 1, y + ey - 1, x + ex + 1, y + ey + 1]


def test_points_inside_pillars_are_those_inside_their_hulls(design):
    """A point is inside a convex body if it is behind all faces of the hull of its corners, whatever unit it is of."""
    prisms, (x, y, h) = pillar_prisms(design), design.slab_mm
    points = np.random.default_rng(0).uniform([-x / 2, -y / 2, -0.2 * h], [x / 2, y / 2, 1.2 * h], (20_000, 3))
    expected = np.zeros(len(points), dtype=np.int64)
    for number, prism in enumerate(prisms, start=1):
        hull = trimesh.convex.convex_hull(prism.corners())
        depth = points @ hull.face_normals.T - (hull.face_normals * hull.triangles[:, 0]).sum(1)
        expected[(depth <= 0).all(axis=1)] = number  # the last wins
    assert (expected > 0).sum() > 50
    assert np.array_equal(prisms_at(points, prisms), expected)
    assert (len(prisms), slab_prism(design).volume_mm3) == (3 * design.n_units, pytest.approx(x * y * h))


def test_round_prisms_hold_what_lies_on_their_ellipses():
    prism = Prism(base_mm=(1.0, 0.0, 0.0), top_mm=(4.0, 0.0, 6.0), section_mm=(4.0, 2.0), section="round")
    angle = np.linspace(0.0, 6.0, 20)
    on_side = np.column_stack([3.5 + 2 * np.cos(angle), np.sin(angle), np.full(20, 5.0)])
    assert prism.distance(on_side) == pytest.approx(np.zeros(20), abs=1e-12)
    for ratio, inside in ((0.99, True), (1.01, False)):
        moved = np.column_stack([[3.5, 0.0] + ratio * (on_side[:, :2] - [3.5, 0.0]), on_side[:, 2]])
        assert (prism.holds(moved) == inside).all()
    assert prism.distance(np.array([[3.5, 2.0, 5.0], [4.0, 0.0, 7.0]])).tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("sides", "stiffer"), [(MESHED_SIDES, 2.25e-3), (SIDES, 2.6e-5)])
def test_polygons_of_round_sections_have_their_area_and_bend_nearly_as_they_do(sides, stiffer):
    """Of n sides: ∫ x² = A² (2 + cos θ) / 6 n sin θ with θ = 2π/n, where a circle has A² / 4π."""
    prism = Prism(base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, 1.0), section_mm=(3.0, 2.0), section="round")
    x, y = prism.corners(sides)[:sides, :2].T
    u, v = np.roll(x, -1), np.roll(y, -1)
    cross = x * v - u * y
    assert cross.sum() / 2 == pytest.approx(prism.volume_mm3, rel=1e-12)
    theta = 2 * np.pi / sides
    ratio = 4 * np.pi * (2 + np.cos(theta)) / (6 * sides * np.sin(theta))
    assert ratio - 1 == pytest.approx(stiffer, rel=0.1)
    moments = [(cross * (p * p + p * q + q * q)).sum() / 12 for p, q in ((x, u), (y, v))]
    assert moments == pytest.approx([ratio * np.pi / 64 * 3.0**3 * 2.0, ratio * np.pi / 64 * 2.0**3 * 3.0], rel=1e-12)


@pytest.mark.parametrize("layout", [DIAGONAL, SONG2018], ids=["diagonal", "song2018"])
@pytest.mark.parametrize("section", [*SECTIONS, "hexagon"])
def test_pillars_are_as_wide_across_however_they_lean(layout, section, monkeypatch):
    """Regular perpendicular to the axis, S·l in volume; points are inside by it as by the hull of corners.

    Also of a section that is only listed, of flat sides w apart.
    """
    monkeypatch.setitem(SECTIONS, "hexagon", HEXAGON)
    unit, is_round = Unit(layout=of_section(layout, section)), section == "round"
    assert unit_solid(unit).volume == pytest.approx(conductive_mm3(SensorDesign(unit=unit)) / 36, rel=2e-3)
    for one, volume, extents in zip(unit_prisms(unit), pillar_volumes(unit), pillar_sections(unit), strict=True):
        corners, axis = one.corners(), one.axis_mm / np.linalg.norm(one.axis_mm)
        hull = trimesh.convex.convex_hull(corners)
        assert hull.volume == pytest.approx(volume, rel=1e-12)
        assert one.volume_mm3 == pytest.approx(volume, rel=1e-12)
        assert one.extents_mm == pytest.approx(extents, rel=1e-12)
        for ratio in (0.99, 1.01):  # the rectangles around two sections overlap, or do not
            step = np.array([ratio * extents[0], 0.0, 0.0])
            beside = replace(one, base_mm=tuple(one.base_mm + step), top_mm=tuple(one.top_mm + step))
            assert one.cuts(beside, 1e-9) == (ratio < 1)
        foot = corners[: len(corners) // 2] - one.base_mm
        across = foot - (foot @ axis)[:, None] * axis  # of the faces along the axis
        radii = np.linalg.norm(across, axis=1)
        assert radii == pytest.approx(np.full(len(foot), radii[0]), rel=1e-12)
        assert np.cross(across, np.roll(across, -1, axis=0)) @ axis == pytest.approx(
            np.full(len(foot), 2 * volume / np.linalg.norm(one.axis_mm) / len(foot)), rel=1e-12
        )
        points = np.random.default_rng(0).uniform([-3.0, -3.0, -1.0], [3.0, 3.0, 11.0], (3000, 3))
        points[:, :2] += one.axis_at(points[:, 2])
        depth = (points @ hull.face_normals.T - (hull.face_normals * hull.triangles[:, 0]).sum(1)).max(axis=1)
        clear = np.abs(depth) > (0.02 if is_round else 1e-9)  # of a circle and its polygon
        assert (depth[clear] < 0).sum() > 100
        assert np.array_equal(one.holds(points)[clear], depth[clear] < 0)


UPPER, LOWER = (Electrode("U1", (-1.0, 0.0)), Electrode("U2", (1.0, 0.0))), (Electrode("L1", (-1.0, 0.0)),)
Z, X = Pillar("z", "L1", "U1"), Pillar("x", "L1", "U2")


def test_ends_of_pillars_and_electrodes_may_not_meet_in_any_layout():
    """Two uprights of 2 mm under electrodes of 3, a span apart along x alone."""
    uprights = Layout(UPPER, (*LOWER, Electrode("L2", (1.0, 0.0))), (Z, Pillar("w", "L2", "U2")))
    unit = Unit(span_mm=3.0 + 1e-9, electrode_mm=3.0, layout=uprights)
    assert unit.footprint_mm == pytest.approx(6.0)
    with pytest.raises(DesignError, match="it must be above 3"):
        replace(unit, span_mm=3.0)


CROSS = Layout(
    upper=(Electrode("U1", (1.0, 0.0)), Electrode("U2", (0.0, 1.0))),
    lower=(Electrode("L1", (-1.0, 0.0)), Electrode("L2", (0.0, -1.0))),
    pillars=(Pillar("x", "L1", "U1"), Pillar("y", "L2", "U2")),
)


def test_pillars_that_cross_between_their_electrodes_are_refused():
    """Two that meet in the middle; the paper's x and y meet in narrow units, but inside z, which joins both."""
    with pytest.raises(DesignError, match=r"pillars x and y cross between their electrodes at span_mm=10: widen the"):
        Unit(layout=CROSS)
    Unit(span_mm=3.0)


def test_forces_that_a_layout_cannot_tell_apart_are_named():
    """Uprights alone tell shear by how it turns a pad, but not from pressure where all stand in one line."""
    for name, layout in LAYOUTS.items():
        require_told(Unit(layout=layout), "z" if name == "single" else AXES)
    line = Unit(layout=Layout(UPPER, (*LOWER, Electrode("L2", (1.0, 0.0))), (Z, Pillar("w", "L2", "U2"))))
    for axes in ("z", "xz"):
        require_told(line, tuple(axes))
    with pytest.raises(DesignError, match="pillars z, w do not tell forces along y from others: ask for fewer"):
        require_told(line)
    with pytest.raises(DesignError, match="do not tell forces along y from others"):
        require_told(line, ("y",))


def test_round_pillars_fill_their_circle_and_widths_of_their_own_count():
    """Volumes π w² l/4; the same by boxes, and of what is common of two by solids: 1e-5 of Gauss points."""
    round_x = tuple(replace(one, section="round") if one.name == "x" else one for one in LAYOUTS["six-pillar"].pillars)
    own = replace(LAYOUTS["six-pillar"], pillars=(replace(round_x[0], width_mm=1.0), *round_x[1:]))
    volumes, square = pillar_volumes(Unit(layout=own)), pillar_volumes(Unit(layout=LAYOUTS["six-pillar"]))
    assert volumes / square == pytest.approx([0.25, np.pi / 4, 1, 1, 1, 1], rel=EXACT)
    assert pillar_sections(Unit(layout=own))[0].tolist() == [1.0, 1.0]
    lines = np.linspace(-7.0, 7.0, 41), np.linspace(0.0, 10.0, 11)
    for layout in (round_of(SONG2018), DIAGONAL, round_of(DIAGONAL)):
        unit = Unit(layout=layout)
        shares = pillar_shares(unit, lines[0], lines[0], lines[1])
        assert 0 <= shares.min() <= shares.max() <= 1
        assert shares.sum() * 0.35**2 == pytest.approx(unit_solid(unit).volume, rel=1e-4)


def test_pillars_that_meet_in_one_place_are_counted_before_all_their_overlaps_are():
    """Of 20 on one electrode there would be a million."""
    around = [(round(1.5 * np.cos(k), 3), round(1.5 * np.sin(k), 3)) for k in range(20)]
    upper = tuple(Electrode(f"U{k}", place) for k, place in enumerate(around))
    star = Layout(upper, (Electrode("L0", (0.0, 0.0)),), tuple(Pillar(f"p{k}", "L0", f"U{k}") for k in range(20)))
    line = np.array([-1.0, 1.0])
    with pytest.raises(DesignError, match="too many pillars of a unit lie in one place: join fewer at an electrode"):
        pillar_shares(Unit(layout=star, pillar_width_mm=0.5, electrode_mm=0.5), line, line, line + 1.0)
