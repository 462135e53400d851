"""The sensor in torch: equal to what simulates, reads and decodes in NumPy, and differentiable all the way."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from common.errors import ArgumentError, DesignError
from dataset import OPEN_OHM, DatasetSettings, simulate
from dataset.imperfections import Imperfections
from dataset.indentation import samples_of
from dataset.resistance import exact_resistances, pillar_resistances
from decoupler import NetworkConfig, TrainingConfig, train
from decoupler.data.pairs import Pairs
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model_file import write_model
from decoupler.twin import identify, simulate_twin, write_twin
from decoupler.twin.twin_file import read_twin
from fem.array.closed_forms import layer_response
from fem.array.sensitivities import ResponseSensitivities
from fem.contact import Capsule, press, surface_compliance
from geometry.design import Array, Electrics, Pad, SensorDesign, Unit
from geometry.layout import LAYOUTS, SONG2018, pillar_volumes, rest_lengths
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import SUITED_SENSE_OHM, Corrector, Crossbar
from hardware.virtual import VirtualSensor
from tests.dataset.conftest import made_up_response
from tests.decoupler.test_finite_strain import learned
from tests.fem.coarse_plates import coarse_surface

DESIGN = SensorDesign(array=Array(rows=2, cols=3))
STEP_N = 1e-3  #: of finite differences; their error is of its square


@pytest.fixture(scope="module")
def response():
    return layer_response(DESIGN)


@pytest.fixture(scope="module")
def samples(response):
    return simulate(response, DatasetSettings(protocol="three-axis", samples=40, seed=1))


@pytest.fixture(scope="module")
def model(samples, response):
    return train(samples, "all", NetworkConfig(hidden=4), TrainingConfig(), response=response)


def sensor(response, **settings):
    return VirtualSensor(DESIGN, response=response, environments=40, **settings)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_sensors_of_any_layout_are_those_of_a_dataset_through_their_crossbar(layout):
    """Exact readings through wires come back; forces are told by the posterior's start, whatever the pillars."""
    response = layer_response(SensorDesign(unit=Unit(layout=layout), array=Array(rows=2, cols=2)))
    made = simulate(response, DatasetSettings(protocol="three-axis", samples=60, seed=1))
    wired = Crossbar.suited(ScanMode.ZERO_POTENTIAL, rows=2, cols=2, bits=None, layout=layout)
    model = train(made, "all", NetworkConfig(hidden=4), TrainingConfig(), response=response)
    virtual = VirtualSensor(response.design, model, response=response, environments=60, crossbar=wired)
    exact = virtual.resistances(torch.from_numpy(made.force_n))
    np.testing.assert_allclose(exact.numpy(), made.resistance_ohm, rtol=1e-12)
    read = virtual.read(exact)
    np.testing.assert_allclose(read.numpy(), made.resistance_ohm, rtol=1e-6)
    expected = model.forces(read.numpy())
    assert virtual.forces(read).numpy() == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
    if layout != SONG2018:
        with pytest.raises(ArgumentError, match="the crossbar is of another layout than the design"):
            VirtualSensor(response.design, response=response, crossbar=replace(wired, layout=SONG2018))


def crossbar(mode, bits=None):
    return Crossbar.suited(mode, rows=2, cols=3, bits=bits, line_ohm=3.0)


def test_it_shows_what_a_dataset_holds_and_decodes_as_the_model_does(response, samples, model):
    found = sensor(response).resistances(torch.from_numpy(samples.force_n)).numpy()
    np.testing.assert_allclose(found, samples.resistance_ohm, rtol=1e-12)
    exact = samples.resistance_ohm
    expected = Imperfections(bits=12).apply(exact, np.random.default_rng(0))
    np.testing.assert_allclose(sensor(response, bits=12).read(torch.from_numpy(exact)).numpy(), expected, rtol=1e-12)
    for decoder in (model, train(samples, "all", NetworkConfig(hidden=4, net="plain", feature="root"))):
        found = sensor(response, model=decoder).forces(torch.from_numpy(exact)).numpy()
        np.testing.assert_allclose(found, decoder.forces(exact), atol=1e-9 * abs(found).max())


