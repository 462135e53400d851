"""Contact by shape against closed forms, and its compliance against the array's response."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fem.array.solving import ResponseSettings, array_response
from fem.contact import (
    Contact,
    ContactError,
    Cylinder,
    Flat,
    ShapeError,
    Solid,
    Sphere,
    SurfaceCompliance,
    press,
    read_solid,
    surface_compliance,
)
from fem.contact.indentation import FREE, STICKING
from fem.contact.patch import Patch, PatchCompliance, tile_integrals
from geometry.design import Array, Material, SensorDesign, Unit
from geometry.errors import DesignError
from geometry.layout import FloatArray, pad_squares

THICK_MM = 2000.0
DEPTH, RADIUS = 0.01, 10.0
A_MM = np.sqrt(RADIUS * DEPTH)


def half_space(poisson: float) -> SurfaceCompliance:
    """A unit on so thick and wide a slab that neither its base nor its sides are felt."""
    rubber = Material(poisson=poisson)
    design = SensorDesign(
        unit=Unit(height_mm=THICK_MM), array=Array(rows=1, cols=1, pitch_mm=THICK_MM), pillar_material=rubber,
        matrix_material=rubber,
    )  # fmt: skip
    rest = np.zeros((3, 3, 3, 3, 3, 3), dtype=np.float32)
    electrodes = np.zeros((1, 1, 2, 3, 3, 3, 3), dtype=np.float32)
    table = np.zeros((3, 3, 3, 3))
    return SurfaceCompliance(design=design, on_tiles=rest, on_electrodes=electrodes, table=table, step_mm=THICK_MM / 2)


@pytest.fixture(scope="module")
def pair() -> SurfaceCompliance:
    """The paper's unit twice, 1 × 2."""
    return surface_compliance(SensorDesign(array=Array(rows=1, cols=2)))[0]


def test_sphere_on_a_half_space_is_hertz():
    """F = 4/3 E* √R δ^1.5, a = √(R δ), p₀ = 2 E*/π √(δ/R): the bar is 1 %."""
    contact = press(half_space(0.3), Sphere(RADIUS), DEPTH)
    E = 6.1 / (1 - 0.3**2)
    assert contact.net_force_n[2] == pytest.approx(4 / 3 * E * np.sqrt(RADIUS) * DEPTH**1.5, rel=2e-3)
    assert np.sqrt(contact.area_mm2 / np.pi) == pytest.approx(A_MM, rel=1e-2)
    assert contact.peak_mpa == pytest.approx(2 * E / np.pi * np.sqrt(DEPTH / RADIUS), rel=2e-3)


def test_round_punch_on_a_half_space_is_boussinesq():
    """F = 2 a E* δ; a grid's disc is right to a part of a cell."""
    contact = press(half_space(0.3), Flat(radius_mm=1.0), DEPTH)
    assert contact.net_force_n[2] == pytest.approx(2 * 6.1 / (1 - 0.3**2) * DEPTH, rel=1e-2)


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_dragged_sphere_slips_outside_the_circle_of_cattaneo_and_mindlin(share: float):
    """c/a = (1 − Q/μP)^(1/3) and its displacement; ν = 0.5 uncouples normal and tangential forces."""
    nu, friction = 0.4999, 0.5
    G = 6.1 / 2 / (1 + nu)
    P = 4 / 3 * 6.1 / (1 - nu**2) * np.sqrt(RADIUS) * DEPTH**1.5
    slide = 3 * friction * P * (2 - nu) / (16 * G * A_MM) * (1 - (1 - share) ** (2 / 3))
    contact = press(half_space(nu), Sphere(RADIUS), DEPTH, slide_mm=(slide, 0.0), friction=friction)
    fx, fy, fz = contact.net_force_n
    assert fx / (friction * fz) == pytest.approx(share, rel=1e-2)
    assert abs(fy) < 1e-3 * fx
    sticking = (contact.state == STICKING).sum() / (contact.state != FREE).sum()
    assert np.sqrt(sticking) == pytest.approx((1 - share) ** (1 / 3), abs=0.02)  # a cell is 0.04 of the radius


def test_full_slide_obeys_coulomb_everywhere():
    contact = press(half_space(0.3), Sphere(RADIUS), DEPTH, slide_mm=(0.03, 0.04), friction=0.4)
    limit = 0.4 * contact.cell_force_n[2]
    size = np.hypot(*contact.cell_force_n[:2])
    assert (contact.state != STICKING).all()
    assert size == pytest.approx(limit, rel=1e-6, abs=1e-12)
    assert contact.net_force_n[:2] == pytest.approx(0.4 * contact.net_force_n[2] * np.array([0.6, 0.8]), rel=1e-2)


def on_pads(surface: SurfaceCompliance, pad: int, axis: int) -> tuple[PatchCompliance, FloatArray]:
    """A newton spread evenly over a pad, on a grid of just that pad."""
    x0, y0, x1, y1 = pad_squares(surface.design)[pad]
    patch = Patch((x0, y0), (x1, y1), 24, 24)
    force = np.zeros((3, 24, 24))
    force[axis] = 1 / 24**2
    return PatchCompliance(surface, patch), force


