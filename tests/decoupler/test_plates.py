"""Whatever presses rigid plates: six components of each by readings, deviations that hold, presses, the file."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from dataset import DatasetSettings, simulate
from dataset.indentation import drawn_press, samples_of
from dataset.measurement import ReadingError
from dataset.resistance import conducted_lengths, exact_resistances, rest_resistances
from decoupler.readings import Pillars
from decoupler.touch.assessment import assess_touch
from decoupler.touch.plates import PlateDecoder, plate_response
from fem.array.conducted import conducted_pillars
from fem.contact import Flat, Sphere, SurfaceCompliance, about_z, press
from fem.contact.tiles import cell_rectangles, tiles_per_pitch
from geometry.design import Array, Electrics, Pad, SensorDesign, Unit
from geometry.layout import LAYOUTS
from tests.dataset.conftest import made_up_response
from tests.fem.coarse_plates import coarse, coarse_surface

READ = ReadingError(noise=1e-3, bits=12)
SHAPE = (2, 2)


@cache
def made_surfaces() -> dict[str, SurfaceCompliance]:
    """Of layouts of six pillars and of three, and of six by conduction, on coarse cells."""
    made = {}
    for name, model in (("six-pillar", "eq1"), ("song2018", "eq1"), ("six-pillar", "conduction")):
        unit, array = Unit(layout=LAYOUTS[name]), Array(rows=SHAPE[0], cols=SHAPE[1])
        design = SensorDesign(unit=unit, array=array, pad=Pad(kind="stiff"), electrics=Electrics(model=model))
        made[name if model == "eq1" else model] = coarse_surface(design, 1, 3)
    return made


@pytest.fixture
def surfaces() -> dict[str, SurfaceCompliance]:
    return made_surfaces()


def decoder_of(surface: SurfaceCompliance) -> PlateDecoder:
    design = surface.design
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fem.contact.surface._extrapolated", lambda source: source.condensed(1, 3))
        patch.setattr("fem.contact.surface.surface_compliance", lambda design, progress: (surface, None, True))
        patch.setattr("decoupler.touch.plates.kept_value", lambda hint, kind, key, make: (make(), None, False))
        plates = plate_response(design)[0]
    return PlateDecoder(design=design, errors=READ, library=plates, pillars=Pillars.designed(design))


def wrenches(n: int) -> np.ndarray:
    """Loads (n, 4, 6) of contacts on one or two plates each, of 5 to 200 N."""
    generator = np.random.default_rng(1)
    loads = np.zeros((n, 4, 6))
    for own in loads:
        for plate in generator.permutation(4)[: generator.integers(1, 3)]:
            x, y, along = generator.uniform(-5.5, 5.5), generator.uniform(-5.5, 5.5), generator.uniform(-0.4, 0.4, 2)
            own[plate] = generator.uniform(5.0, 200.0) * np.array([*along, 1.0, x, y, 0.0])
    return loads


def test_a_plate_s_own_cell_says_what_forces_on_its_tiles_do(surfaces):
    """Pressure that pushes its tiles evenly, and that tilts them, of the whole compliance: to its single precision."""
    surface = surfaces["six-pillar"]
    tiles, _ = tiles_per_pitch(surface.design)
    squares = cell_rectangles(surface.design)[: tiles**2]
    x, y = ((squares[:, :2] + squares[:, 2:]) / 2).T.reshape(2, tiles, tiles)
    on = np.maximum(np.abs(x), np.abs(y)) < surface.design.pad.size_mm / 2
    pushed = surface.on_electrodes.reshape(*SHAPE, 3, 3, 3, 2, tiles, 2, tiles)[:, :, :, :, 2, 1, :, 0]  # unit 2's
    moved = decoder_of(surface).library.moved_mm[2]
    for load, pressure in ((2, on / on.sum()), (3, x * on / (x[on] ** 2).sum())):
        expected = -np.einsum("ijeayx,yx->ijea", pushed, pressure)
        assert moved[load] == pytest.approx(expected.ravel(), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(("layout", "bound_n"), [("six-pillar", 0.6), ("conduction", 0.6), ("song2018", 30.0)])
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
    if layout != "song2018":
        moments = np.stack([each.moment_nmm for each in found]) - loads[..., 3:5]
        assert np.sqrt((moments**2).mean()) < 5.0
        of_all = np.abs(np.stack([each.load for each in found]) - loads)
        held = [
            (of_all <= np.stack(each))[..., 3:].mean() for each in zip(*(one.half_widths for one in found), strict=True)
        ]
        assert (held[0] > 0.66, held[1] > 0.93) == (True, True)  # of moments, as of forces
    else:  # what it cannot tell it calls unsure
        assert np.median(half[..., 2][loaded]) > 5.0


@pytest.mark.parametrize("name", ["six-pillar", "conduction"])
def test_presses_of_any_shape_are_read_and_their_samples_assessed(surfaces, name: str):
    """A ball across a crossing, and a turned punch that drags one plate, each read ten times."""
    surface = surfaces[name]
    contacts = [
        press(surface, Sphere(9.0), 0.9, at_mm=(1.0, 0.5), cells=24),
        press(
            surface,
            Flat((5.0, 8.0), turn=about_z(20.0)),
            0.3,
            at_mm=(8.0, 6.0),
            slide_mm=(0.4, 0.0),
            friction=0.5,
            cells=24,
        ),
    ]
    data = samples_of(10 * contacts)
    data = replace(data, resistance_ohm=READ.read(data.resistance_ohm, np.random.default_rng(0)))
    decoder = decoder_of(surface)
    assessed = assess_touch(decoder, data)
    assert assessed.by_force["fz"].errors.rmse_n < 1.2
    assert assessed.net_fz_median_pct < 3.0
    assert assessed.centre_mm < 0.3


def test_a_force_on_a_plate_s_middle_reads_as_in_the_array_s_response_by_conduction(surfaces):
    """Another path, by loads on pads: to 0.2 % of the change, and as squares beyond what is linear."""
    surface, thickness_mm = surfaces["conduction"], Pad().plate.thickness_mm
    moved = decoder_of(surfaces["six-pillar"]).library.moved_mm
    by_force = moved[:, :3].copy()
    by_force[:, :2] -= thickness_mm * moved[:, 3:5]  # at the middle of the underside
    by_force[:, 2] *= -1.0
    influence = by_force.reshape(4, 3, 4, 3, 3).transpose(2, 3, 4, 0, 1).reshape(2, 2, 3, 3, 2, 2, 3)
    with coarse(surface.design, 1, 3):
        pads = conducted_pillars(surface.design, influence)
    force_n = np.zeros((1, 4, 3))
    force_n[0, 1], force_n[0, 2] = (30.0, -10.0, -200.0), (0.0, 15.0, -60.0)
    squares = conducted_lengths(pads, force_n)[0].ravel() ** 2
    loads = np.zeros((4, 6))
    loads[:, :3] = force_n[0] * [1.0, 1.0, -1.0]
    loads[:, 3:5] = -thickness_mm * loads[:, :2]
    decoder = decoder_of(surface)
    found = decoder.sensing.reading(loads.ravel() @ decoder.library.moved_mm.reshape(24, -1))
    expected = squares - decoder.sensing.rest_mm2
    assert np.abs(found - expected).max() < 2e-3 * np.abs(expected).max()


def test_samples_of_contacts_hold_resistances_by_conduction(surfaces, monkeypatch):
    """Those of `indent` are those of its contacts, and change otherwise than by eq. 1: by 2 to 50 % of the change."""
    surface = surfaces["conduction"]
    monkeypatch.setattr("dataset.indentation._surface", lambda design: surface)
    response = replace(made_up_response(surface.design), conducted=surface.conducted)  # which contact does not ask
    monkeypatch.setattr("dataset.indentation.drawn_press", partial(drawn_press, cells=16))
    data = simulate(response, DatasetSettings(protocol="indent", samples=2, seed=4))
    expected = samples_of([drawn_press(np.random.default_rng([4, 0, number, 0]), surface, 16) for number in (0, 1)])
    assert data.resistance_ohm == pytest.approx(expected.resistance_ohm, rel=1e-6)
    rest_ohm = rest_resistances(replace(surface.design, electrics=Electrics()))
    by_eq1 = exact_resistances(data.length_mm, surface.design) / rest_ohm - 1
    coarse_ohm = exact_resistances(surface.conducted.rest_mm[0, 0, :, 0], surface.design)
    change = data.resistance_ohm / coarse_ohm - 1
    assert 0.02 < np.linalg.norm(by_eq1 - change) / np.linalg.norm(change) < 0.5
