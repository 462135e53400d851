"""The layer against its own differential equation, an even load, a Fourier sum, and finite elements."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import expm
from skfem import MeshTet

from fem.array.closed_forms import (
    HalfspaceError,
    decay_length_mm,
    halfspace_response,
    layer_mean_compliance,
    layer_response,
    layer_spectrum,
    mean_compliance,
)
from fem.discretization.elasticity import taylor_hood
from fem.discretization.patch import patch_integrals
from fem.linear.linear_solver import checked_solve, factorized
from geometry.design import Array, Material, SensorDesign

RUBBER = Material()
PAD = np.array([-6.0, -6.0, 6.0, 6.0])
PLACES = np.array(
    [[-6.0, -6.0, -4.0, -4.0], PAD, [6.0, 2.0, 8.0, 4.0], [20.0, -5.0, 23.0, -1.0], [9.0, 9.0, 21.0, 21.0]]
)


def halfspace_spectrum(poisson):
    """G k times the compliance of a half-space: transverse, longitudinal, normal, cross."""
    return np.array([1.0, 1 - poisson, 1 - poisson, (1 - 2 * poisson) / 2])[:, None]


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49, 0.4999])
def test_the_spectrum_solves_navier_s_equation_between_base_and_surface(nu):
    """Displacement and traction of one wave are carried from the base, where u = 0, by the exponential of a matrix.

    With k = G = 1, u = (i U, V, W) exp(i x), z into the body and t = (σ_xz/i, σ_yz, σ_zz), Hooke's law and equilibrium
    are d(u, t)/dz = M (u, t), no closed form assumed. At the surface z = 0 the load is −t.
    """
    lame = 2 * nu / (1 - 2 * nu)
    a, b = 1 / (lame + 2), lame / (lame + 2)
    M = np.zeros((6, 6))
    M[0, 2], M[0, 3] = -1.0, 1.0  # σ_xz = i (U' + W)
    M[1, 4] = 1.0  # σ_yz = V'
    M[2, 0], M[2, 5] = b, a  # σ_zz = (λ+2) W' − λ U
    M[3, 0], M[3, 5] = (lame + 2) - lame * b, -b  # t_x' + σ_xx = 0, σ_xx = λ W' − (λ+2) U
    M[4, 1] = 1.0  # t_y' = V
    M[5, 3] = 1.0  # σ_zz' + i σ_xz = 0
    for q in (0.01, 0.1, 0.5, 1.0, 2.0, 4.0):
        E = expm(-M * q)  # from base to surface: u(0) = E_ut t(h), t(0) = E_tt t(h)
        compliance = -E[:3, 3:] @ np.linalg.inv(E[3:, 3:])
        expected = [compliance[1, 1], compliance[0, 0], compliance[2, 2], compliance[0, 2]]
        spectrum = layer_spectrum([q], nu) + halfspace_spectrum(nu)
        assert np.allclose(spectrum[:, 0], expected, rtol=1e-8, atol=1e-13)  # exp(2·4) times rounding, and more
        assert np.allclose(compliance, compliance.T, rtol=1e-8, atol=1e-13)


@pytest.mark.parametrize("nu", [0.0, 0.49, 0.4999, 0.4999999])
def test_the_spectrum_tends_to_the_half_space_and_stays_finite(nu):
    """exp(−2q) with its polynomial: nothing at q = 30, no overflow at 1e5; at small q all that the half-space has."""
    assert np.abs(layer_spectrum([30.0, 300.0, 1e5], nu)).max() < 1e-22
    left = layer_spectrum([1e-6], nu) + halfspace_spectrum(nu)
    assert np.abs(left).max() < 2e-6
    longitudinal_and_normal = (layer_spectrum(np.geomspace(0.01, 10.0, 200), nu) + halfspace_spectrum(nu))[:3]
    assert (longitudinal_and_normal > 0).all()


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49, 0.4999])
def test_a_wide_load_shears_and_squeezes_the_layer_evenly(nu):
    """1 MPa all over: h/G along x and y, h/(λ+2G) along z, nothing across. 40 heights leave exp(−0.74·20) outside."""
    material = Material(poisson=nu)
    lame, G = material.lame_mpa
    wide, middle = np.array([-200.0, -200.0, 200.0, 200.0]), [-1.0, -3.0, 3.0, 2.0]
    moved = 400.0**2 * layer_mean_compliance(middle, wide, 10.0, material)
    assert np.allclose(moved, np.diag([10 / G, 10 / G, 10 / (lame + 2 * G)]), rtol=0, atol=1e-5 * 10 / G)


def test_the_mean_agrees_with_a_sum_over_waves():
    """Pads repeated every 20 heights have a discrete spectrum: product of sincs, no half-space, no quadrature.

    The sum stops at 12.6/mm, which lacks 3e-6 of a pad's own 8e-3 mm/N.
    """
    h, period, (_, G), nu = 10.0, 200.0, RUBBER.lame_mpa, RUBBER.poisson
    k = 2 * np.pi / period * np.arange(-400, 401)
    kx, ky = np.meshgrid(k, k, indexing="ij")
    length = np.hypot(kx, ky)
    length[400, 400] = 1e-3  # stands in for 0, an even load: 2e-8 off
    c, s = kx / length, ky / length
    c[400, 400] = 1.0
    t, a, n, x = (layer_spectrum(length * h, nu) + halfspace_spectrum(nu)[..., None]) / (G * length)
    cross = 1j * x  # along the wave, by a traction into the body; none by an even load
    cross[400, 400] = 0.0
    down = np.array([
        [a * c**2 + t * s**2, (a - t) * c * s, cross * c],
        [(a - t) * c * s, a * s**2 + t * c**2, cross * s],
        [-cross * c, -cross * s, n],
    ])  # fmt: skip
    sinc_pad = np.sinc(kx * 6.0 / np.pi) * np.sinc(ky * 6.0 / np.pi)
    flip = np.outer([1, 1, -1], [1, 1, -1])
    for target in PLACES:
        (x0, y0, x1, y1), half = target, (target[2:] - target[:2]) / 2
        waves = np.exp(1j * (kx * (x0 + x1) + ky * (y0 + y1)) / 2) * sinc_pad
        waves *= np.sinc(kx * half[0] / np.pi) * np.sinc(ky * half[1] / np.pi)
        summed = flip * np.einsum("ijab,ab->ij", down, waves) / period**2
        mean = layer_mean_compliance(target, PAD, h, RUBBER)
        assert np.abs(summed.imag).max() < 1e-12
        assert np.allclose(mean, summed.real, rtol=0, atol=4e-6)
        assert np.abs(mean).max() > 1e-4  # so that 4e-6 says something


def test_rectangles_obey_reciprocity_and_energy_is_positive():
    """As on the half-space; Gauss points of a pair are the same both ways, so to rounding."""
    compliance = layer_mean_compliance(PLACES[:, None], PLACES[None], 10.0, RUBBER)
    assert np.allclose(compliance, compliance.transpose(1, 0, 3, 2), rtol=0, atol=1e-14)
    assert np.linalg.eigvalsh(compliance.transpose(0, 2, 1, 3).reshape(15, 15)).min() > 0


def test_a_high_layer_is_a_half_space_and_a_far_place_is_still():
    """The base takes 1/height away, near enough a rigid motion; 40 heights away nothing is left but rounding."""
    closed = mean_compliance(PLACES, PAD, RUBBER)
    misfit = [np.abs(layer_mean_compliance(PLACES, PAD, h, RUBBER) - closed).max() for h in (1e3, 2e3)]
    assert misfit[0] < 0.02 * np.abs(closed).max()
    assert misfit[1] == pytest.approx(misfit[0] / 2, rel=0.02)
    for far in (29.0, 31.0, 40.0):
        still = layer_mean_compliance(PAD + 10.0 * far * np.array([1.0, 0.0, 1.0, 0.0]), PAD, 10.0, RUBBER)
        assert np.abs(still).max() < 1e-10 * np.abs(closed).max() * 10


def test_wide_pads_on_a_thin_layer_get_points_enough():
    """Pads of 12 mm on 1 mm, where the rest varies within a pad: a pad is still the sum of its quarters."""
    quarters = np.array([[-6, -6, 0, 0], [0, -6, 6, 0], [-6, 0, 0, 6], [0, 0, 6, 6]], dtype=float)
    target = [1.0, 2.0, 3.0, 4.0]
    whole = layer_mean_compliance(target, PAD, 1.0, RUBBER)
    parts = layer_mean_compliance(target, quarters, 1.0, RUBBER).mean(axis=0)
    assert np.allclose(whole, parts, rtol=0, atol=1e-6 * np.abs(whole).max())


def test_finite_elements_agree_on_a_wide_slab():
    """A slab of 80 × 80 × 10 mm, its sides 4 heights off: 3 % for a mesh with four edges across the load."""
    core = np.arange(-8.0, 9.0, 2.0)
    across = np.concatenate([[-40.0, -24.0, -14.0], core, [14.0, 24.0, 40.0]])
    mesh = MeshTet.init_tensor(across, across, np.array([0.0, 3.5, 6.0, 8.0, 10.0]))
    body = taylor_hood(mesh, [RUBBER], np.zeros(mesh.nelements, dtype=int))
    squares = np.array([[-4.0, -4.0, 4.0, 4.0], [4.0, -2.0, 8.0, 2.0], [-8.0, -8.0, -4.0, -4.0]])
    means = sp.kron(patch_integrals(body.basis, squares), sp.eye_array(3), format="csr")  # times area
    solution, _ = checked_solve(body.matrix, factorized(body.matrix), body.loads(means[:3].T.toarray() / 64.0))
    elements = (means @ body.displacements(solution)).reshape(3, 3, 3) / np.array([64.0, 16.0, 16.0])[:, None, None]
    layer = layer_mean_compliance(squares, squares[0], 10.0, RUBBER)
    for found, expected in zip(elements, layer, strict=True):
        assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)
    closed = mean_compliance(squares, squares[0], RUBBER)
    assert np.linalg.norm(elements - closed) > 0.3 * np.linalg.norm(elements)  # the half-space is no such answer


def test_response_is_symmetric_and_local():
    """Units are alike; far ones feel the half-space's 1/r but not the layer's exponential."""
    design = SensorDesign(array=Array(rows=2, cols=6))
    layer, halfspace = layer_response(design), halfspace_response(design)
    assert layer.influence_mm_per_n.shape == (2, 6, 2, 3, 2, 6, 3)
    assert (layer.method, halfspace.method) == ("layer", "halfspace")
    assert np.array_equal(layer.influence_mm_per_n[0, 0, ..., 0, 1, :], layer.influence_mm_per_n[1, 4, ..., 1, 5, :])
    ratio = {
        name: np.linalg.norm(response.influence_mm_per_n[0, 5, ..., 0, 0, :])
        / np.linalg.norm(response.influence_mm_per_n[0, 0, ..., 0, 0, :])
        for name, response in (("layer", layer), ("halfspace", halfspace))
    }
    assert ratio["layer"] < 2e-3
    assert ratio["halfspace"] > 0.05
    stiffer = replace(design, matrix_material=Material(young_mpa=12.2))
    assert np.allclose(2 * layer_response(stiffer).influence_mm_per_n, layer.influence_mm_per_n, rtol=1e-12)


def test_a_rectangle_too_wide_for_its_layer_is_refused_before_memory_runs_out():
    with pytest.raises(HalfspaceError, match=r"1\.2e\+03 heights wide, at most 100 are allowed: split it"):
        layer_mean_compliance(PAD, PAD, 0.01, RUBBER)


@pytest.mark.parametrize("height_mm", [0.0, -1.0, np.nan])
def test_a_layer_without_height_is_refused(height_mm):
    with pytest.raises(HalfspaceError, match="must be above 0: the layer's thickness"):
        layer_mean_compliance(PAD, PAD, height_mm, RUBBER)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49, 0.4999])
def test_far_from_a_load_the_surface_falls_as_its_decay_length_says(nu):
    """u √r falls by e over λ; 10 to 11 heights away the next term of K₀(r/λ) changes that by 1/(8 (r/λ)²) < 0.3 %."""
    material, r = Material(young_mpa=6.1, poisson=nu), np.array([100.0, 110.0])
    squares = np.column_stack([r - 1, -np.ones(2), r + 1, np.ones(2)])
    u = layer_mean_compliance(squares, PAD, 10.0, material)[:, 2, 2]
    measured = -np.diff(r) / np.diff(np.log(np.abs(u) * np.sqrt(r)))
    assert measured[0] == pytest.approx(decay_length_mm(10.0, nu), rel=3e-3)


def test_the_decay_length_of_what_cannot_be_compressed():
    """cos x = x has the root 0.7390851332; λ is a length, so it grows with the height."""
    assert decay_length_mm(1.0, 0.5 - 1e-9) == pytest.approx(1 / 0.7390851332, rel=1e-8)
    assert decay_length_mm(7.0, 0.4) == pytest.approx(7 * decay_length_mm(1.0, 0.4))