def test_electrodes_move_as_in_the_array_s_response(pair: SurfaceCompliance, shared_cache: None):
    """A pad's uniform traction by two routes; 1.5 mm from a rim tiles err by 1.5 %, the layer alone by 40 %."""
    response, _, _ = array_response(pair.design, ResponseSettings(tolerance=1e-2))
    for axis in range(3):
        compliance, force = on_pads(pair, 1, axis)
        expected = response.influence_mm_per_n[..., 0, 1, axis]
        assert np.abs(compliance.electrodes_mm(force) - expected).max() < 0.02 * np.abs(expected).max()


def test_forces_and_displacements_are_reciprocal(pair: SurfaceCompliance):
    """f·u(g) = g·u(f), rims and couplings included; to single precision."""
    patch = Patch((-12.0, -7.5), (15.0, 5.0), 20, 12)
    compliance = PatchCompliance(pair, patch)
    f, g = np.random.default_rng(0).normal(size=(2, 3, 12, 20))
    one, other = (f * compliance.moved_mm(g)).sum(), (g * compliance.moved_mm(f)).sum()
    assert one == pytest.approx(other, rel=1e-5)
    alone = np.zeros((3, 12, 20))
    alone[2] = f[2]
    assert compliance.moved_mm(f[2:]) == pytest.approx(compliance.moved_mm(alone)[2:], rel=1e-5)


def test_units_share_the_whole_force(pair: SurfaceCompliance):
    contact = press(pair, Sphere(8.0), 1.0, at_mm=(1.0, 0.5), slide_mm=(0.2, 0.1), friction=0.5)
    assert contact.force_n.sum(axis=(0, 1)) == pytest.approx(contact.net_force_n, rel=1e-9)
    assert (contact.force_n[0, :, 2] > 0).all()
    patch = Patch((-3.0, -1.0), (3.0, 1.0), 3, 1)  # the middle cell lies on the border
    shares = tile_integrals(patch, np.ones((3, 1, 3)), 1, 2, 15.0)
    assert shares[0, :, 2].tolist() == [1.5, 1.5]


def test_mirrored_contacts_are_mirror_images(pair: SurfaceCompliance):
    """At the rim as well, and where a part of the shape hangs over."""
    left, right = (
        press(pair, Sphere(6.0), 1.0, at_mm=(x, 2.0), slide_mm=(x / 100, 0.1), friction=0.4) for x in (-14.0, 14.0)
    )
    assert left.net_force_n * [-1, 1, 1] == pytest.approx(right.net_force_n, rel=1e-3)
    assert left.centre_mm * [-1, 1] == pytest.approx(right.centre_mm, rel=1e-3)


def test_no_gap_is_negative_and_pressure_is_where_it_is_closed(pair: SurfaceCompliance):
    contact = press(pair, Cylinder(5.0, 8.0, 30.0), 0.5)
    touches = contact.state != FREE
    assert contact.gap_mm.min() > -1e-3 * contact.depth_mm
    assert np.abs(contact.gap_mm[touches]).max() < 1e-3 * contact.depth_mm
    assert (contact.cell_force_n[2] >= 0).all()


def test_friction_stiffens_a_thin_slab_that_cannot_flow_out(pair: SurfaceCompliance):
    """Normal and tangential forces couple through the base."""
    free, rough = (press(pair, Flat((14.0, 14.0)), 0.3, friction=mu).net_force_n[2] for mu in (0.0, 1.0))
    assert rough > 1.05 * free


def test_stl_of_a_box_is_a_flat_punch(pair: SurfaceCompliance, tmp_path: Path):
    path = tmp_path / "box.stl"
    trimesh.creation.box((6.0, 4.0, 3.0)).export(path)
    by_file, by_size = (press(pair, shape, 0.4) for shape in (read_solid(path), Flat((6.0, 4.0))))
    assert by_file.net_force_n[2] == pytest.approx(by_size.net_force_n[2], rel=1e-6)


def test_stl_that_is_not_closed_or_none_is_refused(tmp_path: Path):
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
    ],
)
def test_contacts_that_cannot_be_are_refused(pair: SurfaceCompliance, changes: dict, told: str):
    with pytest.raises(ContactError, match=told):
        press(pair, Sphere(5.0), **{"depth_mm": 1.0, **changes})


def test_sensors_that_it_is_no_model_of_are_refused():
    soft = SensorDesign()
    stiff = replace(soft, pad=replace(soft.pad, kind="stiff"))
    large = replace(soft, array=replace(soft.array, rows=20))
    for design, told in ((stiff, "stiff plates"), (large, "too many")):
        with pytest.raises(DesignError, match=told):
            surface_compliance(design)
    with pytest.raises(ShapeError, match="radius_mm=0"):
        Sphere(0.0)


def test_height_map_is_empty_outside_its_box():
    solid = Solid(np.array([-1.0, 1.0]), np.array([-1.0, 1.0]), np.zeros((2, 2)))
    assert np.isinf(solid.heights_mm(np.array([1.5]), np.array([0.0]))).all()


def test_moment_is_that_of_the_force_at_the_centre_of_pressure(pair: SurfaceCompliance):
    contact: Contact = press(pair, Sphere(5.0), 0.5, at_mm=(4.0, -2.0))
    x, y = contact.centre_mm
    assert contact.moment_nmm == pytest.approx(np.array([-y, x, 0.0]) * contact.net_force_n[2], rel=1e-6)
