"""The peers at finite strain, held to a closed form and to the stored references."""

from dataclasses import replace

import pytest

from fem.scene.scene import Block
from geometry.design import Material
from studies.bench.finite import CONTENDERS, ERROR, measure
from studies.bench.harness import named
from studies.bench.peers import ngsolve_peer
from studies.bench.peers.ngsolve_finite import solve_finite_by_ngsolve
from studies.bench.scenes import loaded


def test_ngsolve_presses_a_column_of_no_poisson_as_the_law_says():
    """λ = 0 leaves W = Σ μ/2 (s² − 1) − μ ln s: the column keeps its width, and μ (s − 1/s) = −p along it."""
    pytest.importorskip("ngsolve")
    rubber = replace(Material(model="neo-hookean"), poisson=0.0)
    scene = loaded(Block(size_mm=(4.0, 4.0, 3.0)), rubber, (2.0, 2.0), (4.0, 4.0), (0.0, 0.0, -1.0))
    found = solve_finite_by_ngsolve(scene, 1, ngsolve_peer.tetrahedra, 2, "displacement").probes["patch"]
    ratio = 1.0 / rubber.lame_mpa[1] / 2
    stretch = (ratio**2 + 1) ** 0.5 - ratio
    assert found == pytest.approx([0.0, 0.0, 3.0 * (stretch - 1)], abs=1e-8)


@pytest.mark.parametrize(
    ("name", "setting", "allowed"),
    [
        ("TriPillar, one grid, no symmetry used", 1, 8e-3),  # 6.7e-3
        ("CalculiX C3D20R, its own law, graded", 2, 4e-2),  # 3.3e-2
    ],
)
def test_coarse_grids_are_near_the_reference_of_their_law(name, setting, allowed):
    contender = named(CONTENDERS, name)
    if contender.missing():
        pytest.skip(contender.missing())
    assert measure(contender, "", setting).errors[ERROR] < allowed
