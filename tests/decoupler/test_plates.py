"""Whatever presses rigid plates: six components of each by readings, deviations that hold, presses, the file."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.indentation import samples_of
from dataset.measurement import ReadingError
from decoupler.touch.assessment import assess_touch
from decoupler.touch.plates import PlateDecoder, plate_response
from decoupler.touch.sensing import Pillars
from decoupler.touch.touch_file import read_model, write_touch
from fem.contact import Flat, Sphere, SurfaceCompliance, Turned, press
from fem.contact import surface as surface_module
from geometry.design import Array, Pad, SensorDesign, Unit
from geometry.layout import LAYOUTS

READ = ReadingError(noise=1e-3, bits=12)
SHAPE = (2, 2)


@pytest.fixture(scope="module")
def surfaces() -> dict[str, SurfaceCompliance]:
    """Of layouts of six pillars and of three, on coarse cells."""
    made = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surface_module, "_extrapolated", lambda source: source.condensed(1, 3))
        for name in ("six-pillar", "song2018"):
            unit, array = Unit(layout=LAYOUTS[name]), Array(rows=SHAPE[0], cols=SHAPE[1])
            design = SensorDesign(unit=unit, array=array, pad=Pad(kind="stiff"))
            made[name] = replace(surface_module._solved(design, lambda step: None), design=design)
    return made


def decoder_of(surface: SurfaceCompliance) -> PlateDecoder:
    design = surface.design
    plates, pillars = plate_response(surface), Pillars.designed(design)
    return PlateDecoder(design=design, errors=READ, library=plates, pillars=pillars)


def wrenches(n: int) -> np.ndarray:
    """Loads (n, 4, 6) of contacts on one or two plates each, of 5 to 200 N."""
    generator = np.random.default_rng(1)
    loads = np.zeros((n, 4, 6))
    for own in loads:
        for plate in generator.permutation(4)[: generator.integers(1, 3)]:
            x, y, along = generator.uniform(-5.5, 5.5), generator.uniform(-5.5, 5.5), generator.uniform(-0.4, 0.4, 2)
            own[plate] = generator.uniform(5.0, 200.0) * np.array([*along, 1.0, x, y, 0.0])
    return loads


@pytest.mark.parametrize(("layout", "bound_n"), [("six-pillar", 0.6), ("song2018", 30.0)])
def test_deviations_hold_whether_the_layout_tells_all_six_or_not(surfaces, layout: str, bound_n: float):
    """Six pillars tell fz to the bar; three cannot tell a moment from a force, and say so."""
    decoder, loads = decoder_of(surfaces[layout]), wrenches(60)
    moved = loads.reshape(60, -1) @ decoder.library.moved_mm.reshape(24, -1)
    ohms = READ.read(decoder.sensing.ohms(decoder.sensing.reading(moved)), np.random.default_rng(2))
    found = decoder.touches(ohms.reshape(60, *SHAPE, -1))
    error = np.stack([each.force_n for each in found]) - loads[..., :3]
    half = np.stack([each.half_widths_n[1] for each in found])
    assert np.sqrt((error[..., 2] ** 2).mean()) < bound_n
    assert (np.abs(error) <= half).mean() > 0.93
    loaded = loads[..., 2] > 0
    assert (np.abs(error) <= half)[loaded].mean() > 0.93
    if layout == "six-pillar":
        moments = np.stack([each.moment_nmm for each in found]) - loads[..., 3:5]
        assert np.sqrt((moments**2).mean()) < 5.0
    else:  # what it cannot tell it calls unsure
        assert np.median(half[..., 2][loaded]) > 5.0


def test_presses_of_any_shape_are_read_and_their_samples_assessed(surfaces):
    """A ball across a crossing, and a turned punch that drags one plate: noise leaves 0.8 N a loaded one of these."""
    surface = surfaces["six-pillar"]
    contacts = [
        press(surface, Sphere(9.0), 0.9, at_mm=(1.0, 0.5), cells=24),
        press(
            surface, Turned(Flat((5.0, 8.0)), 20.0), 0.3, at_mm=(8.0, 6.0), slide_mm=(0.4, 0.0), friction=0.5, cells=24
        ),
    ]
    data = samples_of(contacts)
    data = replace(data, resistance_ohm=READ.read(data.resistance_ohm, np.random.default_rng(0)))
    decoder = decoder_of(surface)
    assessed = assess_touch(decoder, data)
    assert assessed.by_force["fz"].errors.rmse_n < 1.2
    assert assessed.net_fz_median_pct < 3.0
    assert assessed.centre_mm < 0.3


def test_rest_is_rest_and_the_file_holds_all(surfaces, tmp_path):
    decoder = decoder_of(surfaces["six-pillar"])
    at_rest = decoder.rest_resistances()[None]
    assert not decoder.forces(at_rest).any()
    write_touch(decoder, tmp_path / "plates.safetensors")
    again = read_model(tmp_path / "plates.safetensors")
    pressed = 0.98 * at_rest
    assert isinstance(again, PlateDecoder)
    assert np.array_equal(again.forces(pressed), decoder.forces(pressed))
    assert np.array_equal(again.half_widths(pressed), decoder.half_widths(pressed))
