"""What every decoder keeps, whatever sensor it decodes and whatever it learned from: decoders × guarantees."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from dataset import Imperfections, Samples, measured
from decoupler import Decoupler, NetworkConfig, SampleError, read_model, train, write_model
from decoupler.data.columns import DEAD_OHM, Resting, pillar_columns
from decoupler.data.pairs import Pairs
from decoupler.evaluation.faults import FaultTest
from decoupler.export import export_model
from decoupler.export.c_header import header_text
from decoupler.export.checked import traced
from decoupler.export.onnx_file import onnx_model
from decoupler.export.traced import ExportError
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoder import Decoder
from decoupler.model.tensors import in_torch
from decoupler.touch.decoder import TouchDecoder
from decoupler.twin import identify
from geometry.design import Electrics
from geometry.wiring import pillars_of_wires
from tests.decoupler import test_finite_strain as finite
from tests.decoupler import test_touch as touch
from tests.decoupler.exported_forms import CC, by_header, by_onnx
from tests.decoupler.synthetic_sensor import ALL, RESPONSE, SMALL, conducted, labelled, response, sensor

OTHERS = ("six-pillar", "eight-pillar", "upright-four")  #: layouts
AXES = {"fz": "z", "fx": "x", "fy": "y", "all": "xyz"}
DEAD = np.zeros((2, 3, 3), dtype=bool)
DEAD[0, 1], DEAD[1, 2, 0] = True, True
DRIFTS = {"drift": 0.005, "drift_tilt": 0.005, "drift_pillar": 0.002, "drift_offset_ohm": 50.0}
ROUNDING = 1e-9  #: of full scale; double leaves some 1e-15, from another order of sums
SCANS = 5  #: looked at one by one
OTHER_ORDER = 5.0  #: another order of sums rounds to float as much, to its order


@dataclass(frozen=True)
class Case:
    """A decoder, and scans of its sensor that it has not seen."""

    model: Decoupler
    test: Samples
    most: float = 0.8  #: of errors, that 68 % deviations hold


def read(data: Samples, **errors: float) -> Samples:
    """Samples as a specimen with gains, offsets, noise and converter shows them."""
    settings = Imperfections(specimen=1, **errors)
    drawn = settings.apply(data.resistance_ohm, np.random.default_rng(0), layout=data.layout)
    return replace(data, resistance_ohm=drawn, noise=settings.noise, bits=settings.bits)


def linear(of: str = "all", net: str = "skip", feature: str = "inverse", layout: str = "song2018", **errors) -> Case:
    design, form = sensor(2, 3, layout), NetworkConfig(hidden=6, net=net, feature=feature)
    data = read(labelled(design, AXES[of], 800, seed=0), **errors)
    return Case(train(data[:600], of, form, response=response(design)), data[600:])


def dead(feature: str, stays: bool = False) -> Case:
    """Dead pillars and a specimen's gains and offsets, by a converter; or pillars that stay, unstated."""
    data = read(labelled(SMALL, "xyz", 500, seed=0), gain_spread=0.2, offset_ohm=200.0, noise=1e-3, bits=12)
    stuck_ohm = np.array([1e9, 3e3, 3e3]) + np.random.default_rng(5).uniform(-30.0, 30.0, data.resistance_ohm.shape)
    read_ohm = np.where(DEAD, stuck_ohm if stays else np.nan, data.resistance_ohm)
    data = replace(data, resistance_ohm=read_ohm, dead=None if stays else DEAD)
    return Case(train(data[:300], "all", NetworkConfig(hidden=5, feature=feature), response=RESPONSE), data[300:])


def conducting() -> Case:
    given = conducted(0.5)
    data = labelled(SMALL, "xyz", 500, seed=0)
    ohms = SensorModel.of(given, ALL).resistances(data.force_n.reshape(500, -1))
    data = read(replace(data, resistance_ohm=ohms.reshape(data.resistance_ohm.shape)), noise=1e-3)
    return Case(train(data[:300], "all", NetworkConfig(feature="inverse"), response=given), data[300:])


def drifting() -> Case:
    """The design states drifts, and the training data have none."""
    stated = replace(SMALL, electrics=Electrics(**DRIFTS))
    data = replace(labelled(SMALL, "xyz", 2200, seed=0), design=stated, noise=1e-3)
    model = train(read(data[:2000], noise=1e-3), response=replace(RESPONSE, design=stated))
    return Case(model, read(data[2000:], noise=1e-3, **DRIFTS))


