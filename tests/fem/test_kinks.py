"""Boxes that faces of pillars cut, against boxes between which the faces lie, and against tetrahedra."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.coupled_cells import CoupledArray
from fem.array.cut_cell import CutCell, refine, why_tetrahedra
from fem.array.design_cell import PADS, DesignCell, RefinedCell, electrode_means
from fem.array.solving import block_error
from fem.kernel.elements import Basis, hexahedra
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.kinks import KinkedRubber
from fem.kernel.system import System
from fem.meshes.grid import Grid
from geometry.design import Array, Material, Pad, SensorDesign, Unit
from geometry.layout import SONG2018
from geometry.prism import Prism
from tests.fem.scenes import round_of

SOFT, HARD = Material(young_mpa=1.0), Material(young_mpa=20.0)
LEANING = Prism(base_mm=(1.3, 2.0, 0.0), top_mm=(2.7, 2.0, 4.0), section_mm=(1.2, 1.1))
UPRIGHT = Prism(base_mm=(2.0, 2.0, 0.0), top_mm=(2.0, 2.0, 4.0), section_mm=(1.2, 1.2))


def body(lines, rubbers, prism):
    return KinkedRubber(Basis(Grid(lines).mesh, hexahedra(2)[0]), hexahedra(2)[1], rubbers, [prism])


@pytest.mark.parametrize("rubber", [SOFT, Material(young_mpa=1.0, poisson=0.0)], ids=["soft", "without Poisson"])
def test_uniform_strain_passes(rubber):
    """Where both rubbers are one, jumps and split pressures change no force of a linear displacement: exact."""
    line = np.linspace(0.0, 4.0, 4)
    cut = body((line, line, line), (rubber, rubber), LEANING)
    assert cut.is_cut.sum() > 3
    u = cut.points_mm @ np.random.default_rng(0).normal(size=(3, 3))
    with_jumps = cut._rest_stiffness(np.arange(cut.n_elements))
    cut.is_cut = np.zeros(cut.n_elements, dtype=bool)
    plain = cut._rest_stiffness(np.arange(cut.n_elements))
    one, other = (np.einsum("eabij,ebj->eai", K, u[cut.nodes]) for K in (with_jumps, plain))
    assert np.abs(with_jumps - plain).max() > 1e-3 * np.abs(plain).max()
    assert np.abs(one - other).max() < 1e-10 * np.abs(other).max()


def test_faces_inside_boxes_answer_like_faces_between_them():
    """A pillar 20 times as stiff, bent to either side: jumps leave a quarter at most of the error without them."""

    def compliance(line, has_jumps=True):
        cut = body((line, line, np.linspace(0.0, 4.0, 4)), (SOFT, HARD), UPRIGHT)
        if not has_jumps:
            cut._jumps = lambda points_mm: np.zeros((len(points_mm), 3, 0, points_mm.shape[1]))
        system = System(cut)
        mean = system.integrals(np.array([[1.4, 1.4, 2.6, 2.6]])).toarray()
        forces = np.einsum("kn,ij->kinj", mean, np.eye(3)).reshape(3, -1, 3)
        rhs = system.rest_loads(forces)
        u, _ = checked_solve(Factor(system.rest_matrix(), definite=True, upper=True), rhs)
        return np.diag(rhs.T @ u)[:2], cut.is_cut.sum()

    fitted = np.array([0.0, 0.5, 0.95, 1.4, 1.7, 2.0, 2.3, 2.6, 3.05, 3.5, 4.0])
    exact, n_cut = compliance(fitted)
    assert n_cut == 0
    even = np.linspace(0.0, 4.0, 8)
    (found, n_cut), (without, _) = compliance(even), compliance(even, has_jumps=False)
    assert n_cut > 0
    assert (np.abs(found - exact) < np.abs(without - exact) / 4).all()
    assert (np.abs(found - exact) < 2e-2 * exact).all()


def stiffer(times, **changes):
    """A unit whose pillars are so many times as stiff as the matrix."""
    matrix = Material(young_mpa=6.1 / times)
    return replace(SensorDesign(array=Array(rows=1, cols=1), matrix_material=matrix), **changes)


@pytest.mark.parametrize(
    ("times", "less"),
    [
        pytest.param(12.0, 2e-2, marks=pytest.mark.wide),
        *(pytest.param(*each, marks=pytest.mark.long) for each in ((12.0, 7e-3), (4.0, 6e-3), (0.25, 2.6e-3))),
    ],
)
def test_boxes_and_tetrahedra_agree_within_what_both_state(times, less):
    """One unit: boxes to 1e-2, tetrahedra to what is asked. The short one is `test_golden.py`'s of two rubbers."""
    design = stiffer(times)

    def answer(cells):
        return CoupledArray(cells, 1, 1).influence(PADS, electrode_means(design))[0]

    boxes, found = refine(design, 1e-2, answer, block_error)
    assert boxes.steps[0].startswith("boxes")
    assert boxes.error_estimate < 1e-2
    others, expected = DesignCell(design).refined(less, answer, block_error)
    assert others.error_estimate < less
    assert block_error(found, expected) < boxes.error_estimate + others.error_estimate


def test_boxes_that_miss_the_tolerance_give_way_to_tetrahedra(monkeypatch):
    """And the steps say so; here of what both would find."""
    for kind, error in ((CutCell, 8e-3), (DesignCell, 4e-3)):
        cell = RefinedCell(cells=(), error_estimate=error, steps=(kind.__name__,), seconds={"mesh": 1.0})
        monkeypatch.setattr(kind, "refined", lambda *_, cell=cell: (cell, np.array(cell.error_estimate)))
    for tolerance, error, said, mesh_s in (
        (1e-2, 8e-3, ["boxes that pillars cut, much cheaper than tetrahedra", "CutCell"], 1.0),
        (6e-3, 4e-3, ["boxes that pillars cut, much cheaper than tetrahedra", "CutCell",
                      "tetrahedra: boxes miss the tolerance", "DesignCell"], 2.0),
    ):  # fmt: skip
        cell, answered = refine(stiffer(12.0), tolerance, lambda cell: np.zeros(()), block_error)
        assert (cell.error_estimate, answered) == (error, error)
        assert list(cell.steps) == said
        assert cell.seconds == {"mesh": mesh_s}


@pytest.mark.parametrize(
    ("design", "tolerance", "reason"),
    [
        (stiffer(4.0), 1e-2, None),
        (stiffer(4.0), 1e-3, "tolerances"),
        (stiffer(121.0), 1e-2, "121 times"),
        (stiffer(0.25), 1e-2, None),
        (stiffer(0.2), 1e-2, "0.2 times"),
        (stiffer(4.0, pad=Pad(kind="stiff")), 1e-2, "soft pads"),
        (stiffer(4.0, unit=Unit(pillar_width_mm=1.2)), 1e-2, "thinner"),
        (stiffer(4.0, unit=Unit(layout=round_of(SONG2018))), 1e-2, "square"),
    ],
)
def test_tetrahedra_are_taken_for_a_reason(design, tolerance, reason):
    found = why_tetrahedra(design, tolerance)
    assert (reason is None) == (found is None)
    assert reason is None or reason in found
