"""The design's defaults are the paper's sensor, and every nonsense value is refused in one clear line."""

from dataclasses import FrozenInstanceError, replace

import pytest

from geometry import Array, DesignError, Material, Pad, SensorDesign, TriPillarError, Unit
from geometry.mesh import MeshSettings


def test_defaults_are_the_papers_sensor():
    design = SensorDesign()
    assert (design.unit.span_mm, design.unit.height_mm, design.unit.pillar_width_mm) == (10.0, 10.0, 2.0)
    assert design.unit.electrode_mm == 2.0
    assert (design.array.rows, design.array.cols, design.array.pitch_mm) == (6, 6, 15.0)
    assert (design.pad.size_mm, design.pad.offset_x_mm, design.pad.offset_y_mm) == (12.0, 0.0, 0.0)
    assert design.pillar_material == design.matrix_material == Material(young_mpa=6.1, poisson=0.49)
    assert design.n_units == 36
    assert design.slab_mm == (90.0, 90.0, 10.0)
    assert design.is_homogeneous
    assert not SensorDesign(matrix_material=Material(young_mpa=1.0)).is_homogeneous
    assert Unit().footprint_mm == pytest.approx(10 + 2 * 2**0.5, rel=1e-15)


def test_slab_runs_cols_along_x_and_rows_along_y():
    design = SensorDesign(array=Array(rows=2, cols=3, pitch_mm=20.0))
    assert design.slab_mm == (60.0, 40.0, 10.0)


def test_lame_constants_are_those_of_hooke():
    """E = μ(3λ + 2μ)/(λ + μ) and ν = λ/(2(λ + μ)): the way back from λ and μ."""
    lam, mu = Material(young_mpa=6.1, poisson=0.49).lame_mpa
    assert mu * (3 * lam + 2 * mu) / (lam + mu) == pytest.approx(6.1, rel=1e-12)  # rounding, 1/(1 − 2ν) = 50
    assert lam / (2 * (lam + mu)) == pytest.approx(0.49, rel=1e-12)


def test_designs_are_frozen_values():
    with pytest.raises(FrozenInstanceError):
        SensorDesign().unit.span_mm = 3.0
    assert SensorDesign() == SensorDesign()
    assert hash(SensorDesign()) == hash(SensorDesign())


def test_whole_numbers_are_taken_for_lengths_and_kept_as_floats():
    """Or one design would have two hashes: 15 and 15.0."""
    assert repr(Array(pitch_mm=15)) == repr(Array(pitch_mm=15.0))


NAN, INF = float("nan"), float("inf")

POSITIVE = [
    *((Unit, name) for name in ("span_mm", "height_mm", "pillar_width_mm", "electrode_mm")),
    (Array, "pitch_mm"),
    (Pad, "size_mm"),
    (Material, "young_mpa"),
    (SensorDesign, "resistivity_ohm_mm"),
    *((MeshSettings, name) for name in ("edge_top_mm", "edge_base_mm", "envelope_mm")),
]
ANY_SIGN = [(Pad, "offset_x_mm"), (Pad, "offset_y_mm"), (Material, "poisson")]


def refusal(kind, **values) -> str:
    """The message with which a class refuses values: one line."""
    with pytest.raises(DesignError) as caught:
        kind(**values)
    assert isinstance(caught.value, TriPillarError)
    assert isinstance(caught.value, ValueError)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("value", [0, -1.0, -INF])
@pytest.mark.parametrize(("kind", "name"), POSITIVE)
def test_lengths_and_moduli_must_be_above_zero(kind, name, value):
    message = refusal(kind, **{name: value})
    assert message.startswith(f"{name}={value:g}" if value != -INF else f"{name}=-inf")
    assert ("must be above 0" if value != -INF else "must be a finite number") in message


@pytest.mark.parametrize("value", [NAN, INF, "2", True, None, [2.0], 10**400])
@pytest.mark.parametrize(("kind", "name"), POSITIVE + ANY_SIGN)
def test_what_is_no_finite_number_is_refused(kind, name, value):
    assert refusal(kind, **{name: value}).startswith(f"{name}={value!r} must be a finite number; ")


@pytest.mark.parametrize("name", ["rows", "cols"])
def test_counts_must_be_whole_numbers_above_zero(name):
    for value in (2.0, True, "2", NAN, None):
        message = refusal(Array, **{name: value})
        assert message.startswith(f"{name}={value!r} must be a whole number; units along ")
    for value in (0, -1):
        assert refusal(Array, **{name: value}).startswith(f"{name}={value} must be above 0")


def test_poissons_ratio_is_from_0_to_below_half():
    assert [Material(poisson=value).poisson for value in (0, 0.4999)] == [0.0, 0.4999]
    for value in (-0.01, 0.5, 0.51, 1.0):
        message = refusal(Material, poisson=value)
        assert message.startswith(f"poisson={value:g} must be from 0 to below 0.5")
        assert "write 0.49" in message


def test_pitch_below_the_unit_is_refused_with_the_least_allowed():
    message = refusal(SensorDesign, array=Array(pitch_mm=12.8))
    assert message.startswith("pitch_mm=12.8 is smaller than the unit")
    assert "raise pitch_mm to at least 12.83" in message
    least = Unit().footprint_mm
    assert SensorDesign(array=Array(pitch_mm=least)).array.pitch_mm == least  # pillars of two units may touch


def test_pads_may_touch_but_not_overlap():
    for pad in (Pad(size_mm=15.0), Pad(offset_x_mm=-1.5, offset_y_mm=1.5)):
        assert SensorDesign(pad=pad).pad == pad
    for pad in (Pad(size_mm=15.1), Pad(offset_x_mm=1.6), Pad(offset_x_mm=-1.6), Pad(offset_y_mm=1.6)):
        message = refusal(SensorDesign, pad=pad)
        assert message.startswith(f"pad size_mm={pad.size_mm:g}")
        assert "pads may touch, not overlap; shrink the pad or raise pitch_mm" in message


@pytest.mark.parametrize(
    "values", [{"span_mm": 2.02}, {"pillar_width_mm": 9.0}, {"span_mm": 10.0, "electrode_mm": 10.0}]
)
def test_merging_pillars_and_electrodes_are_refused(values):
    message = refusal(Unit, **values)
    assert message.startswith(f"span_mm={values.get('span_mm', 10.0):g} lets pillars or electrodes")
    assert "it must be above" in message
    assert "widen the span or thin the pillars" in message


def test_coarse_envelope_is_refused():
    message = refusal(MeshSettings, edge_top_mm=1.0, envelope_mm=0.11)
    assert message.startswith("envelope_mm=0.11 must be at most a tenth of the edges (1 and 5 mm)")


def test_every_check_also_runs_on_a_changed_copy():
    with pytest.raises(DesignError, match="pitch_mm=5 is smaller"):
        replace(SensorDesign(), array=Array(pitch_mm=5.0))
