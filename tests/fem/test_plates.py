"""Shapes pressed on arrays of rigid plates: against the array's response, closed forms and NGSolve."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from fem.array.solving import ResponseSettings, solve_response
from fem.contact import Flat, Indentation, Sphere, Stepper, SurfaceCompliance, press, surface_compliance
from fem.contact.compliance import UP, PatchCompliance
from fem.contact.driver import pressed
from fem.contact.tiles import Patch, cell_strips, edges, lined_grid, shares, slab_strips
from fem.pictures.contact import _outline, draw_contact
from geometry.design import Array, Pad, Plate, SensorDesign
from geometry.layout import pad_squares
from studies.bench.peers.plates import CASES, answer_of, by_ngsolve
from studies.bench.peers.plates import DESIGN as FOUR
from tests.fem.coarse_plates import coarse_surface

PLATED = SensorDesign(array=Array(rows=1, cols=2), pad=Pad(kind="stiff"))


@pytest.fixture(scope="module")
def plated() -> SurfaceCompliance:
    """The paper's unit twice under plates, on coarse cells."""
    return coarse_surface(PLATED, 2, 4)


def on_right_plate(axis: int) -> tuple[Patch, np.ndarray]:
    """A force of 1 N along an axis, spread over the right plate, with no moment about its underside's middle."""
    patch, force = Patch((1.5, -6.0), (13.5, 6.0), 24, 24), np.zeros((3, 24, 24))
    force[axis] = 1 / 24**2
    if axis < 2:
        arm = np.broadcast_to((patch.x_mm - 7.5, patch.y_mm[:, None])[axis], (24, 24))
        force[2] = PLATED.pad.plate.thickness_mm * arm / (arm**2).sum()
    return patch, force


def test_forces_on_plates_move_electrodes_as_in_the_array_s_response(plated: SurfaceCompliance):
    """Another path to the middle of a plate: to the response's tolerance and that of coarse cells."""
    response = solve_response(PLATED, ResponseSettings(tolerance=1e-2))
    for axis in range(3):
        patch, force = on_right_plate(axis)
        expected = response.influence_mm_per_n[..., 0, 1, axis]
        found = PatchCompliance(plated, patch).electrodes_mm(force)
        assert np.abs(found - expected).max() < 0.015 * np.abs(expected).max()


def test_a_plate_s_cells_move_as_a_rigid_body_by_any_forces(plated: SurfaceCompliance):
    """But for what its own face gives under each cell; forces and displacements are reciprocal, between plates, too."""
    patch = Patch((-15.0, -7.5), (15.0, 7.5), 40, 20)
    compliance = PatchCompliance(plated, patch)
    f, g = np.random.default_rng(0).normal(size=(2, 3, 20, 40))
    moved = compliance.moved_mm(f)
    assert (f * compliance.moved_mm(g)).sum() == pytest.approx((g * moved).sum(), rel=2e-5)
    on_left = np.ix_(range(3), np.abs(patch.y_mm) < 6.0, np.abs(patch.x_mm + 7.5) < 6.0)
    own = moved[on_left] - PLATED.pad.plate.face_mm_per_mpa / patch.cell_mm2 * f[on_left]
    x, y = np.meshgrid(patch.x_mm[np.abs(patch.x_mm + 7.5) < 6.0] + 7.5, patch.y_mm[np.abs(patch.y_mm) < 6.0])
    zero, one = 0 * x, 1 + 0 * x
    motions = [(one, zero, zero), (zero, one, zero), (zero, zero, one), (-y, x, zero), (zero, zero, x), (zero, zero, y)]
    A = np.stack([np.stack(each).ravel() for each in motions], axis=1)
    left = A @ np.linalg.lstsq(A, own.ravel())[0] - own.ravel()
    assert np.abs(left).max() < 1e-5 * np.abs(own).max()


def test_a_shear_on_a_plate_s_face_turns_it_by_the_plate_s_thickness(plated: SurfaceCompliance):
    """As pressure moved along x by t F_x / F_z does: F_x a height t above has the moment t F_x about y."""
    thick = replace(PLATED, pad=replace(PLATED.pad, plate=Plate(thickness_mm=3.0)))
    patch, shear = on_right_plate(0)
    _, pressure = on_right_plate(2)
    off = -pressure * 3.0 * (patch.x_mm - 7.5) / ((patch.x_mm - 7.5) ** 2).mean()  # moment of 3 N mm
    low, high = (
        PatchCompliance(replace(plated, design=design), patch).electrodes_mm(force)
        for design, force in ((PLATED, shear), (thick, shear))
    )
    one, turned = 3.0, PatchCompliance(plated, patch).electrodes_mm(off)
    assert (high - low) * one == pytest.approx(turned, abs=1e-4 * np.abs(turned).max())