@pytest.mark.parametrize("mode", SUITED_SENSE_OHM)
def test_the_crossbar_reads_and_corrects_as_the_board_does(response, samples, mode):
    exact = samples.resistance_ohm.copy()
    exact[3, 1, 2, 0] = OPEN_OHM
    for corrected in (True, False):
        wired = crossbar(mode, bits=12)
        virtual = sensor(response, crossbar=wired, correct=corrected)
        readings, _ = wired.fractions(wired.counts(exact))
        expected = Corrector(wired).correct(readings) if corrected else wired.uncorrected(readings)
        found = virtual.read(torch.from_numpy(exact)).numpy()
        one_count = np.abs(1.0 / expected - 1.0 / found) * wired.sense_ohm * 4095
        assert one_count.max() < 0.2  # both correctors end at a fraction of a count


@pytest.mark.parametrize("mode", [None, *SUITED_SENSE_OHM])
def test_gradients_are_those_of_finite_differences(response, samples, model, mode):
    """From points and forces of contact to decoded newtons, the crossbar's correction included."""
    wired = None if mode is None else replace(crossbar(mode), shunt_siemens=(2e-5, 1e-5, 3e-5))
    virtual = VirtualSensor(DESIGN, model, response=response, crossbar=wired, gain_spread=0.1, offset_ohm=50.0, seed=3)
    points = torch.tensor([[[-11.0, 3.0], [4.0, -6.0]]], dtype=torch.float64, requires_grad=True)
    force_n = torch.tensor([[[20.0, -10.0, 200.0], [5.0, 15.0, 150.0]]], dtype=torch.float64, requires_grad=True)
    weight = torch.randn(1, 2, 3, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def score(points, force_n):
        return (virtual.touch(points, force_n).decoded_n * weight).sum()

    largest = max(float(each.abs().max()) for each in torch.autograd.grad(score(points, force_n), (points, force_n)))
    assert torch.autograd.gradcheck(score, (points, force_n), eps=STEP_N, atol=1e-6 * largest, rtol=1e-6)


def test_point_forces_keep_their_sum_and_their_moment(response):
    generator = torch.Generator().manual_seed(0)
    points = (torch.rand(40, 7, 2, generator=generator, dtype=torch.float64) - 0.5) * torch.tensor([30.0, 15.0])
    force_n = torch.randn(40, 7, 3, generator=generator)  # float32, as simulators give them
    pads, force_n = sensor(response).pad_loads(points, force_n), force_n.double()
    torch.testing.assert_close(pads.sum(dim=(1, 2)), force_n.sum(dim=1))
    centres = torch.stack(torch.meshgrid(torch.tensor([-7.5, 7.5]), torch.tensor([-15.0, 0, 15]), indexing="ij"), -1)
    moments = torch.einsum("nrc,rca->na", pads[..., 2], centres.flip(-1).double())
    torch.testing.assert_close(moments, torch.einsum("nk,nka->na", force_n[..., 2], points))
    strains = sensor(response).strains(pads)
    torch.testing.assert_close(sensor(response).strains(pads.float()), strains, rtol=1e-6, atol=0.0)
    with pytest.raises(ArgumentError, match="expected"):
        sensor(response).strains(pads[..., :2])


def test_each_reset_draws_other_specimens(response, samples):
    virtual = sensor(response, gain_spread=0.2, offset_ohm=10.0, dead_probability=0.1, noise=0.001, seed=4)
    exact = torch.from_numpy(samples.resistance_ohm)
    before, dead = virtual.read(exact), virtual.dead
    assert (before[dead] == OPEN_OHM).all()
    assert 0.05 < float(dead.double().mean()) < 0.15
    mask = torch.zeros(40, dtype=torch.bool)
    mask[:5] = True
    virtual.reset(mask)
    after = virtual.read(exact)
    assert bool((virtual.dead[5:] == dead[5:]).all())
    ratio = (after / before)[5:][~dead[5:]]
    assert float((ratio - 1.0).std()) == pytest.approx(0.001 * 2**0.5, rel=0.1)
    assert float((after / before)[:5][~(dead | virtual.dead)[:5]].std()) > 0.05
    again = sensor(response, gain_spread=0.2, offset_ohm=10.0, dead_probability=0.1, noise=0.001, seed=4)
    torch.testing.assert_close(again.read(exact), before, rtol=0, atol=0)


def test_a_twin_gives_each_environment_a_sensor_of_its_posterior(response, tmp_path):
    measured = simulate(response, DatasetSettings(protocol="three-axis", samples=6, seed=3, noise=0.001))
    unknown = ResponseSensitivities(
        design=DESIGN, parameters=(), deviation=np.empty(0), influence_mm_per_n=np.empty((0, 2, 3, 2, 3, 2, 3, 3))
    )
    twin = identify(Pairs.of(measured), response, unknown)
    write_model(twin.decoder, tmp_path / "own.safetensors")
    write_twin(twin, tmp_path / "twin.toml", tmp_path / "own.safetensors")
    read = read_twin(tmp_path / "twin.toml")
    settings = DatasetSettings(protocol="three-axis", samples=32, seed=5)
    drawn = simulate_twin(read, replace(response, design=read.design), settings)
    virtual = VirtualSensor(tmp_path / "twin.toml", environments=32)
    virtual._member[:] = torch.arange(32)  # samples have the sensors in turn
    found = virtual.resistances(torch.from_numpy(drawn.force_n)).numpy()
    np.testing.assert_allclose(found, drawn.resistance_ohm, rtol=1e-6)  # its draws are of single precision
    decoded = virtual.forces(torch.from_numpy(drawn.resistance_ohm)).numpy()
    np.testing.assert_allclose(decoded, twin.decoder.forces(drawn.resistance_ohm), atol=1e-8 * abs(decoded).max())


def test_bodies_pressed_into_bare_rubber_read_as_contacts_do(shared_cache):
    """Two environments: a ball here, another there, which goes. Forces to 5 %, readings to 3 % of their change."""
    pair = SensorDesign(array=Array(rows=1, cols=2))
    virtual = VirtualSensor(pair, environments=2, response=layer_response(pair))
    ball = Capsule(6.0)
    for depth in np.linspace(0.15, 0.6, 4):
        reading = virtual.press(
            [{"ball": (ball, (3.0, -2.0, 6.0 - depth), None)}, {"tool": (ball, (-6.0, 0.0, 0.0), 9.0)}]
        )
    expected = samples_of([press(surface_compliance(pair)[0], ball, 0.6, at_mm=(3.0, -2.0), friction=0.5)])
    rest = pillar_resistances(rest_lengths(pair.unit), pillar_volumes(pair.unit), pair.resistivity_ohm_mm)
    for found, known, part in (
        (reading.force_n[0].numpy(), expected.force_n[0], 0.05),
        (reading.resistance_ohm[0].numpy() - rest, expected.resistance_ohm[0] - rest, 0.03),
    ):
        assert np.linalg.norm(found - known) < part * np.linalg.norm(known)
    assert not reading.force_n[0, 0, 0].any()
    assert np.abs(reading.resistance_ohm[0, 0, 0].numpy() - rest).max() > 2.0  # the neighbour answers too
    assert float(reading.force_n[1, ..., 2].sum()) == pytest.approx(9.0, rel=0.01)
    assert [contact.error_estimate < 0.2 for contact in reading.contacts] == [True, True]
    gone = virtual.press([{}, {"tool": (ball, (-6.0, 0.0, 7.0), None)}])
    assert not gone.force_n.any()
    assert gone.resistance_ohm[0].numpy() == pytest.approx(np.broadcast_to(rest, (1, 2, 3)))


def test_bodies_pressed_on_plates_read_by_conduction_as_contacts_do(monkeypatch: pytest.MonkeyPatch):
    """A ball across the gap, in one step without friction as `press` has it: forces to 2 %, readings to 2 % as well."""
    pair = SensorDesign(array=Array(rows=1, cols=2), pad=Pad(kind="stiff"), electrics=Electrics(model="conduction"))
    surface = coarse_surface(pair, 1, 3)
    monkeypatch.setattr("hardware.virtual.sensor.surface_compliance", lambda design: (surface, None, True))
    held = surface.conducted
    pads = replace(held, influence_mm_per_n=np.zeros((*held.sign.shape, 1, 2, 3)))  # which presses do not ask
    virtual = VirtualSensor(pair, response=replace(made_up_response(pair), conducted=pads))
    reading = virtual.press([{"ball": (Capsule(8.0), (0.5, 1.0, 7.2), None)}], friction=0.0)
    expected = samples_of([press(surface, Capsule(8.0), 0.8, at_mm=(0.5, 1.0))])
    rest = exact_resistances(held.rest_mm[0, 0, :, 0], pair)
    for found, known in (
        (reading.force_n[0].numpy(), expected.force_n[0]),
        (reading.resistance_ohm[0].numpy() - rest, expected.resistance_ohm[0] - rest),
    ):
        assert np.linalg.norm(found - known) < 0.02 * np.linalg.norm(known)
    assert np.linalg.norm(expected.effective_length_mm - expected.length_mm) > 0.1


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({}, "no model to decode with"),
        ({"environments": 0}, "environments=0, dead_probability=0.0 must be"),
        ({"crossbar": Crossbar()}, "the crossbar has 6 × 6 units, the design 2 × 3"),
        ({"crossbar": Crossbar(rows=2, cols=3), "bits": 12}, "has a converter of its own"),
    ],
)
def test_what_makes_no_sense_is_refused(response, settings, said):
    with pytest.raises((ArgumentError, DesignError), match=said):
        VirtualSensor(DESIGN, response=response, **settings).forces(torch.ones(1, 2, 3, 3))


