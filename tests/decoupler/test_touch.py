"""Touch on bare rubber: presses of the library against contacts solved anew, fits, rest, two contacts, the file."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from common.errors import FileFormatError
from dataset import DatasetSettings, SampleError, simulate
from dataset.measurement import ReadingError
from decoupler.model_file import read_model, write_model
from decoupler.readings import Pillars
from decoupler.touch.assessment import assess_touch
from decoupler.touch.bare import BareDecoder
from decoupler.touch.library import presses_of, touch_library
from decoupler.touch.limits import touch_limits
from decoupler.touch.morph import PRIOR, Part, fitted
from decoupler.touch.plates import PlateResponse
from decoupler.touch.presses import Grid, middles
from decoupler.touch.regression import NEAREST
from decoupler.touch.sensing import Whitening
from fem.array.solving import ResponseSettings, solve_response
from fem.contact import Cylinder, about_z, press, surface_compliance
from geometry.design import Array, Pad, SensorDesign, Unit
from geometry.layout import LAYOUTS
from tests.fem.coarse_plates import rigid_plates

pytestmark = pytest.mark.usefixtures("shared_cache")
DESIGN = SensorDesign(array=Array(rows=3, cols=3))
READ = ReadingError(noise=1e-3, bits=12)
PLATE = Pad(kind="stiff")
N = 16


@pytest.fixture
def decoder():
    """By a library that is made once a session."""
    return BareDecoder(
        design=DESIGN, errors=READ, library=touch_library(DESIGN, 80)[0], pillars=Pillars.designed(DESIGN)
    )


@pytest.fixture(scope="module")
def contacts():
    """Contacts that the library has not seen, read with noise and converter."""
    response = solve_response(DESIGN, ResponseSettings(method="layer"))
    settings = DatasetSettings(protocol="indent", samples=N, seed=105, noise=READ.noise, bits=READ.bits)
    return simulate(response, settings)


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
        return press(
            surface, Cylinder(6.0, 9.0, turn=about_z(turn)), 1.0, at_mm=tuple(at), slide_mm=tuple(slide), friction=0.5
        )

    first = contact(0)
    solved = contact(symmetry)
    turned = presses_of([(first.patch, first.cell_force_n)]).turned(0, symmetry, np.zeros(2))
    moved = decoder.library.grid.pressed_mm(*turned)
    assert moved == pytest.approx(solved.electrode_mm.ravel(), abs=0.01 * float(np.abs(solved.electrode_mm).max()))
    part = Part.of(decoder.sensing, *turned)
    force_n = part.units(np.zeros((1, len(PRIOR))))[0, :, :3]
    assert force_n == pytest.approx(solved.force_n.reshape(-1, 3), abs=0.03 * solved.force_n.max())
    spread = part.moved(np.zeros((1, len(PRIOR))))[0]
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
    (fit,) = fitted(reading, white, [([part], np.zeros((1, len(PRIOR))))], 20)
    assert fit.cost < ((true / PRIOR) ** 2).sum()  # which is the cost of the truth: of exact readings, by its prior
    (again,) = fitted(reading, white, [(fit.parts, fit.q)], 0)
    assert (fit.chi2, fit.cost) == pytest.approx(
        (again.chi2, again.chi2 + ((fit.q / PRIOR) ** 2).sum())
    )  # of each step, too
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
    assert 0.6 < one < 0.97
    assert two > 0.9
    readings, fast = decoder.columns(contacts.resistance_ohm), decoder.regression
    quick = np.stack([fast.answer(each, fast.nearest(each, NEAREST))[0][:, 2] for each in readings])
    missed = np.sqrt(((quick - contacts.force_n[..., 2].reshape(N, -1)) ** 2).mean())
    assert found.by_force["fz"].errors.rmse_n < missed < none


def test_rest_is_rest_and_a_light_touch_is_within_its_deviations(decoder):
    generator, rest_ohm = np.random.default_rng(0), decoder.rest_resistances()
    scans = READ.read(np.repeat(rest_ohm[None], 50, axis=0), generator)
    assert np.count_nonzero(decoder.forces(scans).any(axis=(1, 2, 3))) <= 1  # one in a thousand is promised
    reading, net_n = decoder.regression.reading, decoder.regression.unit[:, :, 2].sum(axis=1)
    seen_by = np.linalg.norm(reading, axis=1) / net_n
    part = decoder._starts([int(np.argsort(seen_by)[len(seen_by) // 2])], 1)[0]  # where half of all presses show less
    light = part.units(np.zeros((1, len(PRIOR))))[0, :, :3]
    net_n = light[:, 2].sum()
    ohms = decoder.sensing.ohms(decoder.sensing.reading(part.moved(np.zeros((1, len(PRIOR)))) / net_n))  # of 1 N
    touches = decoder.touches(READ.read(np.repeat(ohms.reshape(1, 3, 3, 3), 20, axis=0), generator))
    missed = np.abs(np.stack([each.force_n for each in touches]) - light / net_n)
    assert missed[..., 2].max() < 1.1
    assert (missed <= np.stack([each.half_widths_n[1] for each in touches])).mean() > 0.95


def test_two_contacts_are_told_apart(decoder):
    """One near an electrode of each of two opposite units, solved alone: together they are no press of the library."""
    surface = surface_compliance(DESIGN)[0]
    both = [
        press(surface, Cylinder(4.0, 4.0, turn=about_z(30.0)), 0.8, at_mm=at, friction=0.3)
        for at in ((-18.0, -12.0), (11.0, 17.0))
    ]
    moved = sum(one.electrode_mm.reshape(1, -1) for one in both)
    found = decoder.touched(decoder.sensing.reading(moved)[0])
    expected = sum(one.force_n for one in both).reshape(-1, 3)
    assert any(len(fit.parts) == 2 for fit in found.fits)
    assert (np.abs(found.force_n - expected) < 3 * found.deviation[:, :3]).all()
    assert set(np.argsort(found.force_n[:, 2])[-2:]) == {0, 8}
    for one, solved in zip(sorted(found.contacts, key=lambda one: one.centre_mm[0]), both, strict=True):
        assert one.force_n[2] == pytest.approx(solved.force_n[..., 2].sum(), abs=3 * one.force_deviation_n[2] + 1.0)
        assert one.centre_mm == pytest.approx(solved.centre_mm, abs=1.0)
        pressed = Part.of(
            decoder.sensing, *presses_of([(solved.patch, solved.cell_force_n)]).turned(0, 0, np.zeros(2))
        ).contact(np.zeros((1, len(PRIOR))))
        assert (np.abs(one.half_mm - pressed[0, 5:]) < 3 * one.half_deviation_mm).all()


def test_soft_rubber_and_more_pillars_feel_touches_better(monkeypatch):
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


def test_a_scan_alone_is_as_in_a_batch_and_as_by_its_file(decoder, contacts, tmp_path):
    path, some = tmp_path / "touch.safetensors", contacts.resistance_ohm[:3]
    write_model(decoder, path)
    again = read_model(path)
    assert np.array_equal(again.forces(some), np.concatenate([decoder.forces(one[None]) for one in some]))
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    with pytest.raises(FileFormatError, match=r"touch\.safetensors: "):
        read_model(path)
    with pytest.raises(SampleError, match=r"resistances are of 6 × 6 units, the model.s sensor has 3 × 3"):
        decoder.forces(np.ones((1, 6, 6, 3)))
    with pytest.raises(SampleError, match="resistance_ohm is nan at sample 0"):
        decoder.forces(np.full((1, 3, 3, 3), np.nan))


def test_three_pillars_take_a_plate_s_moment_for_a_force_and_six_do_not(monkeypatch):
    """Plates of their own: three readings leave three of six loads to the prior; six err by the noise.

    A touch that is taken for rest is missed whole, and as much may be hidden.
    """
    monkeypatch.setattr(
        "decoupler.touch.limits.plate_response", lambda one: (PlateResponse(moved_mm=rigid_plates(one)), None, True)
    )
    three, six = (replace(DESIGN, unit=Unit(layout=LAYOUTS[name]), pad=PLATE) for name in ("song2018", "six-pillar"))
    assert touch_limits(three, 20.0, ReadingError(noise=1e-3, bits=None))[0] > 20.0
    once, twice = (np.array(touch_limits(six, 20.0, ReadingError(noise=noise, bits=None))) for noise in (2e-4, 4e-4))
    assert ((once < twice) & (twice < 2 * once)).all()  # what rubber between plates may bear stays
    assert once[0] < 2.0
    assert touch_limits(six, 0.2, ReadingError(noise=1e-2, bits=None))[0] > 90.0


@pytest.mark.parametrize("reads", [1e9, 1.0])
def test_a_broken_pillar_is_left_out_of_each_scan(decoder, contacts, reads):
    """Open or shorted under the middle unit: deviations hold as if it were read, and rest is rest."""
    ohms, shape = contacts.resistance_ohm.copy(), (N, 9, 3)
    ohms[:, 1, 1, 0] = reads
    assert np.argwhere(decoder.lost(ohms).any(axis=0)).tolist() == [[1, 1, 0]]
    off = np.abs(decoder.forces(ohms) - contacts.force_n)
    assert (off <= decoder.half_widths(ohms)[1]).mean() > 0.92
    intact = np.abs(decoder.forces(contacts.resistance_ohm) - contacts.force_n)
    assert np.sqrt((np.delete(off.reshape(shape), 4, 1) ** 2).mean()) <= 1.5 * np.sqrt((intact**2).mean())
    rest = decoder.rest_resistances()[None].copy()
    rest[:, 1, 1, 0] = reads
    assert not decoder.forces(rest).any()


def test_drifts_are_known_and_another_sensor_is_told(decoder, contacts):
    """0.5 % that all readings share: told of it, deviations of units and of the net force hold; else they do not."""
    drifts = replace(READ, drift=0.005)
    exact = decoder.sensing.ohms(decoder.sensing.shown(contacts.resistance_ohm.reshape(N, -1)))
    drifted = drifts.drifted(exact.reshape(N, 3, 3, 3), np.random.default_rng(3))
    net = np.zeros((9, 5, 1))
    net[:, 2] = 1.0
    held = []
    for errors in (READ, drifts):
        known = decoder.read_by(errors)
        off = known.forces(drifted) - contacts.force_n
        covariance = known.deviations(drifted, net.reshape(45, 1))[1][:, 0, 0]
        within = np.abs(off) <= known.half_widths(drifted)[1]
        held.append((within.mean(), (np.abs(off[..., 2].sum(axis=(1, 2))) <= 2.0 * np.sqrt(covariance)).mean()))
    assert min(held[1]) >= 0.92
    assert held[0][0] < held[1][0]
    gains = np.random.default_rng(4).uniform(0.9, 1.1, (3, 3, 3))
    assert np.greater(*decoder.consistency(gains * contacts.resistance_ohm)).all()
    assert np.greater(*decoder.consistency(contacts.resistance_ohm)).mean() <= 0.2  # of so small a library
