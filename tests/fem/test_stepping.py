"""Contact step by step is contact at once, and what friction remembers; shapes that turn in space."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fem.contact import (
    Capsule,
    ContactError,
    Convex,
    Cylinder,
    Flat,
    Shape,
    ShapeError,
    Sphere,
    Stepper,
    SurfaceCompliance,
    about_z,
    press,
)
from fem.contact.compliance import PatchCompliance
from fem.contact.surface import endless_surface
from geometry.design import Array, SensorDesign

BALL_MM, DEPTH_MM, FRICTION = 8.0, 0.6, 0.5
BOX_MM = np.array([[x, y, z] for x in (-4.0, 4.0) for y in (-3.0, 3.0) for z in (0.0, 5.0)])


def turned(*angles_rad: float) -> np.ndarray:
    return Rotation.from_rotvec(angles_rad).as_matrix()


def moved(stepper: Stepper, shape: Shape, *path_mm):
    """The contact after a shape went straight from place to place, in ten steps each."""
    for start, end in pairwise(path_mm):
        for share in np.linspace(0.1, 1.0, 10):
            contact = stepper.step(shape, np.array(start) + share * np.subtract(end, start))
    return contact


@pytest.mark.parametrize(
    ("shape", "at_mm", "slide_mm"),
    [(Flat((6.0, 4.0), turn=about_z(20.0)), (-5.0, 1.0), (0.0, 0.4)), (Sphere(5.0), (13.0, 3.0), (0.3, 0.2))],
    ids=["punch", "beside the rim"],
)
def test_small_steps_end_where_the_press_does(pair: SurfaceCompliance, shape: Shape, at_mm, slide_mm):
    """Within 5 % of the units' forces, and within its own estimate of them and of the electrodes."""
    expected = press(pair, shape, DEPTH_MM, at_mm=at_mm, slide_mm=slide_mm, friction=FRICTION)
    end_mm = (*np.add(at_mm, slide_mm), -DEPTH_MM)
    contact = moved(Stepper(pair, friction=FRICTION), shape, (*at_mm, 0.0), (*at_mm, -DEPTH_MM), end_mm)
    for name, estimate in (("force_n", contact.error_estimate), ("electrode_mm", contact.electrode_error_estimate)):
        one, other = getattr(contact, name), getattr(expected, name)
        missed = np.linalg.norm(one - other) / np.linalg.norm(other)
        assert missed < estimate + expected.error_estimate, name
        assert name != "force_n" or missed < 0.05


def test_a_ball_slides_with_all_its_friction_rolls_with_none_and_spins_with_a_torque(pair: SurfaceCompliance):
    """The torque is 3π/16 μ P a where all of a Hertzian contact slips; a ball that rolls leaves the shear it had."""
    found, low = {}, BALL_MM - DEPTH_MM
    for name in ("slides", "rolls", "spins"):
        stepper = Stepper(pair, friction=FRICTION)
        moved(stepper, Capsule(BALL_MM), (-5.0, 0.0, BALL_MM), (-5.0, 0.0, low))
        for way in np.arange(0.1, 6.05 if name == "rolls" else 3.05, 0.1):
            turn = {"slides": turned(0, 0, 0), "rolls": turned(0, way / low, 0), "spins": turned(0, 0, way)}[name]
            contact = stepper.step(Capsule(BALL_MM, turn=turn), (-5.0 + way * (name != "spins"), 0.0, low))
        found[name] = contact
    (slide_x, _, slide_z), (roll_x, _, roll_z) = found["slides"].net_force_n, found["rolls"].net_force_n
    assert slide_x == pytest.approx(FRICTION * slide_z, rel=1e-2)
    assert abs(roll_x) < 0.03 * roll_z
    spun = found["spins"]
    (x, y), (fx, fy, fz) = spun.centre_mm, spun.net_force_n
    torque = spun.moment_nmm[2] - (x * fy - y * fx)
    radius_mm = np.sqrt(spun.area_mm2 / np.pi)
    assert torque == pytest.approx(3 * np.pi / 16 * FRICTION * fz * radius_mm, rel=0.05)


def test_it_goes_as_deep_as_a_force_takes_and_forgets_what_has_gone(pair: SurfaceCompliance):
    stepper = Stepper(pair, friction=FRICTION)
    for wanted in (5.0, 40.0):
        contact = stepper.step(Capsule(BALL_MM), (1.0, 2.0, 0.0), normal_n=wanted)
        assert contact.net_force_n[2] == pytest.approx(wanted, rel=0.01)
    deep = contact.depth_mm
    assert stepper.step(Capsule(BALL_MM), (1.0, 2.0, BALL_MM + 1.0)) is None
    anew, other = (one.step(Capsule(BALL_MM), (6.0, 2.0, BALL_MM - deep)) for one in (stepper, Stepper(pair)))
    assert np.array_equal(anew.cell_force_n, other.cell_force_n)


@pytest.mark.parametrize(
    ("place_mm", "force_n", "told"),
    [
        ((0.0, np.nan, 0.0), None, "three finite numbers"),
        ((0.0, 0.0, -5.0), None, "less than the slab's height"),
        ((0.0, 0.0, 0.0), -1.0, "normal_n=-1 must be"),
        ((100.0, 0.0, 0.0), 5.0, "at no depth"),
    ],
)
def test_steps_that_cannot_be_are_refused(pair: SurfaceCompliance, place_mm, force_n, told):
    with pytest.raises(ContactError, match=told):
        Stepper(pair).step(Capsule(BALL_MM), place_mm, force_n)


