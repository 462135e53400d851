"""Touch on bare rubber and on rigid plates: presses of the library, fits, rest, two contacts, limits, six loads."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from dataset import DatasetSettings, Samples, simulate
from dataset.indentation import drawn_press, samples_of
from dataset.measurement import ReadingError
from dataset.resistance import conducted_lengths, exact_resistances, rest_resistances
from decoupler.readings import Pillars
from decoupler.touch.assessment import assess_touch
from decoupler.touch.bare import BareDecoder
from decoupler.touch.library import presses_of, touch_library
from decoupler.touch.limits import touch_limits
from decoupler.touch.morph import PRIOR, Part, fitted
from decoupler.touch.plates import PlateDecoder, PlateResponse, plate_response
from decoupler.touch.presses import Grid, middles
from decoupler.touch.regression import NEAREST
from decoupler.touch.sensing import Whitening
from fem.array.conducted import conducted_pillars
from fem.array.solving import ResponseSettings, solve_response
from fem.contact import Cylinder, Flat, Sphere, SurfaceCompliance, about_z, press, surface_compliance
from fem.contact.tiles import cell_rectangles, tiles_per_pitch
from geometry.design import Array, Electrics, Pad, SensorDesign, Unit
from geometry.layout import LAYOUTS
from tests.dataset.conftest import made_up_response
from tests.fem.coarse_plates import coarse, coarse_surface, rigid_plates

DESIGN = SensorDesign(array=Array(rows=3, cols=3))
READ = ReadingError(noise=1e-3, bits=12)
PLATE = Pad(kind="stiff")
NONE = np.zeros((1, len(PRIOR)))  #: nothing is changed of a press
N = 16


@cache
def made_decoder() -> BareDecoder:
    """By a library that is made once a session."""
    library, pillars = touch_library(DESIGN, 80)[0], Pillars.designed(DESIGN)
    return BareDecoder(design=DESIGN, errors=READ, library=library, pillars=pillars)


@cache
def made_contacts() -> Samples:
    """Contacts that the library has not seen, read with noise and converter."""
    response = solve_response(DESIGN, ResponseSettings(method="layer"))
    settings = DatasetSettings(protocol="indent", samples=N, seed=105, noise=READ.noise, bits=READ.bits)
    return simulate(response, settings)


@pytest.fixture
def decoder(shared_cache):
    return made_decoder()


@pytest.fixture
def contacts(shared_cache):
    return made_contacts()


@pytest.mark.parametrize("symmetry", [4, 7])  # the mirrors: of the diagonal alone, and all three one after another
def test_a_field_that_is_turned_is_that_of_the_turned_press(decoder, symmetry):
    """A bar pressed and dragged, solved anew in each symmetry: electrodes and loads of units, to the grids' error."""
    surface = surface_compliance(DESIGN)[0]

    def contact(symmetry):
        turn, at, slide = 20.0, np.array([11.5, 4.5]), np.array([1.0, 0.3])
        if symmetry & 4:
            turn, at, slide = 90.0 - turn, at[::-1], slide[::-1]
        for bit, axis in ((1, 0), (2, 1)):
            if symmetry & bit:
                turn, at, slide = -turn, at * (1 - 2 * np.eye(2)[axis]), slide * (1 - 2 * np.eye(2)[axis])
        bar, dragged = Cylinder(6.0, 9.0, turn=about_z(turn)), {"slide_mm": tuple(slide), "friction": 0.5}
        return press(surface, bar, 1.0, at_mm=tuple(at), **dragged)

    first = contact(0)
    solved = contact(symmetry)
    turned = presses_of([(first.patch, first.cell_force_n)]).turned(0, symmetry, np.zeros(2))
    moved = decoder.library.grid.pressed_mm(*turned)
    assert moved == pytest.approx(solved.electrode_mm.ravel(), abs=0.01 * float(np.abs(solved.electrode_mm).max()))
    part = Part.of(decoder.sensing, *turned)
    force_n = part.units(NONE)[0, :, :3]
    assert force_n == pytest.approx(solved.force_n.reshape(-1, 3), abs=0.03 * solved.force_n.max())
    spread = part.moved(NONE)[0]
    assert spread == pytest.approx(moved, abs=0.02 * float(np.abs(moved).max()))


