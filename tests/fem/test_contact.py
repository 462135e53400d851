"""Contact by shape against closed forms and NGSolve, and its compliance against the array's response."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.figure import Figure

from common.errors import DesignError
from fem.array.solving import ResponseSettings, array_response
from fem.contact import (
    ContactError,
    Cylinder,
    Flat,
    ShapeError,
    Sphere,
    SurfaceCompliance,
    about_z,
    judge,
    press,
    read_solid,
    surface_compliance,
)
from fem.contact.compliance import PatchCompliance
from fem.contact.indentation import OPEN, STICK, State
from fem.contact.surface import MESH_LEVEL, NEAR_DEGREE
from fem.contact.tiles import Patch, cell_rectangles, on_pillars, shares_by_rubber, tiles_per_pitch
from fem.pictures.contact import _draw_patch
from geometry.design import Array, Material, SensorDesign, Unit
from geometry.layout import pad_squares

DEPTH, RADIUS = 0.01, 10.0
A_MM = np.sqrt(RADIUS * DEPTH)


def endless(poisson: float, height_mm: float = 2000.0) -> SurfaceCompliance:
    """A layer on a slab so wide that its sides are not felt; a half-space unless it is thin."""
    rubber, wide, thick = Material(poisson=poisson), 2000.0, max(height_mm / 50, 2.0)
    unit = Unit(height_mm=height_mm, span_mm=max(height_mm / 5, 10.0), pillar_width_mm=thick, electrode_mm=thick)
    array = Array(rows=1, cols=1, pitch_mm=wide)
    design = SensorDesign(unit=unit, array=array, pillar_material=rubber, matrix_material=rubber)
    rest, electrodes = np.zeros((3, 3, 3) * 2, dtype=np.float32), np.zeros((1, 1, 2, 3, 3, 3, 3), dtype=np.float32)
    table = np.zeros((3, 3, 3, 3))
    return SurfaceCompliance(design=design, on_tiles=rest, on_electrodes=electrodes, table=table, step_mm=wide / 2)


def test_sphere_and_disc_on_a_half_space_are_hertz_and_boussinesq():
    """F = 4/3 E* √R δ^1.5, a = √(R δ), p₀ = 2 E*/π √(δ/R); F = 2 a E* δ, a grid's disc to a part of a cell."""
    E = 6.1 / (1 - 0.3**2)
    sphere, disc = (press(endless(0.3), shape, DEPTH) for shape in (Sphere(RADIUS), Flat(radius_mm=1.0)))
    hertz = 4 / 3 * E * np.sqrt(RADIUS) * DEPTH**1.5
    for contact, force_n, bound in ((sphere, hertz, 2e-3), (disc, 2 * E * DEPTH, 1e-2)):
        error = abs(contact.net_force_n[2] / force_n - 1)
        assert error < min(bound, contact.error_estimate)
        assert contact.error_estimate < 0.02
    assert np.sqrt(sphere.area_mm2 / np.pi) == pytest.approx(A_MM, rel=1e-2)
    assert sphere.peak_mpa == pytest.approx(2 * E / np.pi * np.sqrt(DEPTH / RADIUS), rel=2e-3)


def test_a_sphere_on_the_thin_slab_is_ngsolve_s():
    """Axially symmetric, by `python -m studies peers spheres`."""
    contact = press(endless(0.49, 10.0), Sphere(10.0), 1.5)
    error = abs(contact.net_force_n[2] / 104.255 - 1)
    assert error < min(1.5e-3, contact.error_estimate)
    assert contact.error_estimate < 0.01
    assert (np.sqrt(contact.area_mm2 / np.pi), contact.peak_mpa) == pytest.approx((4.392, 2.4944), rel=1e-2)


