"""Contracts of responses, derivatives, contact and conduction with every ready layout, and with some of one's own."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from dataset.resistance import rest_resistances
from fem.array.closed_forms import layer_response
from fem.array.coupled_cells import CoupledArray
from fem.array.design_cell import DesignCell
from fem.array.response import read_response, write_response
from fem.array.sensitivities import response_sensitivities
from fem.array.solving import ResponseSettings, array_response, solve_response
from fem.conduction.meshes import unit_hexahedra
from fem.conduction.potentials import Conductor, pillars_per_mm, unit_conductances
from fem.contact.compliance import PatchCompliance
from fem.contact.surface import endless_surface
from fem.contact.tiles import Patch
from fem.finite.samples import SampleSolver
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.loads import DeadLoad, StiffLoad
from fem.kernel.system import System
from fem.methods.plan import make_plan
from fem.methods.solving import follow
from fem.scene.scene import Scene, Sensor
from geometry.design import Array, Electrics, Material, Pad, SensorDesign, Unit
from geometry.layout import (
    LAYOUTS,
    Layout,
    electrode_squares,
    pad_squares,
    pillar_areas,
    pillar_ends,
    pillar_volumes,
    rest_lengths,
    unit_centres,
    upper_electrodes,
)
from geometry.layout import Electrode as ElectrodeOf
from geometry.layout import Pillar as PillarOf
from geometry.prism import unit_prisms
from hardware.readout.shunts import shunts
from tests.fem.coarse_plates import conduct_by
from tests.fem.scenes import BESIDE, DIAGONAL, FOUR, coarse_cells, mean, round_of

UNIT = Unit(layout=FOUR)
PAPERS = SensorDesign(array=Array(rows=1, cols=2))
CONDUCTION = Electrics(model="conduction")
SETTINGS = ResponseSettings(tolerance=5e-2)
#: layouts with the paper's electrodes; the one electrode of `single` is in the middle, as its pad
READY = [name for name in LAYOUTS if name != "single"]


def test_conduction_has_every_pillar_and_a_file_keeps_a_layout_of_one_s_own(tmp_path, monkeypatch, shared_cache):
    """On coarse meshes; references read as eq. 1 has them, whatever the loads."""
    coarse_cells(monkeypatch)  # of conduction alone
    conduct_by(monkeypatch, Conductor(unit_hexahedra(UNIT, 2, 1)))
    found = solve_response(replace(PAPERS, unit=UNIT, array=Array(rows=1, cols=1), electrics=CONDUCTION), SETTINGS)
    assert found.influence_mm_per_n.shape == (1, 1, 3, 3, 1, 1, 3)
    conducted = found.conducted
    beside = conducted.with_references(
        Unit(layout=replace(FOUR, pillars=(replace(BESIDE.pillars[3], foot="L1", top="U3"), *FOUR.pillars)))
    )
    assert (beside.rest_mm[..., 0, 0] == np.sqrt(300.0)).all()
    assert not beside.influence_mm_per_n[:, :, 0].any()
    assert np.array_equal(beside.relative_per_n[:, :, 1:], conducted.relative_per_n)
    assert conducted.influence_mm_per_n.shape[:3] == (1, 1, 4)
    at_rest = conducted.rest_mm[..., 0] ** 2 / pillar_volumes(UNIT)
    assert at_rest == pytest.approx(unit_conductances(UNIT).pillars_per_mm[None, None], rel=1e-12)
    write_response(found, tmp_path / "response.nc")
    read = read_response(tmp_path / "response.nc")
    assert (read.content_hash, read.design) == (found.content_hash, found.design)


FORCE_N = np.array([[0.3, -0.2, -1.0], [-0.5, 0.4, -0.6]])


@pytest.fixture(scope="module")
def at_once():
    """Displacements of all places of electrodes under both pads of two units at once, by place, and their error."""
    design = replace(PAPERS, unit=Unit(layout=LAYOUTS["eight-pillar"]))
    loads = [
        DeadLoad(center_mm=(x, y), size_mm=(12.0, 12.0), traction_mpa=tuple(force / 144.0))
        for (x, y), force in zip(unit_centres(design), FORCE_N, strict=True)
    ]
    squares = electrode_squares(design)
    probes = [mean(str(k), ((a + c) / 2, (b + d) / 2), (c - a, d - b)) for k, (a, b, c, d) in enumerate(squares)]
    scene = Scene(
        body=Sensor(design=design), material=design.matrix_material, loads=loads, probes=probes, tolerance=4e-2
    )
    direct = follow(make_plan(scene, field=True), scene)
    return dict(zip(map(tuple, squares.tolist()), direct.probes.values(), strict=True)), direct.error_estimate


@pytest.mark.parametrize("name", READY)
def test_a_response_is_superposed_to_what_one_solve_of_all_loads_finds(name, at_once, shared_cache):
    """On boxes of the whole body: as near as both estimates say."""
    moved, error = at_once
    design = replace(PAPERS, unit=Unit(layout=LAYOUTS[name]))
    response, _, _ = array_response(design, ResponseSettings(tolerance=2e-2))
    superposed = np.tensordot(response.influence_mm_per_n[0, ..., 0, :, :], FORCE_N, axes=2).reshape(-1, 3)
    found = np.array([moved[place] for place in map(tuple, electrode_squares(design).tolist())])
    off = np.linalg.norm(found - superposed, axis=1)
    assert off.max() < (error + response.error_estimate) * np.linalg.norm(superposed, axis=1).min()


def test_a_reference_asks_for_no_response_of_its_own(monkeypatch, shared_cache):
    """The paper's is found in the cache; at rest it is R = ρ l/S by conduction, too, and no shunt of the rubber."""
    conduct_by(monkeypatch, Conductor(unit_hexahedra(Unit(), 2, 1)))
    array_response(PAPERS, SETTINGS)
    design = replace(PAPERS, unit=Unit(layout=BESIDE), electrics=CONDUCTION)
    found, _, reused = array_response(replace(design, electrics=Electrics()), SETTINGS)
    assert (reused, found.design.unit.layout) == (True, BESIDE)
    by_conduction = rest_resistances(design)
    assert by_conduction[3] == pytest.approx(4000.0 * np.sqrt(300.0) / 9.0)
    assert np.array_equal(by_conduction[:3], rest_resistances(replace(design, unit=Unit())))
    assert shunts(BESIDE) == shunts(BESIDE.body)
    assert np.array_equal(unit_conductances(design.unit).matrix_mm, unit_conductances(Unit()).matrix_mm)