def test_forces_at_points_keep_their_moments_on_the_cells_of_a_grid():
    """Up to the second, of cells that spread them: electrodes that move as 1, x, y, x², x y and y² do in their mean."""
    generator = np.random.default_rng(4)
    slab_mm, (ny, nx) = np.array([8.0, 6.0]), (12, 16)
    x, y = middles(np.array([-4.0, -3.0, 4.0, 3.0]), np.zeros((ny, nx)))
    own = (slab_mm / (nx, ny)) ** 2 / 12  # of a cell about its middle
    half = np.stack([0 * x + 1, x, y, x**2 + own[0], x * y, y**2 + own[1]], axis=1).reshape(ny, nx, 1, 6)
    grid = Grid(slab_mm=slab_mm, half=np.repeat(half, 3, axis=2))
    x, y = place_mm = generator.uniform(-0.5, 0.5, (2, 40)) * slab_mm[:, None]
    force_n = generator.uniform(0.0, 1.0, (3, 40))
    expected = np.stack([0 * x + 1, x, y, x**2, x * y, y**2], axis=1).T @ (force_n[0] + force_n[1] - force_n[2])
    assert grid.moved_mm(place_mm[None], force_n[None])[0] == pytest.approx(expected, rel=1e-5, abs=1e-4)  # of float32


def test_a_changed_press_is_found_again(decoder):
    """Moved, stretched, turned, heavier and dragged: exact readings lead back to its forces."""
    part = decoder._starts([0], 1)[0]
    true = 0.4 * PRIOR[None] * np.resize([1, -1, 1, 1, -1, 1, 1, -1, 1], len(PRIOR))
    reading = decoder.sensing.reading(part.moved(true))[0]
    white = Whitening.of(decoder.sensing.whitening(reading, READ).deviation / 10, np.zeros((len(reading), 0)))
    (fit,) = fitted(reading, white, [([part], NONE)], 20)
    assert fit.cost < ((true / PRIOR) ** 2).sum()  # which is the cost of the truth: of exact readings, by its prior
    (again,) = fitted(reading, white, [(fit.parts, fit.q)], 0)
    by_prior = ((fit.q / PRIOR) ** 2).sum()
    expected = pytest.approx((again.chi2, again.chi2 + by_prior), rel=1e-5)  # of single precision
    assert (fit.chi2, fit.cost) == expected  # of each step, too
    found, root = fit.loads()
    expected = part.units(true)[0]
    sure = np.sqrt((root.reshape(-1, 5, len(PRIOR))[:, :3] ** 2).sum(axis=-1))
    assert sure.max() < 0.2 * expected[:, 2].max()
    assert (np.abs(found - expected)[:, :3] <= 2 * sure + 0.01).all()  # the prior pulls


@pytest.mark.parametrize("axis", [0, 1])
def test_waves_move_and_spread_the_pressure_along_their_axis(decoder, axis):
    """The first two weigh one side more, the next two the rim; shear grows with the pressure, the place stays."""
    part = decoder._starts([0], 1)[0]
    zero = np.zeros((3, len(PRIOR)))
    waves = zero + 0.3 * np.eye(len(PRIOR))[[9 + axis, 11 + axis, 13]]
    plain, weighed = part.contact(zero), part.contact(waves)
    centre_mm, half_mm = (weighed - plain)[:, 3:5], (weighed - plain)[:, 5:]
    assert centre_mm[0, axis] == pytest.approx(0.15 * plain[0, 5 + axis], rel=0.15)  # 0.3 spreads, half axes are two
    assert half_mm[1, axis] > max(0.02 * plain[0, 5 + axis], half_mm[1, 1 - axis])
    place_mm, force_n = part.changed(waves)
    assert place_mm == pytest.approx(part.changed(zero)[0])
    assert force_n[:, 0] * part.force_n[2] == pytest.approx(force_n[:, 2] * part.force_n[0])


def test_unseen_contacts_are_decoded_within_their_deviations(decoder, contacts):
    """With 80 presses in the library: some 30 % of what 0 N would miss; the fast answer is worse."""
    found = assess_touch(decoder, contacts)
    none = np.sqrt((contacts.force_n[..., 2] ** 2).mean())
    assert found.by_force["fz"].errors.rmse_n < 0.5 * none
    assert found.net_fz_median_pct < 25
    assert found.centre_mm < 1.5
    one, two = found.loaded_coverage
    assert 0.7 < one < 0.9
    assert two > 0.9
    readings, fast = decoder.columns(contacts.resistance_ohm), decoder.regression
    quick = np.stack([fast.answer(each, fast.nearest(each, NEAREST))[0][:, 2] for each in readings])
    missed = np.sqrt(((quick - contacts.force_n[..., 2].reshape(N, -1)) ** 2).mean())
    assert found.by_force["fz"].errors.rmse_n < missed < none