def test_a_picture_shows_the_pressure_of_a_contact_up_to_the_end_of_the_rubber(pair: SurfaceCompliance):
    """Under an endless cylinder as under a round one: all cells that touch lie within the line around them."""
    contact, axes = press(pair, Cylinder(10.0), 0.5, cells=24), Figure().subplots()
    _draw_patch(axes, contact)
    x, y = np.broadcast_arrays(contact.patch.x_mm, contact.patch.y_mm[:, None])
    (around,) = axes.collections[0].get_paths()
    within = around.contains_points(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    touches = contact.state != OPEN
    assert touches.any(axis=0).all()
    assert within[touches].mean() > 0.95  # corners are rounded
    assert not within[~touches].any()
    assert axes.axis() == pytest.approx(np.column_stack([contact.patch.low_mm, contact.patch.high_mm]).ravel())


def test_the_estimate_covers_what_finer_grids_and_increments_change(pair: SurfaceCompliance):
    """Of forces and electrodes; the tiles, the same in both, are in the estimate as well."""
    path = {"at_mm": (3.0, 2.0), "slide_mm": (0.3, -0.2), "friction": 0.7}
    coarse, fine = (press(pair, Cylinder(6.0, 5.0, turn=about_z(20.0)), 0.8, cells=cells, **path) for cells in (16, 80))
    for name, estimate in (("force_n", coarse.error_estimate), ("electrode_mm", coarse.electrode_error_estimate)):
        one, other = getattr(coarse, name), getattr(fine, name)
        assert np.linalg.norm(one - other) < estimate * np.linalg.norm(other)


def test_dragged_sphere_slips_outside_the_circle_of_cattaneo_and_mindlin():
    """c/a = (1 − Q/μP)^(1/3) and its displacement; ν = 0.5 uncouples normal and tangential forces."""
    nu, friction, share = 0.4999, 0.5, 0.8
    G = 6.1 / 2 / (1 + nu)
    P = 4 / 3 * 6.1 / (1 - nu**2) * np.sqrt(RADIUS) * DEPTH**1.5
    slide = 3 * friction * P * (2 - nu) / (16 * G * A_MM) * (1 - (1 - share) ** (2 / 3))
    contact = press(endless(nu), Sphere(RADIUS), DEPTH, slide_mm=(slide, 0.0), friction=friction)
    fx, fy, fz = contact.net_force_n
    assert fx / (friction * fz) == pytest.approx(share, rel=1e-2)
    assert abs(fy) < 1e-3 * fx
    assert np.sqrt(contact.sticking) == pytest.approx((1 - share) ** (1 / 3), abs=0.02)  # a cell is 0.04 of the radius


def test_full_slide_obeys_coulomb_everywhere():
    contact = press(endless(0.3), Sphere(RADIUS), DEPTH, slide_mm=(0.03, 0.04), friction=0.4)
    assert (contact.state != STICK).all()
    assert np.hypot(*contact.cell_force_n[:2]) == pytest.approx(0.4 * contact.cell_force_n[2], rel=1e-6, abs=1e-12)
    assert contact.net_force_n[:2] == pytest.approx(0.4 * contact.net_force_n[2] * np.array([0.6, 0.8]), rel=1e-2)


def test_electrodes_move_as_in_the_array_s_response(pair: SurfaceCompliance, shared_cache: None):
    """A pad's uniform traction by two routes; 1.5 mm from a rim tiles err by 1.5 %, the layer alone by 40 %."""
    response, _, _ = array_response(pair.design, ResponseSettings(tolerance=1e-2))
    x0, y0, x1, y1 = pad_squares(pair.design)[1]
    compliance = PatchCompliance(pair, Patch((x0, y0), (x1, y1), 24, 24))
    for axis in range(3):
        force = np.zeros((3, 24, 24))
        force[axis] = 1 / 24**2
        expected = response.influence_mm_per_n[..., 0, 1, axis]
        assert np.abs(compliance.electrodes_mm(force) - expected).max() < 0.02 * np.abs(expected).max()


#: by NGSolve, third order, 81,000 to 152,000 unknowns, contact by penalty: a ball of 5 mm 1 mm deep on 2 × 2 units at a
#: unit's middle, on an electrode and at the corner of four; the force [N], and the electrode that moves most [mm]
NGSOLVE = {
    121.0: (
        ((7.5, 7.5), 0.25406, (1, 1, 1), (-0.0083, 0.0690, -0.0682)),
        ((2.5, 2.5), 3.2445, (1, 1, 0), (-0.5370, -0.0785, -0.9423)),
        ((0.0, 0.0), 0.67836, (0, 1, 1), (-0.0407, 0.1354, -0.2040)),
    ),
    6.0: (
        ((7.5, 7.5), 4.9075, (1, 1, 1), (0.0079, 0.0562, -0.0533)),
        ((2.5, 2.5), 8.6676, (1, 1, 0), (-0.1263, -0.0013, -0.9390)),
        ((0.0, 0.0), 5.7904, (0, 1, 1), (-0.0054, 0.0070, -0.1833)),
    ),
}


@pytest.mark.parametrize(
    ("contrast", "level", "degree"),
    [
        (121.0, 0, 5),
        pytest.param(121.0, MESH_LEVEL, NEAR_DEGREE, marks=pytest.mark.long),
        pytest.param(6.0, MESH_LEVEL, NEAR_DEGREE, marks=pytest.mark.long),
    ],
)
def test_two_rubbers_are_ngsolve_s_and_continuous_across_units(contrast, level, degree, monkeypatch):
    """Net force to 2 %, electrodes to 3 %, both within the estimates, which are small enough not to be refused; on the
    coarsest mesh as well.

    A force beside the border of two units moves both sides of it alike, and forces and displacements are reciprocal.
    """
    monkeypatch.setattr("fem.contact.surface.MESH_LEVEL", level)
    monkeypatch.setattr("fem.contact.surface.NEAR_DEGREE", degree)
    monkeypatch.setattr("fem.contact.surface.STEPS_PER_ELECTRODE", 4)
    soft = Material(young_mpa=6.1 / contrast, poisson=0.49)
    surface, _, _ = surface_compliance(SensorDesign(array=Array(rows=2, cols=2), matrix_material=soft))
    for at_mm, force_n, electrode, moved_mm in NGSOLVE[contrast]:
        contact = press(surface, Sphere(5.0), 1.0, at_mm=at_mm)
        error = abs(contact.net_force_n[2] / force_n - 1)
        missed = np.linalg.norm(contact.electrode_mm[electrode] - moved_mm) / np.linalg.norm(moved_mm)
        assert error < 0.02, (at_mm, error)
        assert missed < 0.03, (at_mm, missed)
        assert missed < contact.electrode_error_estimate + 0.01  # NGSolve errs as well
        judge(contact)
    compliance = PatchCompliance(surface, Patch((-1.0, -1.0), (1.0, 1.0), 40, 20))
    force = np.zeros((3, 20, 40))
    force[2, 10, 5] = 1.0
    along = compliance.moved_mm(force)[2, 10, 10:]
    steps = np.abs(np.diff(along))
    assert steps[9] < 1.5 * max(steps[8], steps[10])  # over x = 0
    f, g = np.random.default_rng(0).normal(size=(2, 3, 20, 40))
    assert (f * compliance.moved_mm(g)).sum() == pytest.approx((g * compliance.moved_mm(f)).sum(), rel=1e-4)


def test_tiles_on_pillars_tops_keep_forces_and_tilts(pair: SurfaceCompliance):
    """Shares sum to 1 on both rubbers, and what varies linearly over a top, as it tilts, is kept."""
    design = replace(pair.design, matrix_material=Material(young_mpa=0.05))
    patch = Patch((-14.0, -7.0), (6.0, 7.0), 101, 71)
    found, (rows, columns) = shares_by_rubber(patch, design, 2)
    assert not rows.any()
    assert found.sum(axis=1) == pytest.approx(1.0)
    squares = cell_rectangles(design)[: tiles_per_pitch(design)[0]]
    middles = squares.reshape(-1, 2, 2).mean(axis=1)
    on_tops = on_pillars(design, patch.x_mm, patch.y_mm)
    for axis in (0, 1):
        cells = [middles[:, axis] + x * (axis == 0) for x in (-7.5, 7.5)]  # two units along x
        seen = (found @ np.concatenate(cells)[columns]).reshape(71, 101)
        expected = np.broadcast_to((patch.x_mm, patch.y_mm[:, None])[axis], seen.shape)
        assert seen[on_tops] == pytest.approx(expected[on_tops])


def test_forces_on_stiff_tops_in_soft_rubber_are_found_by_each_cell_s_own_stiffness():
    """Known forces, 88 times as large on two tops, balance the displacements that they make, to ten tolerances."""
    tops = np.zeros((12, 12), dtype=bool)
    tops[2:5, 2:5] = tops[7:10, 6:9] = True
    own, places = np.where(tops, 1 / 88, 1.0), np.indices(tops.shape).reshape(2, -1)
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=0)
    compliance = np.sqrt(np.outer(own, own)) * np.where(apart > 0, 0.3 / (1 + apart), 1.0)
    true_n = np.random.default_rng(0).uniform(0.5, 1.5, own.shape) / own

    def give(force_n: np.ndarray) -> np.ndarray:
        return (compliance @ force_n.ravel()).reshape(force_n.shape)

    nothing = State(np.zeros((1, 12, 12)), np.zeros((1, 12, 12)))
    found = nothing.balanced(give, -give(true_n[None]), 0.0, 1e-4, np.inf, 1 / own).force_n[0]
    assert np.linalg.norm(found - true_n) < 1e-3 * np.linalg.norm(true_n)