def test_a_ball_on_a_plate_s_middle_is_two_springs_in_series(plated: SurfaceCompliance):
    """δ = F c + √(F k / π R): the plate on the rubber, and its face of compliance k per area under a ball."""
    contact = press(plated, Sphere(10.0), 0.5, at_mm=(7.5, 0.0))
    force_n = contact.net_force_n[2]
    patch, even = on_right_plate(2)
    compliance = PatchCompliance(plated, patch)
    face = PLATED.pad.plate.face_mm_per_mpa
    c = compliance.moved_mm(even)[2].mean() - face / 144
    expected_mm = force_n * c + np.sqrt(force_n * face / np.pi / 10.0)
    assert expected_mm == pytest.approx(0.5, rel=5e-3)  # some ten cells touch
    assert contact.force_n[0, 0, 2] == 0.0
    expected = -force_n * compliance.electrodes_mm(even)
    assert (
        np.abs(contact.electrode_mm - expected).max() < 0.05 * np.abs(expected).max()
    )  # the plate turns a little, and the ball then rests beside its middle


def test_a_punch_over_the_gap_presses_both_plates_and_turns_them(plated: SurfaceCompliance):
    """Dragged to the end all of it slips."""
    contact = press(plated, Flat((8.0, 6.0)), 0.3, slide_mm=(1.5, 0.0), friction=0.3, cells=16)
    left, right = contact.force_n[0]
    assert left[2] > 10.0 < right[2]
    assert contact.net_force_n[0] == pytest.approx(0.3 * contact.net_force_n[2], rel=1e-2)
    assert contact.unit_moment_nmm[0, 0, 0] > 0 > contact.unit_moment_nmm[0, 1, 0]
    assert contact.gap_mm.min() > -2e-3 * contact.depth_mm


@pytest.mark.parametrize(
    ("pad", "low", "high"),
    [(Pad(kind="stiff"), -3.1, 4.2), (Pad(kind="stiff", size_mm=11.0, offset_x_mm=0.5), -7.0, 9.0)],
)
def test_grids_have_lines_at_the_edges_of_plates(pad: Pad, low: float, high: float):
    """They cover what is asked with at least as many cells, and meet edges to a fiftieth of a cell."""
    design = replace(PLATED, pad=pad)
    first, last, count = lined_grid(design, 0, low, high, 30)
    step = (last - first) / count
    assert first <= low < high <= last
    assert 0.4 < step * 30 / (high - low) <= 1.0
    places = [strip.low_mm for strip in slab_strips(design, 0, 0) if strip.is_plate and first < strip.low_mm < last]
    off = (np.array(places) - first) / step
    assert len(off)
    assert np.abs(off - np.rint(off)).max() < 0.05


def test_polynomials_between_tiles_end_at_plates_and_keep_moments():
    strips = slab_strips(PLATED, 0, 0)
    places = np.linspace(-14.9, 14.9, 61)
    found, tiles = shares(places, strips, 2)
    lines = edges(strips)[tiles.start : tiles.stop + 1]
    middles = (lines[:-1] + lines[1:]) / 2
    assert found.sum(axis=1) == pytest.approx(1.0)
    assert found @ middles == pytest.approx(places)
    on = [strip for strip in strips if strip.is_plate]
    beside = (middles < on[0].low_mm) | (middles > on[0].high_mm)
    inside = (places > on[0].low_mm) & (places < on[0].high_mm)
    assert not found[np.ix_(inside, beside)].any()
    assert sum(strip.tiles for strip in cell_strips(PLATED, 1)) == 7


def test_a_path_of_one_step_is_a_press_on_both_plates(plated: SurfaceCompliance):
    """On the stepper's own grid to its tolerance, and to estimates by a press, which looks farther for what touches."""
    ball, at_mm = Sphere(8.0), (0.5, 1.0)
    found = Stepper(plated, friction=0.0).step(ball, (*at_mm, -0.8))
    alike: dict = {"design": plated.design, "depth_mm": 0.8, "at_mm": at_mm, "slide_mm": (0.0, 0.0), "friction": 0.0}
    same, _ = pressed(Indentation(shape=ball, **alike), PatchCompliance(plated, found.patch), 1)
    expected = press(plated, ball, 0.8, at_mm=at_mm)
    assert min(expected.force_n[0, :, 2]) > 10.0
    same_n = found.patch.unit_loads(same.state.whole_n, plated.design.array)[..., :3]
    assert found.force_n == pytest.approx(same_n, abs=3e-3 * found.force_n.max())
    bound = found.error_estimate + expected.error_estimate
    assert np.linalg.norm(found.force_n - expected.force_n) < bound * np.linalg.norm(expected.force_n)