def test_broken_pillars_are_left_out_as_by_the_model_itself(response, samples, model):
    """Each environment another one; what stands in its place has derivatives by the others."""
    ohms = samples.resistance_ohm.copy()
    ohms.reshape(40, -1)[np.arange(40), np.arange(40) % 18] = OPEN_OHM
    read = torch.from_numpy(ohms).requires_grad_()
    found = sensor(response, model=model, dtype=torch.float64).forces(read)
    assert np.abs(found.detach().numpy() - model.forces(ohms)).max() < 1e-9 * np.abs(samples.force_n).max()
    assert np.abs(found.detach().numpy() - samples.force_n).max() < np.abs(samples.force_n).max()
    found.sum().backward()
    assert (read.grad.reshape(40, -1)[np.arange(40), np.arange(40) % 18] == 0).all()
    assert (read.grad != 0).any()


def test_a_model_of_finite_strain_reads_decodes_and_has_derivatives():
    """Readings are its maps' under the very forces, decoded as by itself, broken pillars too; slopes are slopes."""
    model, test = learned()
    assert isinstance(model, DecouplerAtStrain)
    virtual = VirtualSensor(model.design, model, environments=20)
    force_n = torch.from_numpy(test.force_n[:20]).requires_grad_()
    shown = virtual.resistances(force_n)
    exact = model.posterior.forward.resistances(test.force_n[:20].reshape(20, -1)).reshape(shown.shape)
    np.testing.assert_allclose(shown.detach().numpy(), exact, rtol=1e-9)
    read = shown.detach().numpy().copy()
    read.reshape(20, -1)[np.arange(10), np.arange(10) % 6] = OPEN_OHM
    expected = model.forces(read)
    decoded = virtual.forces(torch.from_numpy(read)).numpy()
    np.testing.assert_allclose(decoded, expected, atol=1e-9 * np.abs(expected).max())
    weight = torch.randn((*shown.shape[:3], 3), generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def score(force_n: torch.Tensor) -> torch.Tensor:
        return (virtual.forces(virtual.resistances(force_n)) * weight).sum()

    slopes = torch.autograd.grad(score(force_n), force_n)[0]
    step = 1e-4 * torch.randn(force_n.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = (score(force_n + step) - score(force_n - step)) / 2
    assert float((slopes * step).sum()) == pytest.approx(float(found.detach()), rel=1e-5)