def test_a_contact_is_warned_of_or_refused_by_its_estimate(pair: SurfaceCompliance):
    contact = press(pair, Sphere(8.0), 1.0)
    assert judge(contact) is None
    for error, told in ((0.1, "10%, above 5%"), (0.3, "30%, above 20%")):
        contact.__dict__["_judged"] = contact.__dict__["compliance_errors"] = (0.01, error)
        for on_grid in (True, False):
            if error > 0.2:
                with pytest.raises(ContactError, match=told):
                    judge(contact, on_grid=on_grid)
            assert f"electrodes is {error:.0%}, above 5%" in str(judge(contact, force=True, on_grid=on_grid))


@pytest.mark.parametrize("degree", [1, 4])
def test_forces_and_displacements_are_reciprocal(pair: SurfaceCompliance, degree: int):
    """f·u(g) = g·u(f), rims and couplings included; to single precision."""
    compliance = PatchCompliance(pair, Patch((-12.0, -7.5), (15.0, 5.0), 20, 12), degree)
    f, g = np.random.default_rng(0).normal(size=(2, 3, 12, 20))
    assert (f * compliance.moved_mm(g)).sum() == pytest.approx((g * compliance.moved_mm(f)).sum(), rel=2e-5)


def test_units_share_the_whole_force_about_its_centre_and_gaps_close_where_it_presses(pair: SurfaceCompliance):
    contact = press(pair, Sphere(8.0), 1.0, at_mm=(1.0, 0.5))
    assert contact.force_n.sum(axis=(0, 1)) == pytest.approx(contact.net_force_n, rel=1e-9)
    assert (contact.force_n[0, :, 2] > 0).all()
    assert contact.centre_mm == pytest.approx([1.0, 0.5], abs=0.1)
    assert contact.gap_mm.min() > -1e-3 * contact.depth_mm
    assert np.abs(contact.gap_mm[contact.state != OPEN]).max() < 1e-3 * contact.depth_mm
    assert (contact.cell_force_n[2] >= 0).all()
    patch = Patch((-3.0, -1.0), (3.0, 1.0), 3, 1)  # the middle cell lies on the border
    assert patch.unit_loads(np.ones((3, 1, 3)), pair.design.array)[0, :, 2].tolist() == [1.5, 1.5]