def test_a_light_touch_is_within_its_deviations(decoder):
    reading, net_n = decoder.regression.reading, decoder.regression.unit[:, :, 2].sum(axis=1)
    seen_by = np.linalg.norm(reading, axis=1) / net_n
    part = decoder._starts([int(np.argsort(seen_by)[len(seen_by) // 2])], 1)[0]  # where half of all presses show less
    light = part.units(NONE)[0, :, :3]
    net_n = light[:, 2].sum()
    ohms = decoder.sensing.ohms(decoder.sensing.reading(part.moved(NONE) / net_n))  # of 1 N
    scans = READ.read(np.repeat(ohms.reshape(1, 3, 3, 3), 20, axis=0), np.random.default_rng(0))
    touches = decoder.touches(scans)
    missed = np.abs(np.stack([each.force_n for each in touches]) - light / net_n)
    assert missed[..., 2].max() < 1.1
    assert (missed <= np.stack([each.half_widths_n[1] for each in touches])).mean() > 0.95


def test_two_contacts_are_told_apart(decoder):
    """One near an electrode of each of two opposite units, solved alone: together they are no press of the library."""
    surface = surface_compliance(DESIGN)[0]
    bar, places_mm = Cylinder(4.0, 4.0, turn=about_z(30.0)), ((-18.0, -12.0), (11.0, 17.0))
    both = [press(surface, bar, 0.8, at_mm=at_mm, friction=0.3) for at_mm in places_mm]
    moved = sum(one.electrode_mm.reshape(1, -1) for one in both)
    found = decoder.touched(decoder.sensing.reading(moved)[0])
    expected = sum(one.force_n for one in both).reshape(-1, 3)
    assert any(len(fit.parts) == 2 for fit in found.fits)
    assert (np.abs(found.force_n - expected) < 3 * found.deviation[:, :3]).all()
    assert set(np.argsort(found.force_n[:, 2])[-2:]) == {0, 8}
    for one, solved in zip(sorted(found.contacts, key=lambda one: one.centre_mm[0]), both, strict=True):
        assert one.force_n[2] == pytest.approx(solved.force_n[..., 2].sum(), abs=3 * one.force_deviation_n[2] + 1.0)
        assert one.centre_mm == pytest.approx(solved.centre_mm, abs=1.0)
        true = presses_of([(solved.patch, solved.cell_force_n)]).turned(0, 0, np.zeros(2))
        pressed = Part.of(decoder.sensing, *true).contact(NONE)
        assert (np.abs(one.half_mm - pressed[0, 5:]) < 3 * one.half_deviation_mm).all()


def test_soft_rubber_and_more_pillars_feel_touches_better(monkeypatch, shared_cache):
    """What is linear knows force over stiffness: rubber half as stiff is a touch twice as heavy."""
    monkeypatch.setattr("decoupler.touch.limits.TOUCHES", 8)
    design = replace(DESIGN, array=Array(rows=2, cols=2))
    rubber = replace(design.matrix_material, young_mpa=design.matrix_material.young_mpa / 2)
    soft = replace(design, matrix_material=rubber, pillar_material=rubber)
    unit, array = replace(design.unit, span_mm=6.0), replace(design.array, pitch_mm=10.0)
    close = replace(design, unit=unit, array=array, pad=replace(design.pad, size_mm=8.0))
    known, heavy, softer, denser = (
        np.array(touch_limits(each, force_n, READ))
        for each, force_n in ((design, 10.0), (design, 20.0), (soft, 10.0), (close, 10.0))
    )
    assert softer == pytest.approx(heavy, rel=1e-3)
    assert (softer < 0.8 * known).all()
    assert (denser < 0.9 * known).all()


def test_whoever_calls_it_reads_a_scan_on_one_thread(decoder, contacts, monkeypatch):
    """Two threads take 20 times as long for matrices this small."""
    read, threads = BareDecoder.pressed, set()

    def watched(self, *given):
        threads.update(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas")
        return read(self, *given)

    monkeypatch.setattr(BareDecoder, "pressed", watched)
    one = contacts.resistance_ohm[:1]
    for call in (decoder.forces, decoder.half_widths, decoder.touches, decoder.follower().touches):
        threads.clear()
        with threadpool_limits(2, user_api="blas"):
            call(one)
        assert threads == {1}


def test_three_pillars_take_a_plate_s_moment_for_a_force_and_six_do_not(monkeypatch, shared_cache):
    """Plates of their own: three readings leave three of six loads to the prior; six err by the noise."""
    rigid = "decoupler.touch.limits.plate_response"
    monkeypatch.setattr(rigid, lambda one: (PlateResponse(moved_mm=rigid_plates(one)), None, True))
    three, six = (replace(DESIGN, unit=Unit(layout=LAYOUTS[name]), pad=PLATE) for name in ("song2018", "six-pillar"))
    assert touch_limits(three, 20.0, ReadingError(noise=1e-3, bits=None))[0] > 20.0
    once, twice = (np.array(touch_limits(six, 20.0, ReadingError(noise=noise, bits=None))) for noise in (2e-4, 4e-4))
    assert ((once < twice) & (twice < 2 * once)).all()  # what rubber between plates may bear stays
    assert once[0] < 2.0
    assert touch_limits(six, 0.2, ReadingError(noise=1e-2, bits=None))[0] > 90.0  # taken for rest, it is missed whole


SHAPE = (2, 2)


@cache
def made_surfaces() -> dict[str, SurfaceCompliance]:
    """Of layouts of six pillars and of three, and of six by conduction, on coarse cells."""
    made = {}
    for name, model in (("six-pillar", "eq1"), ("song2018", "eq1"), ("six-pillar", "conduction")):
        unit, array = Unit(layout=LAYOUTS[name]), Array(rows=SHAPE[0], cols=SHAPE[1])
        design = SensorDesign(unit=unit, array=array, pad=PLATE, electrics=Electrics(model=model))
        made[name if model == "eq1" else model] = coarse_surface(design, 1, 3)
    return made


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


@cache
def made_plates(name: str) -> tuple[PlateDecoder, np.ndarray, np.ndarray]:
    """A decoder, loads of 60 scans, and what is read under them."""
    decoder, loads = decoder_of(made_surfaces()[name]), wrenches(60)
    moved = loads.reshape(60, -1) @ decoder.library.moved_mm.reshape(24, -1)
    exact = decoder.sensing.ohms(decoder.sensing.reading(moved))
    return decoder, loads, READ.read(exact, np.random.default_rng(2)).reshape(60, *SHAPE, -1)


def test_a_plate_s_own_cell_says_what_forces_on_its_tiles_do():
    """Pressure that pushes its tiles evenly, and that tilts them, of the whole compliance: to its single precision."""
    surface = made_surfaces()["six-pillar"]
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
def test_deviations_hold_whether_the_layout_tells_all_six_or_not(layout: str, bound_n: float):
    """Six pillars tell fz to the bar; three cannot tell a moment from a force, and say so."""
    decoder, loads, ohms = made_plates(layout)
    found, loaded = decoder.touches(ohms), loads[..., 2] > 0
    off = np.abs(np.stack([each.load for each in found]) - loads)
    one, two = (np.stack(each) for each in zip(*(each.half_widths for each in found), strict=True))
    assert np.sqrt((off[..., 2] ** 2).mean()) < bound_n
    assert (off <= two)[..., :3].mean() > 0.93
    assert (off <= two)[loaded, :3].mean() > 0.93
    if layout != "song2018":
        assert np.sqrt((off[..., 3:5] ** 2).mean()) < 5.0
        assert (off <= one)[..., 3:].mean() > 0.66  # of moments, as of forces
        assert (off <= two)[..., 3:].mean() > 0.93
    else:  # what it cannot tell it calls unsure
        assert np.median(two[loaded, 2]) > 5.0


@pytest.mark.parametrize("name", ["six-pillar", "conduction"])
def test_presses_of_any_shape_are_read_and_their_samples_assessed(name: str):
    """A ball across a crossing, and a turned punch that drags one plate, each read ten times."""
    surface = made_surfaces()[name]
    punch, dragged = Flat((5.0, 8.0), turn=about_z(20.0)), {"slide_mm": (0.4, 0.0), "friction": 0.5}
    ball = press(surface, Sphere(9.0), 0.9, at_mm=(1.0, 0.5), cells=24)
    data = samples_of(10 * [ball, press(surface, punch, 0.3, at_mm=(8.0, 6.0), cells=24, **dragged)])
    data = replace(data, resistance_ohm=READ.read(data.resistance_ohm, np.random.default_rng(0)))
    decoder = decoder_of(surface)
    assessed = assess_touch(decoder, data)
    assert assessed.by_force["fz"].errors.rmse_n < 1.2
    assert assessed.net_fz_median_pct < 3.0
    assert assessed.centre_mm < 0.3


def test_a_force_on_a_plate_s_middle_reads_as_in_the_array_s_response_by_conduction():
    """Another path, by loads on pads: to 0.2 % of the change, and as squares beyond what is linear."""
    surface, thickness_mm = made_surfaces()["conduction"], Pad().plate.thickness_mm
    moved = decoder_of(made_surfaces()["six-pillar"]).library.moved_mm
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


def test_samples_of_contacts_hold_resistances_by_conduction(monkeypatch):
    """Those of `indent` are those of its contacts, and change otherwise than by eq. 1: by 2 to 50 % of the change."""
    surface = made_surfaces()["conduction"]
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
