"""The design's defaults are the paper's sensor, and every nonsense value is refused in one clear line."""

import re
import reprlib
from dataclasses import fields, replace

import pytest

from geometry import Array, DesignError, Electrics, Material, Pad, SensorDesign, TriPillarError, Unit
from geometry.mould import Mould

NAN = float("nan")


def test_defaults_are_the_papers_sensor():
    design = SensorDesign()
    unit, array, pad = design.unit, design.array, design.pad
    assert (unit.span_mm, unit.height_mm, unit.pillar_width_mm, unit.electrode_mm) == (10.0, 10.0, 2.0, 2.0)
    assert (array.rows, array.cols, array.pitch_mm) == (6, 6, 15.0)
    assert (pad.size_mm, pad.offset_x_mm, pad.offset_y_mm) == (12.0, 0.0, 0.0)
    assert design.pillar_material == design.matrix_material == Material(young_mpa=6.1, poisson=0.49)
    assert (design.n_units, design.slab_mm, design.is_homogeneous) == (36, (90.0, 90.0, 10.0), True)
    assert not SensorDesign(matrix_material=Material(young_mpa=1.0)).is_homogeneous
    assert unit.footprint_mm == pytest.approx(10 + 2 * 2**0.5, rel=1e-15)  # at 45°, but for rounding
    # cols run along x, rows along y
    assert SensorDesign(array=Array(rows=2, cols=3, pitch_mm=20.0)).slab_mm == (60.0, 40.0, 10.0)


KINDS = (Unit, Array, Pad, Material, Electrics, SensorDesign, Mould)


def nonsense(spec):
    """Values that a field refuses by its type and bound, and what is said of each after ``name=value``."""
    number, wrong = ("whole", (2.0,)) if spec.type is int else ("finite", (NAN, [2.0], 10**400))
    if spec.type in (int, float):
        yield from ((value, f" must be a {number} number; {spec.metadata['meaning']}") for value in (*wrong, "2", True))
    if spec.metadata.get("above 0"):
        yield 0, f" must be above 0; {spec.metadata['meaning']}"
    if within := spec.metadata.get("within"):
        said = f" must be from {within[0]:g} to {within[1]:g}; {spec.metadata['meaning']}"
        yield from ((value, said) for value in (within[0] - 1, within[1] + 1))
    if spec.metadata.get("of"):
        yield from ((value, f" must be one of {', '.join(spec.metadata['of'])}") for value in ("ogden", ["linear"]))


#: (kind, field, value, what is said): of every field that states a bound; `cad` is given them by file, too
BOUNDED = [(kind, spec.name, *each) for kind in KINDS for spec in fields(kind) for each in nonsense(spec)]
OFF = "pad size_mm={}.*pads may touch, not overlap; shrink the pad or raise pitch_mm"
OFFSETS = ({"offset_x_mm": -1.6}, {"offset_y_mm": 1.6})
MERGED = "span_mm={} lets {} of a unit merge: it must be above .*; widen the span, thin them or part their places"
REFUSED = [
    *((kind, {name: value}, re.escape(f"{name}={reprlib.repr(value)}{says}")) for kind, name, value, says in BOUNDED),
    (Material, {"poisson": 0.5}, "poisson=0.5 must be from 0 to below 0.5.*write 0.49"),
    (Electrics, {"elastoresistance_across": 1.0}, "eq. 1 has no elastoresistance"),
    (Unit, {"span_mm": 2.02}, MERGED.format("2.02", "pillars z and x")),
    (Unit, {"electrode_mm": 10.0}, MERGED.format(10, "electrodes L1 and L2")),
    (SensorDesign, {"array": Array(pitch_mm=12.8)}, "pitch_mm=12.8 is smaller than the unit.*to at least 12.83"),
    (SensorDesign, {"pad": Pad(size_mm=15.1)}, OFF.format(15.1)),
    (SensorDesign, {"pad": Pad(kind="stiff", size_mm=15.0)}, ".*stiff pads may not touch"),
    *((SensorDesign, {"pad": Pad(**offset)}, OFF.format(12)) for offset in OFFSETS),
    (SensorDesign, {"matrix_material": Material(model="neo-hookean")}, "pillar_material is linear.*the same model"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "values", "says"), REFUSED)
def test_nonsense_is_refused_in_one_line_that_names_it(kind, values, says):
    with pytest.raises(DesignError, match=rf"^{says}") as caught:
        kind(**values)
    assert isinstance(caught.value, TriPillarError | ValueError)
    assert "\n" not in str(caught.value)


def test_what_just_fits_is_taken_and_checked_again_on_a_changed_copy():
    least = Unit().footprint_mm  # pillars of two units may touch
    for fits in ({"array": Array(pitch_mm=least)}, {"pad": Pad(size_mm=15.0)}, {"pad": Pad(offset_x_mm=-1.5)}):
        SensorDesign(**fits)
    with pytest.raises(DesignError, match="pitch_mm=5 is smaller"):
        replace(SensorDesign(), array=Array(pitch_mm=5.0))