def test_a_long_narrow_top_is_stepped_over_as_pressed(monkeypatch: pytest.MonkeyPatch):
    """Its coarsest grids have one cell across; on an endless layer, within both estimates. Electrodes are not asked."""
    monkeypatch.setattr("fem.contact.surface.STEPS_PER_ELECTRODE", 2)
    surface = endless_surface(SensorDesign(array=Array(rows=1, cols=8)))
    found, expected = (
        Stepper(surface, friction=0.0).step(Sphere(5.0), (0.0, 0.0, -0.5)),
        press(surface, Sphere(5.0), 0.5),
    )
    missed = np.linalg.norm(found.force_n - expected.force_n) / np.linalg.norm(expected.force_n)
    assert missed < found.error_estimate + expected.error_estimate


@pytest.mark.parametrize(
    ("place_mm", "force_n"), [((1.0, 0.0, 0.0), 1e5), ((100.0, 0.0, 0.0), 5.0), ((1.0, 0.0, -3.0), None)]
)
def test_a_refused_step_leaves_the_shape_where_it_was(pair: SurfaceCompliance, place_mm, force_n):
    """To the last bit: the next step is one from there, with all that friction remembers."""
    refused, other = (Stepper(pair, friction=FRICTION) for _ in range(2))
    for stepper in (refused, other):
        moved(stepper, Capsule(BALL_MM), (0.0, 0.0, BALL_MM), (0.0, 0.0, BALL_MM - DEPTH_MM))
    with pytest.raises(ContactError):
        refused.step(Capsule(BALL_MM), place_mm, force_n)
    one, another = (each.step(Capsule(BALL_MM), (0.1, 0.0, BALL_MM - DEPTH_MM)) for each in (refused, other))
    assert np.array_equal(one.cell_force_n, another.cell_force_n)
    assert one.net_force_n[0] > 0.01 * one.net_force_n[2]


def test_turned_shapes_are_what_they_are_made_of():
    """A bar lies along its turn from x towards y; a capsule is balls along a line, a convex body the space below all of
    its faces."""
    end = 3.9 * np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    bar = Cylinder(1.0, 8.0, turn=about_z(30.0))
    assert bar.heights_mm(end[0], end[1] * np.array([1.0, -1.0])) == pytest.approx([0.0, np.inf], abs=1e-12)
    assert bar.half_extents_mm(2.0) == pytest.approx((4 * end[0] / 3.9 + 0.5, 2 + end[0] / 3.9), abs=1e-12)
    x, y = np.meshgrid(np.linspace(-6.1, 6.1, 25), np.linspace(-6.1, 6.1, 25))
    for turn in (np.eye(3), turned(0, np.pi / 2, 0), turned(0.3, -0.8, 0.4)):
        capsule = Capsule(3.0, 7.0, turn=turn)
        cx, cy, cz = turn[:, 2, None] * np.linspace(-3.5, 3.5, 2001)
        square = 9.0 - (x[..., None] - cx) ** 2 - (y[..., None] - cy) ** 2
        lower = np.where(square >= 0, cz - np.sqrt(np.maximum(square, 0)), np.inf).min(axis=-1) - capsule.lowest_mm
        heights = capsule.heights_mm(x, y)
        assert np.nan_to_num(heights, posinf=-99) == pytest.approx(np.nan_to_num(lower, posinf=-99), abs=1e-4)
    body = Convex.hull(BOX_MM)
    tipped = Convex(body.corners_mm, body.faces, turn=turned(0, 0.1, 0))
    heights = tipped.heights_mm(x, y)
    inside = np.isfinite(heights)
    points = np.stack([x, y, heights + tipped.lowest_mm], axis=-1)[inside] @ tipped.turn
    assert (np.abs(points[:, :2]) <= (4 + 1e-9, 3 + 1e-9)).all()
    assert (np.minimum(np.abs(points[:, 2]), np.abs(points[:, 0] - 4)) < 1e-9).all()  # below or at the low side
    assert heights.min() == pytest.approx(0.0, abs=0.06)
    with pytest.raises(ShapeError, match="no volume"):
        Convex.hull(BOX_MM[:, :2] @ np.eye(2, 3))
    with pytest.raises(ShapeError, match="turns about z alone"):
        Flat((6.0, 4.0), turn=turned(0.1, 0.0, 0.0))


def test_a_small_step_takes_few_products_on_one_grid_after_the_other(
    pair: SurfaceCompliance, monkeypatch: pytest.MonkeyPatch
):
    """Of a bar that is too long for a finer grid and narrow for a coarse one; counted, since clocks tell of machines.

    Steps begun from the last state, not where it leads, take nearly 9 products on average.
    """
    products, cells_mm = [], []
    give = PatchCompliance.pressed_mm
    monkeypatch.setattr(PatchCompliance, "pressed_mm", lambda self, force: products.append(1) or give(self, force))
    stepper, bar = Stepper(pair, friction=FRICTION), Cylinder(11.0, 11.4, turn=about_z(84.0))
    for depth_mm in np.arange(1, 81) * 0.01:
        cells_mm.append(stepper.step(bar, (-5.0, 0.0, -depth_mm)).patch.cell_mm[0])
    assert len(products) < 7 * len(cells_mm)
    assert (np.diff(cells_mm) >= 0).all()