def identified(layout: str = "song2018") -> Case:
    design = sensor(2, 3, layout)
    data = read(labelled(design, "xyz", 220, seed=0), gain_spread=0.1, offset_ohm=100.0, noise=1e-3)
    return Case(identify(Pairs.of(data[:20]), response(design)).decoder, data[20:])


#: by what is particular about each; noise-free ones learn nothing but what the response leaves
CASES: dict[str, Callable[[], Case]] = {
    "fz-plain-resistance": lambda: linear("fz", "plain", "resistance"),
    "fz-inverse": lambda: linear("fz", bits=12),
    "fy-skip-root": lambda: linear("fy", "skip", "root", noise=1e-3, bits=12),
    "all-skip-root": lambda: linear("all", "skip", "root", noise=1e-3),
    "convolution": lambda: linear("all", "convolution", "root", noise=1e-3),
    "convolution-inverse": lambda: linear("all", "convolution", "inverse", "six-pillar", noise=1e-3, bits=12),
    "exact": linear,
    "noisy": lambda: linear(noise=2e-3),
    "converter": lambda: linear(noise=1e-2, bits=12),
    "dead-inverse": lambda: dead("inverse"),
    "dead-root": lambda: dead("root"),
    "conduction": conducting,
    "drifts": drifting,
    "identified": identified,
    **{layout: lambda layout=layout: linear(layout=layout, noise=1e-3, bits=12) for layout in OTHERS},
    **{f"fx-{layout}": lambda layout=layout: linear("fx", "skip", "root", layout, noise=1e-3) for layout in OTHERS},
    "identified-six-pillar": lambda: identified("six-pillar"),
    "identified-finite-strain": lambda: Case(finite.identified()[0].decoder, finite.identified()[1], 0.85),
    "finite-strain": lambda: Case(*finite.learned()),
    "finite-strain-six-pillar": lambda: Case(*finite.learned("six-pillar")),
}
made = cache(lambda name: CASES[name]())


def place_of(model: Decoder) -> tuple[int, int, int]:
    """A pillar that it reads."""
    return tuple(np.argwhere(model.read)[-1])


def true_n(case: Case) -> np.ndarray:
    return case.test.force_n[..., ["xyz".index(axis) for axis in case.model.component.axes]]


def off_n(case: Case, ohms: np.ndarray) -> np.ndarray:
    return case.model.forces(ohms) - true_n(case)


