"""One rubber, its contacts and its temperature, by every way to a reading: files, simulations of others, boards."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from common.errors import ArgumentError
from dataset import DatasetSettings, Imperfections, pillar_resistances, rest_resistances, simulate
from dataset.memory import broken_contacts, relaxed_forces
from dataset.resistance import pillar_lengths
from decoupler.data.columns import COMPONENTS, force_columns
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.baseline import hooke_forces
from fem.array.closed_forms import layer_response
from fem.array.solving import ResponseSettings, response_cache_key
from geometry import Array, DesignError, SensorDesign
from geometry.design import Electrics, Material, Memory, Prony
from geometry.layout import pillar_volumes, rest_lengths
from hardware.boards.simulated import STEP_S, PressAndSlide, counts_over_time, press_and_slide
from hardware.readout.crossbar import Crossbar
from hardware.virtual import VirtualSensor

MEMORY = Memory(a=(0.4, 0.3), b_lengthen=2.0, b_shorten=9.0, tau_s=(2.0, 90.0), g1=1.0, g2=-2.0)
PRONY = Prony(share=(0.05, 0.04), tau_s=(1.0, 40.0))
CONTACT = Electrics(contact_ohm=300.0)
ROWS, COLS = 1, 2
PLAIN = SensorDesign(array=Array(rows=ROWS, cols=COLS))


def response_of(**changed):
    return layer_response(replace(PLAIN, **changed))


def of_pads(response, **more):
    return simulate(response, DatasetSettings(protocol="three-axis", samples=400, seed=2, **more))


@pytest.fixture(scope="module")
def bulk_ohm():
    return of_pads(response_of()).resistance_ohm


def test_a_pillar_shows_both_its_contacts_and_the_decoder_knows(bulk_ohm):
    response = response_of(electrics=CONTACT)
    read = of_pads(response)
    assert read.resistance_ohm == pytest.approx(bulk_ohm + 600.0, rel=1e-14)
    assert rest_resistances(response.design) == pytest.approx(rest_resistances(PLAIN) + 600.0)
    forward, joint = SensorModel.of(response, COMPONENTS["all"]), COMPONENTS["all"]
    assert (forward.offset_ohm == 600.0).all()
    modelled = forward.resistances(force_columns(read.force_n, joint))
    assert modelled == pytest.approx(read.resistance_ohm.reshape(len(modelled), -1), rel=1e-12)
    alone = hooke_forces(bulk_ohm, PLAIN, joint)
    assert hooke_forces(read.resistance_ohm, response.design, joint) == pytest.approx(alone, rel=1e-9)


def test_rubber_warms_and_differs_and_contacts_do_not(bulk_ohm):
    response = response_of(electrics=replace(CONTACT, temperature_coefficient=-2e-3))
    specimen = {"gain_spread": 0.1, "specimen": 4}
    gain, _ = Imperfections(**specimen).gain_and_offset(ROWS, COLS)
    read = of_pads(response, temperature_rise=20.0, **specimen).resistance_ohm
    assert read == pytest.approx(0.96 * gain * bulk_ohm + 600.0, rel=1e-12)
    warm = replace(CONTACT, temperature_coefficient=-0.01)
    with pytest.raises(DesignError, match="temperature_rise=300 leaves no resistance"):
        Imperfections(temperature_rise=300.0).gain_and_offset(1, 1, warm)


def test_pillars_share_the_contact_of_their_electrode():
    electrics = Electrics(contact_ohm=100.0, contact_spread=0.3)
    gain, offset = Imperfections(specimen=3).gain_and_offset(60, 60, electrics)
    assert (gain == 1.0).all()
    z, x, y = np.moveaxis(200.0 + offset, -1, 0).reshape(3, -1)  # of L1 and U1, L2 and U1, L1 and U2
    assert min(z.min(), x.min(), y.min()) > 0
    assert z.mean() == pytest.approx(200.0, rel=0.01)
    assert z.std() == pytest.approx(np.sqrt(2.0) * 30.0, rel=0.05)
    shared = np.corrcoef([z, x, y])
    assert [shared[0, 1], shared[0, 2], shared[1, 2]] == pytest.approx([0.5, 0.5, 0.0], abs=0.05)
    other = Imperfections(specimen=4).gain_and_offset(60, 60, electrics)[1]
    assert abs(np.corrcoef(offset.ravel(), other.ravel())[0, 1]) < 0.05


def test_a_simulation_of_others_reads_what_a_file_holds():
    """Two ways to one reading: series of a data set, and a state that is carried from touch to touch."""
    response = response_of(pillar_material=Material(memory=replace(MEMORY, direction="loading")), electrics=CONTACT)
    asked = DatasetSettings(protocol="three-axis", samples=2, seed=2, history_s=12.0, rate_hz=10.0)
    series = simulate(response, asked)
    sensor = VirtualSensor(response.design, environments=2, response=response)
    force_n = torch.tensor(series.force_n)

    def read(k: int) -> np.ndarray:
        return sensor.resistances(force_n[:, k], 0.1).numpy()

    for k in range(len(series.time_s)):
        assert read(k) == pytest.approx(series.resistance_ohm[:, k], rel=1e-12)
    before = read(len(series.time_s) - 1)
    sensor.reset(torch.tensor([1]))
    assert read(0)[1] == pytest.approx(series.resistance_ohm[1, 0], rel=1e-12)  # it forgot
    assert not np.allclose(before, sensor.resistances(force_n[:, -1]), rtol=1e-3)  # without a time nothing remembers


def test_a_touch_of_rubber_that_remembers_needs_a_time_and_has_derivatives():
    response = response_of(pillar_material=Material(memory=MEMORY))
    sensor = VirtualSensor(response.design, environments=2, response=response, memory_spread=0.2, seed=1)
    place = torch.tensor([[[-7.5, 0.0]]] * 2, dtype=torch.float64)
    force_n = torch.tensor([[[0.0, 0.0, 300.0]]] * 2, dtype=torch.float64, requires_grad=True)
    for seconds in (None, 0.0, float("nan")):
        with pytest.raises(ArgumentError, match="this rubber remembers: say how many passed"):
            sensor.touch(place, force_n, seconds)
    one, other = sensor.touch(place, force_n, 0.02).resistance_ohm[:, 0, 0].detach().numpy()
    assert np.abs(one / other - 1.0).max() > 1e-3  # each environment has pillars of its own
    later = sensor.touch(place, force_n, 5.0).resistance_ohm
    later[0, 0, 0, 0].backward()
    assert force_n.grad is not None
    assert force_n.grad[0, 0, 2] < 0.0
    assert later[0, 0, 0, 0] < one[0]  # contacts heal while it is held
    plain = VirtualSensor(PLAIN, response=response_of())
    touched = plain.touch(place[:1], force_n[:1]).resistance_ohm
    assert torch.equal(plain.touch(place[:1], force_n[:1], 0.02).resistance_ohm, touched)


def test_contacts_and_warmth_of_simulated_environments():
    electrics = Electrics(contact_ohm=100.0, contact_spread=0.3, temperature_coefficient=1e-3)
    response = response_of(electrics=electrics)
    sensor = VirtualSensor(response.design, environments=3000, response=response, temperature_rise=50.0)
    rest = torch.zeros((3000, ROWS, COLS, 3), dtype=torch.float64)
    both = sensor.read(sensor.resistances(rest)).numpy() - 1.05 * rest_resistances(PLAIN)
    assert both.mean(axis=(0, 1, 2)) == pytest.approx(200.0, rel=0.02)
    assert both.std(axis=0) == pytest.approx(np.sqrt(2.0) * 30.0, rel=0.1)


def test_a_board_has_gone_through_its_motion_for_ever():
    """After many periods states repeat; those of the motion are these."""
    response, script = response_of(pillar_material=Material(memory=MEMORY, prony=PRONY)), PressAndSlide(seconds=3.0)
    plain, motion = (press_and_slide(each, script) for each in (response_of(), response))
    steps, periods, design = len(plain.force_n), 300, response.design
    volume, rest_mm = pillar_volumes(design.unit), rest_lengths(design.unit)
    length_mm = np.sqrt(plain.resistance_ohm * volume / design.resistivity_ohm_mm)
    strain = np.tile(length_mm / rest_mm - 1.0, (periods, 1, 1, 1))
    q = broken_contacts(strain, STEP_S, MEMORY)[:, -steps:]
    rise = MEMORY.g1 * strain[:steps] + MEMORY.g2 * strain[:steps] ** 2 + np.tensordot(MEMORY.a, q, axes=1)
    bulk_ohm = pillar_resistances(length_mm, volume, design.resistivity_ohm_mm)
    assert motion.resistance_ohm == pytest.approx(bulk_ohm * np.exp(rise), rel=1e-6)  # exp(-900 s / 90 s) is left
    forces = relaxed_forces(np.tile(plain.force_n, (periods, 1, 1, 1)), STEP_S, PRONY)[-steps:]
    assert motion.force_n == pytest.approx(forces, abs=1e-6)
    crossbar = Crossbar(rows=ROWS, cols=COLS)
    cold, warm = (
        counts_over_time(motion.resistance_ohm, crossbar, Imperfections(temperature_rise=rise), contacts)
        for rise, contacts in ((0.0, None), (50.0, Electrics(temperature_coefficient=2e-3)))
    )
    assert np.median(warm / cold) == pytest.approx(1 / 1.1, abs=0.01)


def test_what_electricity_and_memory_change_bends_nothing():
    changed = replace(PLAIN, electrics=replace(CONTACT, temperature_coefficient=1e-3), resistivity_ohm_mm=9.0)
    changed = replace(changed, pillar_material=Material(memory=MEMORY, prony=PRONY))
    assert response_cache_key(changed, ResponseSettings()) == response_cache_key(PLAIN, ResponseSettings())
    assert pillar_lengths(np.zeros((2, 3)), changed.unit) == pytest.approx(rest_lengths(PLAIN.unit))