def test_there_and_back_friction_takes_its_work_and_forces_balance(plated: SurfaceCompliance):
    """A ball on a plate that gives by c is a spring before a brake: a loop of half length A takes 4 μF (A − c μF).

    What tiles pass on are the forces on faces and their moments about the middle of the array, at the rubber's top.
    """
    half_mm, friction = 0.6, 0.1
    stepper, there = Stepper(plated, friction=friction), half_mm * np.cos(np.linspace(0.0, 2 * np.pi, 17))
    for x in there[-5::2]:  # from the middle until all of it slips
        stepper.step(Sphere(8.0), (7.0 + x, 1.0, -0.4))
    contacts = [stepper.step(Sphere(8.0), (7.0 + x, 1.0, -0.4)) for x in there]
    pulls, last = np.array([contact.net_force_n for contact in contacts]), contacts[-1]
    patch, force, tiles = last.patch, last.cell_force_n * UP, last.tile_force_n
    share = force[2:] / force[2].sum()
    c = (PatchCompliance(plated, patch).moved_mm(share * np.array([1.0, 0.0, 0.0])[:, None, None])[0] * share).sum()
    slips_n = friction * pulls[:, 2].mean()
    assert np.trapezoid(pulls[:, 0], there) == pytest.approx(4 * slips_n * (half_mm - c * slips_n), rel=0.05)
    x, y = np.broadcast_arrays(patch.x_mm, patch.y_mm[:, None])
    columns, rows = ((lines[:-1] + lines[1:]) / 2 for lines in (edges(slab_strips(PLATED, k, 0)) for k in (0, 1)))
    tile_x, tile_y = np.broadcast_arrays(columns, rows[:, None])
    one, other = (
        np.concatenate([F.sum(axis=(1, 2)), np.cross(np.stack([*at], -1), np.moveaxis(F, 0, -1)).sum(axis=(0, 1))])
        for F, at in ((force, (x, y, 0 * x + PLATED.pad.plate.thickness_mm)), (tiles, (tile_x, tile_y, 0 * tile_x)))
    )
    assert one == pytest.approx(other, abs=1e-4 * np.abs(one).max())


def test_a_picture_of_a_contact_outlines_the_plates_that_it_shows(plated: SurfaceCompliance, tmp_path):
    """In array and contact alike, without widening what is shown; it is written whole."""
    contact = press(plated, Sphere(8.0), 0.3, at_mm=(7.5, 0.0), friction=0.3, cells=16)
    axes = Figure().subplots()
    axes.axis((5.0, 9.0, -2.0, 2.0))
    _outline(axes, pad_squares(PLATED), label="plates")
    pieces = np.ma.clump_unmasked(np.ma.masked_invalid(x := axes.lines[0].get_xdata()))
    assert [np.ptp(x[piece]) for piece in pieces] == pytest.approx([12.0, 12.0])
    assert axes.axis() == (5.0, 9.0, -2.0, 2.0)
    draw_contact(contact, tmp_path / "contact.png")
    assert (tmp_path / "contact.png").read_bytes().startswith(b"\x89PNG")


def assert_ngsolve_s(name: str, surface: SurfaceCompliance, tolerance: float) -> None:
    """Net force and wrenches, moments over half a plate, to a tolerance of the norm of all of them."""
    found, theirs = answer_of(surface, CASES[name]), by_ngsolve(name)
    assert found["net_n"][2] == pytest.approx(theirs["net_n"][2], rel=tolerance)
    missed, whole = (each * [1.0, 1 / 6.0, 1 / 6.0] for each in (found["wrench"] - theirs["wrench"], theirs["wrench"]))
    assert np.linalg.norm(missed) < tolerance * np.linalg.norm(whole)


@pytest.fixture(scope="module")
def coarse() -> SurfaceCompliance:
    """The peer's four plates on cells of level 1, which are too stiff by 2 to 3 %."""
    return coarse_surface(FOUR, 1, 4)


@pytest.mark.parametrize("name", CASES)
def test_presses_on_four_plates_are_ngsolve_s_but_for_coarse_cells(name: str, coarse: SurfaceCompliance):
    assert_ngsolve_s(name, coarse, 0.05)


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_presses_on_four_plates_are_ngsolve_s(name: str):
    assert_ngsolve_s(name, surface_compliance(FOUR)[0], 0.02)
