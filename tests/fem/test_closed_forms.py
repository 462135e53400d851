"""The layer, half-space included, against its differential equation, a Fourier sum and reciprocity."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.lib.array_utils import byte_bounds
from scipy.linalg import expm

from fem.array.closed_forms import (
    HalfspaceError,
    layer_mean_compliance,
    layer_response,
    layer_spectrum,
)
from fem.array.response import read_response, write_response
from geometry.design import Array, Material, Pad, SensorDesign
from geometry.layout import electrode_squares, pad_squares

RUBBER = Material(young_mpa=6.1, poisson=0.3)
PAD = np.array([-6.0, -6.0, 6.0, 6.0])
PLACES = np.array(
    [[-6.0, -6.0, -4.0, -4.0], PAD, [6.0, 2.0, 8.0, 4.0], [20.0, -5.0, 23.0, -1.0], [9.0, 9.0, 21.0, 21.0]]
)


def test_the_response_holds_every_pair_of_electrode_and_pad(tmp_path):
    """Unequal rows and columns, a shifted pad, no symmetry to hide a mistaken index behind; its file gives it back."""
    design = SensorDesign(array=Array(rows=2, cols=3), pad=Pad(size_mm=8.0, offset_x_mm=1.0, offset_y_mm=-2.0))
    material = design.matrix_material
    given = replace(layer_response(design), residual=1e-14, unknowns=7, seconds={"condense": 1.5}, error_estimate=5e-4)
    write_response(given, tmp_path / "r.nc")
    found = read_response(tmp_path / "r.nc")
    influence = found.influence_mm_per_n
    for name in ("design", "method", "residual", "unknowns", "seconds", "error_estimate", "mesh_hash", "content_hash"):
        assert getattr(found, name) == getattr(given, name)
    height_mm = design.unit.height_mm
    pairs = layer_mean_compliance(electrode_squares(design)[:, None], pad_squares(design), height_mm, material)
    direct = pairs.reshape(2, 3, 2, 2, 3, 3, 3).transpose(0, 1, 2, 5, 3, 4, 6)
    assert influence.shape == (2, 3, 2, 3, 2, 3, 3)
    assert np.allclose(influence, direct, rtol=0, atol=1e-13 * np.abs(direct).max())
    large = layer_response(SensorDesign(array=Array(rows=24, cols=24))).influence_mm_per_n
    low, high = byte_bounds(large)
    assert high - low < 5e5 < 4e7 < large.nbytes  # a view of 47 × 47 offsets


def test_what_has_no_answer_is_refused_by_name():
    """Rectangles without area, or so wide for their layer that memory would run out; a layer without height."""
    for target, height_mm, says in (
        ([0.0, 0.0, 0.0, 1.0], 1.0, "a rectangle is empty"),
        (PAD[:3], 1.0, r"shape \(3,\), expected \(\.\.\., 4\)"),
        (PAD, 0.01, r"1\.2e\+03 heights wide, at most 100 are allowed: split it"),
        (PAD, np.nan, "must be above 0: the layer's thickness"),
    ):
        with pytest.raises(HalfspaceError, match=says):
            layer_mean_compliance(target, PAD, height_mm, RUBBER)


def halfspace_spectrum(poisson):
    """G k times the compliance of a half-space: transverse, longitudinal, normal, cross."""
    return np.array([1.0, 1 - poisson, 1 - poisson, (1 - 2 * poisson) / 2])[:, None]


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.4999])
def test_the_spectrum_solves_navier_s_equation_between_base_and_surface(nu):
    """With k = G = 1, u = (i U, V, W) exp(i x) and t = (σ_xz/i, σ_yz, σ_zz), it says d(u, t)/dz = M (u, t)."""
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
    assert np.abs(layer_spectrum([30.0, 300.0, 1e5], nu)).max() < 1e-22  # the half-space, and no overflow


def test_rectangles_obey_reciprocity_and_energy_is_positive():
    """Betti: mean over B by a load on A is the transpose of that over A by B; any forces do positive work."""
    compliance = layer_mean_compliance(PLACES[:, None], PLACES[None], 10.0, RUBBER)
    assert np.allclose(compliance, compliance.transpose(1, 0, 3, 2), rtol=0, atol=1e-14)
    assert np.linalg.eigvalsh(compliance.transpose(0, 2, 1, 3).reshape(15, 15)).min() > 0


@pytest.mark.parametrize("rubber", [Material(), RUBBER], ids=["ν = 0.49", "ν = 0.3"])
def test_the_mean_agrees_with_a_sum_over_waves(rubber):
    """Pads repeated every 20 heights; the sum stops at 12.6/mm, which lacks 3e-6 of a pad's own 8e-3 mm/N."""
    h, period, (_, G), nu = 10.0, 200.0, rubber.lame_mpa, rubber.poisson
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
        mean = layer_mean_compliance(target, PAD, h, rubber)
        assert np.allclose(mean, summed, rtol=0, atol=4e-6)