def off_and_half_n(case: Case, ohms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors, and half-widths that hold 95 % of them: of touches by decoding once."""
    if not isinstance(case.model, TouchDecoder):
        return off_n(case, ohms), case.model.half_widths(ohms)[1]
    both = [(each.force_n, each.half_widths_n[1]) for each in case.model.touches(ohms)]
    force_n, half_n = np.moveaxis(both, 1, 0).reshape(2, *case.test.force_n.shape)
    return force_n - true_n(case), half_n


def trusted(model: Decoder) -> np.ndarray:
    """Which forces (rows, cols, n_axes) it does not call unknown."""
    found = np.ones((model.rows, model.cols, len(model.component.axes)), dtype=bool)
    for row, col, name in model.untrusted() if isinstance(model, Decoupler) else ():
        found[row, col, model.component.forces.index(name)] = False
    return found


def of_net_force(model: Decoder) -> np.ndarray:
    """Weights (m, 1) of a unit's loads in the sum of the forces along its last axis that it trusts."""
    axes = len(model.component.axes)
    weights = np.zeros((model.rows, model.cols, getattr(model, "n_loads", axes), 1))
    weights[:, :, axes - 1, 0] = trusted(model)[..., -1]
    return weights.reshape(-1, 1)


@pytest.fixture(params=CASES, scope="module")
def case(request) -> Case:
    """One after another with all their guarantees, so that several processes make few of them twice."""
    return made(request.param)


def test_deviations_hold_on_unseen_scans(case):
    """200 scans: errors of one scan go together, so that the shares are known to some points."""
    off, (one, two) = np.abs(off_n(case, case.test.resistance_ohm)), case.model.half_widths(case.test.resistance_ohm)
    assert 0.6 < (off <= one)[:, trusted(case.model)].mean() < case.most  # what is promised of every decoder
    assert (off <= two)[:, trusted(case.model)].mean() > 0.92


def test_derivatives_are_slopes(case):
    """Differences over a millionth of the resistances; 1e-6 of the largest is their own error."""
    front = case.model.front
    front = replace(front, resting=Resting.read_with(front.resting.rest_ohm, None))  # a converter's rest is a step
    model = replace(case.model, front=front)
    R = model.columns(case.test.resistance_ohm[:2])
    step = 1e-6 * R * np.random.default_rng(0).standard_normal(R.shape)
    differences = (model.first_answers(R + step) - model.first_answers(R - step)) / 2
    found = np.einsum("nom,nm->no", model.derivatives(R), step)
    np.testing.assert_allclose(found, differences, rtol=0, atol=1e-6 * np.abs(differences).max())


def test_other_forms_give_its_forces(case, tmp_path):
    """Torch, ONNX and C, one scan as many, but for rounding; what learned finite strain refuses the last two."""
    model, scans = case.model, case.test.resistance_ohm[:SCANS]
    rest_ohm = model.rest_resistances()
    scans = np.concatenate([scans, rest_ohm[None] + 1.0])  # which a converter cannot tell from rest
    columns = torch.from_numpy(pillar_columns(scans, model.component, model.layout, model.dead))
    assert not model.dead.any() or (columns == DEAD_OHM).any()
    tensors = in_torch(model, columns.new_zeros(())).outputs(columns).numpy()
    expected = model.forces(scans)
    exact = ROUNDING * np.abs(expected).max()
    single = 1e3 if isinstance(model, DecouplerAtStrain) and model.is_identified else 1.0  # its draws' precision
    np.testing.assert_allclose(tensors.reshape(expected.shape), expected, rtol=0, atol=single * exact)
    if isinstance(model, DecouplerAtStrain):
        with pytest.raises(ExportError, match="are not exported"):
            export_model(model, tmp_path / "model.h")
        return
    for dtype in (np.float64, np.float32):
        graph = traced(model, scans.astype(dtype))
        rounded_n = np.abs(graph.values - expected).max()
        assert rounded_n < (exact if dtype is np.float64 else 1e-5 * np.abs(expected).max())
        allowed = exact if dtype is np.float64 else OTHER_ORDER * rounded_n
        content, header = onnx_model(graph, {}).SerializeToString(), header_text(graph, {})
        forms = [by_onnx(content, scans, dtype), by_onnx(content, scans[:1], dtype)]
        forms += [by_header(header, scans, dtype)] if CC is not None else []
        for found in forms:
            assert found.shape[1:] == expected.shape[1:]
            assert (np.abs(found - expected[: len(found)]) < allowed).all()


def plates(name: str) -> Case:
    """2 × 2 stiff pads on coarse cells, of one or two contacts."""
    decoder, loads, ohms = touch.made_plates(name)
    return Case(decoder, SimpleNamespace(resistance_ohm=ohms, force_n=loads[:, :, :3].reshape(60, 2, 2, 3)))


EVERY = CASES | {f"plates-{name}": lambda name=name: plates(name) for name in ("six-pillar", "song2018", "conduction")}
EVERY["bare"] = lambda: Case(touch.made_decoder(), touch.made_contacts()[:10])
each_made = cache(lambda name: EVERY[name]() if name not in CASES else made(name))
intact_n = cache(lambda name: off_n(each_made(name), each_made(name).test.resistance_ohm))
#: least share that 95 % deviations of the unit with a broken pillar hold, where it is not 0.9: two pillars of three
#: leave a force to the usual loads, and those of these tests are wider than the ones that such decoders know
LEAST_HELD = {"finite-strain": 0.85, "identified": 0.85}
#: the same of 68 % deviations under errors besides, and of 95 % of the net force: what learned exact readings knows
#: none, where pillars are few or dead the usual loads bias the sum
LEAST_OF_ONE = {"exact": 0.4, "finite-strain": 0.55, "finite-strain-six-pillar": 0.55, "bare": 0.92}
LEAST_NET_HELD = {"exact": 0.8, "upright-four": 0.7, "all-skip-root": 0.75, "plates-song2018": 0.75, "drifts": 0.92}
LEAST_NET_HELD |= {"dead-inverse": 0.65, "dead-root": 0.7}


@pytest.fixture(params=EVERY, scope="module")
def every(request) -> tuple[str, Case]:
    """The same; presses of the library are those of other tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", f"{os.environ['TRIPILLAR_TESTS']}/cache")
        return request.param, each_made(request.param)


def test_its_file_gives_the_same_bits(every, tmp_path):
    """Forces, deviations, tests of loads and of pillars, the mark to beat."""
    model, ohms = every[1].model, every[1].test.resistance_ohm[:1]
    write_model(model, tmp_path / "model.safetensors")
    again = read_model(tmp_path / "model.safetensors")
    assert (type(again), again.made_from) == (type(model), model.made_from)
    answers = [
        lambda model: model.forces(ohms),
        lambda model: model.half_widths(ohms),
        lambda model: model.deviations(ohms, of_net_force(model))[1],
        lambda model: model.consistency(ohms),
        lambda model: (test := FaultTest.of(model)) and test.named(every[1].test.resistance_ohm[:40]),
    ]
    if isinstance(model, Decoupler):
        answers += [lambda model: model.untrusted()]
        answers += [lambda model: model.least_squares and model.least_squares.forces(ohms)]
    for answer in answers:
        np.testing.assert_array_equal(answer(again), answer(model))


def test_a_scan_alone_gives_the_bits_of_the_batch(every):
    model, ohms = every[1].model, every[1].test.resistance_ohm
    ohms = ohms[:SCANS] if isinstance(model, TouchDecoder) else ohms  # which it decodes one by one
    batch = model.forces(ohms)
    assert batch.shape == (*ohms.shape[:3], len(model.component.axes))
    for size in (1, 3):
        parts = [model.forces(ohms[start : start + size]) for start in range(0, SCANS, size)]
        np.testing.assert_array_equal(np.concatenate(parts)[:SCANS], batch[:SCANS])


def test_what_is_no_scan_is_refused_and_what_is_not_read_does_no_harm(every):
    model, ohms = every[1].model, every[1].test.resistance_ohm[:SCANS]
    below = ohms.copy()
    below[(4, *place_of(model))] = -1.0
    for given, said in (
        (below, "resistance_ohm is -1.0 at sample 4, row ., col ., pillar .*; it must be|not finite or not above 0"),
        (ohms[0], r"expected \(n"),
        (np.repeat(ohms, 2, axis=1), r"of \d × \d units, the model's sensor has \d × \d|expected \(n|^dead has shape"),
    ):
        with pytest.raises(SampleError, match=said):
            model.forces(given)
    one = ohms[:1]
    assert np.array_equal(model.forces(np.where(model.read, one, np.nan)), model.forces(one))


def test_rest_is_within_its_deviations_and_no_strange_load(every):
    """As it reads with its noise and converter; networks that know no response have not seen it."""
    model = every[1].model
    if isinstance(model, Decoupler) and model.inverse is None:
        return
    rest_ohm = np.repeat(model.rest_resistances()[None], 50, axis=0)
    read_ohm = model.errors.read(rest_ohm, np.random.default_rng(0))
    force_n = model.forces(read_ohm)
    assert (np.abs(force_n) <= model.half_widths(read_ohm)[1]).mean() > 0.94
    assert isinstance(model, Decoupler) or not force_n.any()  # of touches one in a million is promised
    assert not np.greater(*model.consistency(read_ohm)).any()


def test_a_sensor_at_rest_reads_nothing_though_each_pillar_is_half_a_step_off():
    """10 kΩ before 10 kΩ is the worst place, between two counts. The calibration of 600 samples leaves a fifth."""
    model, rest_ohm = made("fz-inverse").model, np.full((1, 2, 3, 3), 1e4)
    read_ohm = measured(rest_ohm, 0.0, 12, np.random.default_rng(0))
    assert np.abs(read_ohm - rest_ohm).min() > 4.8
    plain = replace(model, front=replace(model.front, resting=Resting.read_with(model.front.resting.rest_ohm, None)))
    assert np.abs(model.forces(read_ohm)).max() < 0.2 * np.abs(plain.forces(read_ohm)).max()
    read_ohm[:, 0] *= 0.95  # where most of a scan is loaded, none of it is taken to rest
    read_ohm[:, 1, 0] *= 0.95
    np.testing.assert_array_equal(model.forces(read_ohm), plain.forces(read_ohm))


@pytest.mark.parametrize("kind", ["drift", "10 bits", "of each pillar"])
def test_errors_that_readings_have_besides_are_in_all_deviations(every, kind):
    """Of units and of the net Fz: 0.5 % shared, coarser steps, 1 % as of memory; untold, fewer hold."""
    name, case = every
    ohms, generator = case.test.resistance_ohm, np.random.default_rng(3)
    drifts = (name != "drifts") * 0.005 * generator.standard_normal((len(ohms), 1, 1, 1))
    errors, own, read_ohm = {
        "drift": ({"drift": 0.005}, None, ohms * (1.0 + drifts)),
        "10 bits": ({"bits": 10}, None, measured(np.where(case.model.read, ohms, 1e4), 0.0, 10, generator)),
        "of each pillar": ({}, np.full(ohms.shape, 0.01), ohms * (1.0 + 0.01 * generator.standard_normal(ohms.shape))),
    }[kind]
    weights, where, held = of_net_force(case.model), trusted(case.model), []
    told = case.model.read_by(replace(case.model.errors, **errors)), own
    for model, besides in [told] if name in ("drifts", "plates-song2018") else [told, (case.model, None)]:
        decoded = model.decoded(read_ohm, weights, besides)
        one, covariance = decoded.stated or model.deviations(read_ohm, weights, besides)
        off = decoded.force_n - true_n(case)
        net_n = np.abs((off * where)[..., -1].sum(axis=(1, 2)))
        held.append([(np.abs(off) <= one)[:, where].mean(), (net_n**2 <= 4.0 * covariance[:, 0, 0]).mean()])
    assert held[0][0] > LEAST_OF_ONE.get(name, 0.6)
    assert held[0][1] > LEAST_NET_HELD.get(name, 0.9 if kind == "drift" else 0.85)
    assert len(held) == 1 or held[1][0] < held[0][0]


def test_few_errors_of_the_net_force_under_stated_drifts_are_avoidable():
    """A tenth above the linear-Gaussian posterior about each load, C − C Jᵀ (J C Jᵀ + Σ)⁻¹ J C; and they are stated."""
    model, test = made("drifts").model, made("drifts").test
    weights, forward = of_net_force(model), SensorModel.of(RESPONSE, ALL)
    C = np.cov(labelled(SMALL, "xyz", 2000, seed=3).force_n.reshape(2000, -1).T)
    force_n = test.force_n.reshape(200, -1)
    lengths, J = forward.jacobian(force_n)
    ohm = forward.ohm_per_mm2 * lengths**2
    J, shared = (2.0 * ohm / lengths)[..., None] * J, model.errors.shared(ohm, 2, 3)
    S = J @ C @ J.swapaxes(1, 2) + shared @ shared.swapaxes(1, 2)
    S += model.errors.deviation(ohm)[..., None] ** 2 * np.eye(18)
    least = C - C @ J.swapaxes(1, 2) @ np.linalg.solve(S, J @ C)
    off = ((model.forces(test.resistance_ohm).reshape(200, -1) - force_n) @ weights) ** 2
    stated = model.deviations(test.resistance_ohm, weights)[1]
    assert off.mean() < 1.1**2 * (weights.T @ least @ weights).mean()
    assert stated.mean() > 0.8**2 * off.mean()


def test_a_pillar_that_stays_is_named_and_sound_ones_are_not(every):
    """At its last value, through a window of scans, unless 1 % of noise hides it; nor is one that rests."""
    name, case = every
    if (test := FaultTest.of(case.model)) is None:
        return
    ohms, (row, col, pillar) = case.test.resistance_ohm[: test.window].copy(), place_of(case.model)
    assert test.named(ohms) == ()
    ohms[:, row, col, pillar] = ohms[0, row, col, pillar]
    said = f"pillar {case.model.layout.pillar_names[pillar]} of row {row}, col {col} stuck"
    assert [str(fault) for fault in test.named(ohms)] == [said] * (name != "converter")
    rest_ohm = np.repeat(case.model.rest_resistances()[None], test.window, axis=0)
    assert test.named(case.model.errors.read(rest_ohm, np.random.default_rng(5))) == ()


@pytest.mark.parametrize("reads", ["open", "shorted", "ten times as much"])
def test_a_pillar_that_fails_is_named_and_left_out(every, reads):
    """In the same scan: its own unit's deviations hold, and where pillars are to spare other units hardly err more."""
    name, case = every
    model, ohms, (row, col, pillar) = case.model, case.test.resistance_ohm.copy(), place_of(case.model)
    own = ohms[:, row, col, pillar]
    ohms[:, row, col, pillar] = {"open": 1e9, "shorted": 1.0, "ten times as much": 10.0 * own}[reads]
    lost = model.lost(ohms)
    assert np.argwhere(lost.all(axis=0)).tolist() == np.argwhere(lost.any(axis=0)).tolist() == [[row, col, pillar]]
    assert not model.unreliable(lost).any()
    (off, half), intact = off_and_half_n(case, ohms), intact_n(name)
    assert (np.abs(off) <= half)[:, row, col].mean() >= LEAST_HELD.get(name, 0.9)
    assert (np.abs(off) <= half).mean() >= min(LEAST_HELD.get(name, 0.9), 0.9)
    others = np.ones(off.shape[1:], dtype=bool)
    others[row, col] = False
    if len(model.component.pillars(model.layout)) > len(model.component.axes) + 1 or name == "bare":
        assert np.sqrt((off[:, others] ** 2).mean()) <= 1.5 * np.sqrt((intact[:, others] ** 2).mean())
    if not isinstance(model, Decoupler):
        rest_ohm = model.rest_resistances()[None].copy()
        rest_ohm[0, row, col, pillar] = ohms[0, row, col, pillar]
        assert not model.forces(rest_ohm).any()


@pytest.mark.parametrize("feature", ["inverse", "root"])
def test_pillars_that_stay_in_training_are_masked_and_their_units_named(feature):
    """Stuck or open: to the bit the model of pillars that are stated as dead, whether they are alive later or not."""
    stated, test = made(f"dead-{feature}").model, made(f"dead-{feature}").test
    found = dead(feature, stays=True).model
    assert np.array_equal(found.dead, DEAD)
    assert found.untrusted() == stated.untrusted()
    assert {(row, col) for row, col, _ in found.untrusted()} | {(1, 2)} == {(0, 1), (1, 2)}
    alive_ohm = labelled(SMALL, "xyz", 500, seed=0).resistance_ohm[300:]
    for ohms in (test.resistance_ohm, np.where(DEAD, alive_ohm, test.resistance_ohm)):
        assert np.array_equal(found.forces(ohms), stated.forces(test.resistance_ohm))
    assert np.abs(off_n(Case(stated, test), test.resistance_ohm)).max() < 576  # the range


def test_without_a_whole_wire_forces_are_finite_and_said_to_be_unreliable(every):
    model, ohms = every[1].model, every[1].test.resistance_ohm.copy()
    wire = max(pillars_of_wires(model.rows, model.cols, model.layout), key=len)
    ohms.reshape(len(ohms), -1)[:, wire] = 1e9
    off, half = off_and_half_n(every[1], ohms)
    assert np.isfinite(off).all()
    assert (np.abs(off) <= half).mean() > 0.7
    taken = np.isin(wire % len(model.layout.pillars), model.component.pillars(model.layout)).all()
    assert model.unreliable(model.lost(ohms)).all() == (taken and not model.dead.any())


def test_readings_of_another_sensor_are_told(every):
    """Gains of 0.7 to 1.3. Six pillars alone, ten pairs, three pillars under a plate: fewer or none."""
    name, case = every
    if name == "plates-song2018":
        return
    gains = np.random.default_rng(4).uniform(0.7, 1.3, case.test.resistance_ohm.shape[1:])
    found = case.model.consistency(gains * case.test.resistance_ohm)
    told = found is not None and np.greater(*found).mean()
    assert found is None or told > (0.4 if name.startswith(("fz", "identified-fin")) else 0.9)
    alarms = found is not None and np.greater(*case.model.consistency(case.test.resistance_ohm)).mean()
    assert alarms <= (0.2 if name == "bare" else 0.05)  # of a library of 80 presses


@pytest.mark.parametrize("times", [1e-3, 1e3])
def test_readings_in_another_unit_are_told(every, times):
    """As many Ω as there are kΩ, or the other way: also where a pillar that fails lands among sound ones."""
    model, ohms = every[1].model, times * every[1].test.resistance_ohm[:SCANS]
    ohms[(0, *place_of(model))] = model.rest_resistances()[place_of(model)]
    chi2, limit = model.consistency(ohms, model.forces(ohms))
    assert (chi2 > 10.0 * limit).all()