def test_stl_of_a_box_is_a_flat_punch_and_no_solid_is_refused(pair: SurfaceCompliance, tmp_path: Path):
    trimesh.creation.box((6.0, 4.0, 3.0)).export(tmp_path / "box.stl")
    by_file, by_size = (press(pair, shape, 0.4) for shape in (read_solid(tmp_path / "box.stl"), Flat((6.0, 4.0))))
    assert by_file.net_force_n[2] == pytest.approx(by_size.net_force_n[2], rel=1e-6)
    ball = trimesh.creation.icosphere(1, 5.0)
    ball.update_faces(np.arange(len(ball.faces)) > 3)
    ball.export(tmp_path / "open.stl")
    (tmp_path / "text.stl").write_text("no triangles here")
    for name, told in (("open", "not closed"), ("text", "damaged|no triangles"), ("none", "no such file")):
        with pytest.raises(ShapeError, match=told):
            read_solid(tmp_path / f"{name}.stl")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"depth_mm": 0.0}, "depth_mm=0 must be above 0"),
        ({"depth_mm": 10.0}, "below the slab's height"),
        ({"at_mm": (100.0, 0.0)}, "misses the sensor"),
        ({"friction": -0.1}, "friction=-0.1 must be"),
        ({"slide_mm": (1e3, 0.0)}, "leaves the sensor"),
        ({"at_mm": (float("nan"), 0.0)}, "finite"),
        ({"sensor": SensorDesign(array=Array(rows=20))}, "too many"),
    ],
)
def test_contacts_that_cannot_be_are_refused(pair: SurfaceCompliance, changes: dict, told: str):
    given = {"sensor": pair, "shape": Sphere(5.0), "depth_mm": 1.0} | changes
    with pytest.raises((ContactError, DesignError), match=told):
        press(**given)
