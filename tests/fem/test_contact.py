"""Contact by shape against closed forms and NGSolve, and its compliance against the array's response."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

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
    press,
    read_solid,
)
from fem.contact.indentation import OPEN, STICK
from fem.contact.surface import PatchCompliance
from fem.contact.tiles import Patch
from geometry.design import Array, Material, SensorDesign, Unit
from geometry.layout import pad_squares

DEPTH, RADIUS = 0.01, 10.0
A_MM = np.sqrt(RADIUS * DEPTH)


def endless(poisson: float, height_mm: float = 2000.0) -> SurfaceCompliance:
    """A layer on a slab so wide that its sides are not felt; a half-space unless it is thin."""
    rubber, wide = Material(poisson=poisson), 2000.0
    unit, array = Unit(height_mm=height_mm), Array(rows=1, cols=1, pitch_mm=wide)
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
    """Axially symmetric, by `python -m studies.bench.peers.contact`."""
    contact = press(endless(0.49, 10.0), Sphere(10.0), 1.5)
    error = abs(contact.net_force_n[2] / 104.255 - 1)
    assert error < min(1.5e-3, contact.error_estimate)
    assert contact.error_estimate < 0.01
    assert (np.sqrt(contact.area_mm2 / np.pi), contact.peak_mpa) == pytest.approx((4.392, 2.4944), rel=1e-2)


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