@pytest.mark.long  # the short one is that of the paper's unit
def test_conduction_of_four_pillars():
    """NGSolve, order 4 on three levels toward edges, finds 2.58964, 4.18831, 2.66317 and 3.81533 ρ/mm."""
    found = unit_conductances(UNIT)
    assert np.abs(found.matrix_mm.sum(axis=0)).max() < 1e-8
    assert (found.error_estimate < 2e-4).all()
    assert found.pillars_per_mm == pytest.approx([2.58964, 4.18831, 2.66317, 3.81533], rel=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("is_round", [False, True], ids=["square", "round"])
def test_a_pillar_is_as_stiff_as_its_area_and_its_second_moment_say(is_round):
    """One upright pillar in rubber 1e8 times as soft, under a plate, at ν = 0: δ = F h / E A and θ = M h / E I."""
    one = Layout((ElectrodeOf("U", (0, 0)),), (ElectrodeOf("L", (0, 0)),), (PillarOf("p", "L", "U"),))
    h, w, E = 10.0, 3.0, 6.1
    design = SensorDesign(
        unit=Unit(pillar_width_mm=w, layout=round_of(one) if is_round else one),
        array=Array(rows=1, cols=1),
        pad=Pad(kind="stiff"),
        pillar_material=Material(young_mpa=E, poisson=0.0),
        matrix_material=Material(young_mpa=1e-8 * E, poisson=0.0),
    )
    body = DesignCell(design).tetrahedra(0)
    load = StiffLoad(center_mm=(0.0, 0.0), size_mm=(12.0, 12.0), force_n=(0.0, 0.0, -3.0), moment_nmm=(0.0, 5.0, 0.0))
    system = System(body, [load])
    x, _ = checked_solve(Factor(system.rest_matrix(), upper=True), system.full_loads)
    moved = system.displaced(x)[0]
    at = system.plates.node
    fit = np.linalg.lstsq(np.column_stack([np.ones(len(at)), system.points_mm[at, :2]]), moved[at, 2])[0]
    area, second = (np.pi / 4 * w**2, np.pi / 64 * w**4) if is_round else (w**2, w**4 / 12)
    # faces between unequal chords leave round sections that vary by some 5 % along it: its square counts
    assert -fit[0] == pytest.approx(3.0 * h / (E * area), rel=5e-3 if is_round else 1e-4)
    assert -fit[1] == pytest.approx(5.0 * h / (E * second), rel=1e-2 if is_round else 1e-4)


@pytest.mark.long
def test_round_pillars_that_cross_make_few_cells_more_than_square_ones():
    """Six of each in a unit. By 24 sides they make nine times as many, and a response takes ten minutes and more."""
    square, round_one = (
        replace(PAPERS, unit=Unit(layout=layout), pillar_material=Material(young_mpa=0.5))
        for layout in (LAYOUTS["six-pillar"], round_of(LAYOUTS["six-pillar"]))
    )
    bodies = [DesignCell(design).tetrahedra(0) for design in (square, round_one)]
    assert bodies[1].n_nodes < 2.5 * bodies[0].n_nodes


@pytest.mark.long  # the short one is the next
def test_conduction_at_finite_strain_has_every_pillar(few_potentials):
    """Pillars at the same places, whose ends others share, change by strain nearly alike."""
    lone, change = SensorDesign(array=Array(rows=1, cols=1), electrics=CONDUCTION), []
    for unit in (Unit(), UNIT):
        found = SampleSolver(replace(lone, unit=unit)).displacements(144.0 * np.array([[[0.1, 0.05, -0.5]]]))
        assert found.settled.all()
        of_length = rest_lengths(unit) ** 2 / pillar_volumes(unit)
        change.append(found.resistance_ratio[0, 0] * of_length / unit_conductances(unit).pillars_per_mm)
    assert len(change[1]) == 4
    assert change[1][:2] == pytest.approx(change[0][[0, 2]], rel=3e-3)


@pytest.mark.parametrize("layout", [*(LAYOUTS[name] for name in READY), BESIDE, DIAGONAL])
def test_samples_of_one_rubber_are_alike_whatever_the_pillars(layout):
    """They bend nothing: electrodes that layouts have in common move alike, round pillars as square ones."""
    lone, force_n = SensorDesign(array=Array(rows=1, cols=1)), 144.0 * np.array([[[0.1, 0.05, -0.5]]])
    paper, square, round_one = (
        SampleSolver(replace(lone, unit=Unit(layout=one))).displacements(force_n)
        for one in (LAYOUTS["song2018"], layout, round_of(layout))
    )
    assert square.displacement_mm[:, :, :2] == pytest.approx(paper.displacement_mm, abs=1e-9)
    assert square.displacement_mm.shape[2] == len(layout.upper)
    assert square.resistance_ratio.shape[-1] == len(layout.pillars)
    assert round_one.resistance_ratio == pytest.approx(square.resistance_ratio, rel=1e-12)


TURNS = [
    np.array(rows) for x in (1.0, -1.0) for y in (1.0, -1.0) for rows in ([[x, 0.0], [0.0, y]], [[0.0, x], [y, 0.0]])
]


def images(places, turn):
    """Pairs of numbers of places and of their images in a motion of the square, where there is such a place."""
    number = {tuple(np.round(place, 6) + 0.0): k for k, place in enumerate(places)}
    moved = [tuple(np.round(turn @ place, 6) + 0.0) for place in places]
    return [(k, number[place]) for k, place in enumerate(moved) if place in number]


@cache
def coupled(name, kind):
    """Displacements of pads and electrodes of 2 × 2 units by forces on them, (4, 1 + n_upper, 3) twice [mm/N]."""
    design = replace(PAPERS, unit=Unit(layout=LAYOUTS[name]), pad=Pad(kind=kind), array=Array(rows=2, cols=2))
    cell = DesignCell(design).condensed(1, 4)
    n = 3 * (1 + len(design.unit.layout.upper))
    return design, CoupledArray(cell, 2, 2).influence(range(n), range(n))[0].reshape(4, n // 3, 3, 4, n // 3, 3)


EACH = pytest.mark.parametrize("name", READY)
BOTH = pytest.mark.parametrize("kind", ["soft", "stiff"])


@EACH
@BOTH
def test_forces_on_pads_and_electrodes_are_reciprocal_and_work(name, kind):
    """Betti: what b moves by a force on a is what a moves by one on b. Plates have six motions, electrodes more."""
    _, u = coupled(name, kind)
    matrix = u.reshape(np.prod(u.shape[:3]), -1)
    assert matrix == pytest.approx(matrix.T, abs=1e-13 * np.abs(matrix).max())
    energies = np.linalg.eigvalsh(matrix)
    assert energies[0] > (1e-3 if kind == "soft" else -1e-13) * energies[-1]
    assert (energies > 1e-9 * energies[-1]).sum() == (len(matrix) if kind == "soft" else 4 * min(6, len(matrix) // 4))


@EACH
@BOTH
def test_an_array_that_is_turned_or_mirrored_answers_as_turned_or_mirrored(name, kind):
    """Of all eight motions of the square, wherever an electrode's image is one: loads of all four pads."""
    design, u = coupled(name, kind)
    places, n_seen = np.array([(0.0, 0.0), *[one.place for one in design.unit.layout.upper]]), 0
    for turn in TURNS:
        units, whole = dict(images(unit_centres(design), turn)), np.eye(3)
        whole[:2, :2] = turn
        order = [units[k] for k in range(4)]
        for one, image in images(places, turn):
            turned = np.einsum("ab,kblc,dc->kald", whole, u[:, one, :, :, 0], whole)
            seen = u[order][:, image][:, :, order][:, :, :, 0]
            assert seen == pytest.approx(turned, abs=1e-11 * np.abs(u).max())
            n_seen += one != image
    assert n_seen >= 2  # U1 and U2 mirror each other
    paper = coupled("song2018", kind)[1]
    common = [places.tolist().index(list(one)) for one in ((0.0, 0.0), (-1.0, -1.0), (-1.0, 1.0))]
    assert u[:, common][:, :, :, :, 0] == pytest.approx(paper[:, :, :, :, 0], abs=1e-11 * np.abs(u).max())


@EACH
def test_electrodes_under_a_plate_move_with_it_as_one_body(name):
    """u = d + θ × r, d that of the underside's middle; plates do turn."""
    design, u = coupled(name, "stiff")
    r = upper_electrodes(design.unit) - [0.0, 0.0, design.unit.height_mm]
    moved = (u[:, 1:] - u[:, :1]).transpose(1, 2, 0, 3, 4, 5).reshape(3 * len(r), -1)
    A = np.concatenate([np.cross(np.eye(3), one).T for one in r])  # θ × r by θ
    turned = np.linalg.lstsq(A, moved)[0]
    assert A @ turned == pytest.approx(moved, abs=1e-12 * np.abs(u).max())
    assert np.abs(moved).max() > 0.05 * np.abs(u).max()


@pytest.mark.parametrize("name", LAYOUTS)
def test_traction_on_cells_moves_electrodes_as_a_pad_does(name):
    """Of an endless layer: contact's compliance of cells of 0.5 mm, which leave 0.9 %, against the closed form."""
    design = replace(PAPERS, unit=Unit(layout=LAYOUTS[name]), array=Array(rows=1, cols=1))
    expected = layer_response(design).influence_mm_per_n[..., 0, 0, :]
    x0, y0, x1, y1 = pad_squares(design)[0]
    compliance = PatchCompliance(endless_surface(design), Patch((x0, y0), (x1, y1), 24, 24))
    force = np.broadcast_to(np.eye(3)[:, :, None, None] / 24**2, (3, 3, 24, 24))
    found = np.stack([compliance.electrodes_mm(one) for one in force], axis=-1)
    assert found == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


@EACH
def test_derivatives_turn_with_the_array_and_are_those_of_the_paper_s_electrodes(name, monkeypatch):
    """On a coarse cell: of what leaves the square a square. E divides: ∂B/∂E = −B/E."""
    monkeypatch.setattr("fem.array.sensitivities.LEVEL", 1)
    monkeypatch.setattr("fem.array.sensitivities.DEGREE", 2)
    lone = replace(PAPERS, unit=Unit(layout=LAYOUTS[name]), array=Array(rows=1, cols=1))
    nothing = SimpleNamespace(influence_mm_per_n=np.ones((1, 1, len(lone.unit.layout.upper), 3, 1, 1, 3)))
    monkeypatch.setattr("fem.array.sensitivities.array_response", lambda *_: (nothing, None, False))
    found = response_sensitivities(lone, SETTINGS)[0]
    by = dict(zip(found.parameters, found.influence_mm_per_n[:, 0, 0, :, :, 0, 0], strict=True))
    assert by.pop("rubber.young_mpa") == pytest.approx(-nothing.influence_mm_per_n[0, 0, :, :, 0, 0] / 6.1)
    places = np.array([one.place for one in lone.unit.layout.upper])
    for turn in TURNS:
        whole = np.eye(3)
        whole[:2, :2] = turn
        for one, image in images(places, turn):
            for key in ("rubber.poisson", "unit.height_mm", "unit.span_mm", "pad.size_mm"):
                assert by[key][image] == pytest.approx(whole @ by[key][one] @ whole.T, abs=1e-9 * np.abs(by[key]).max())
                assert np.abs(by[key]).max() > 0


@EACH
def test_conduction_keeps_kirchhoff_s_law_and_the_unit_s_symmetry(name):
    """On a coarse mesh, square and round: pillars that are images of each other resist alike, lone ones by ρ l/S."""
    for layout in (LAYOUTS[name], round_of(LAYOUTS[name])):
        unit = Unit(layout=layout)
        conductor = Conductor(unit_hexahedra(unit, 2, 1, round_across=2))
        G = conductor.conductances()
        assert np.abs(G - G.T).max() < 1e-12 * np.abs(G).max()
        assert np.abs(G.sum(axis=0)).max() < 1e-9 * np.abs(G).max()
        assert np.linalg.eigvalsh(G)[0] > -1e-9
        resistances = pillars_per_mm(G, conductor.mesh.pairs)
        lone = rest_lengths(unit) / pillar_areas(unit)
        ends = [one.tolist() for one in pillar_ends(unit)[..., :2].round(6) + 0.0]
        for turn in TURNS:
            moved = [(np.array(one) @ turn.T).round(6).tolist() for one in ends]
            if all(one in ends for one in moved):
                assert resistances[[ends.index(one) for one in moved]] == pytest.approx(resistances, rel=1e-8)
        apart = [
            sum({*pair} & {*other} != set() for other in conductor.mesh.pairs) == 1 for pair in conductor.mesh.pairs
        ]
        upright = rest_lengths(unit) == unit.height_mm
        alone = np.array(apart) & upright
        assert resistances[alone] == pytest.approx(lone[alone], rel=1e-10)
        assert (resistances[upright & ~alone] > lone[upright & ~alone]).all()  # current leaves it at a shared end
        assert upright.all() or resistances[upright].max() < resistances[~upright].min()
        points = conductor.mesh.points_mm  # all are inside pillars, of round ones inside a coarse polygon's corners
        assert np.min([one.distance(points) for one in unit_prisms(unit)], axis=0).max() < (
            0.3 if lone[0] > 2.5 else 1e-9
        )
