"""Scenes, meshes and a layout for the tests, small enough to be solved in a moment."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skfem import MeshTet

from fem.kernel.loads import DeadLoad
from fem.methods.plan import Plan, make_plan
from fem.scene.scene import Block, Body, Probe, Scene
from geometry.design import Material
from geometry.layout import SONG2018, Electrode, Layout
from geometry.layout import Pillar as PillarOf
from geometry.prism import Pair, Triple

#: two uprights, two oblique pillars and three upper electrodes, in a chain from U1 to U3; y shares both its electrodes
FOUR = Layout(
    upper=(Electrode("U1", (-1.0, -1.0)), Electrode("U2", (-1.0, 1.0)), Electrode("U3", (1.0, 1.0))),
    lower=(Electrode("L1", (-1.0, -1.0)), Electrode("L2", (-1.0, 1.0))),
    pillars=tuple(
        PillarOf(*one) for one in (("z", "L1", "U1"), ("y", "L1", "U2"), ("w", "L2", "U2"), ("x", "L2", "U3"))
    ),
)
#: an upright and a pillar that leans both ways on L1, another across the unit to the top of a second upright one
DIAGONAL = Layout(
    upper=(Electrode("U1", (-1.0, -1.0)), Electrode("U2", (-1.0, 1.0)), Electrode("U3", (-0.2, -0.7))),
    lower=(Electrode("L1", (-1.0, -1.0)), Electrode("L2", (1.0, -1.0)), Electrode("L3", (-1.0, 1.0))),
    pillars=tuple(
        PillarOf(*one) for one in (("z", "L1", "U1"), ("d", "L2", "U2"), ("z2", "L3", "U2"), ("e", "L1", "U3"))
    ),
)
#: the paper's, and a reference beside the slab where its wires leave a crossing free; it leans both ways
BESIDE = replace(SONG2018, pillars=(*SONG2018.pillars, PillarOf("r", "L2", "U2", width_mm=3.0, reference=True)))


#: a section of flat sides w apart
HEXAGON = tuple((x, y / 3**0.5) for x, y in ((-1, -1), (0, -2), (1, -1), (1, 1), (0, 2), (-1, 1)))


def of_section(layout: Layout, section: str) -> Layout:
    """The same layout, its pillars of another section."""
    return replace(layout, pillars=tuple(replace(one, section=section) for one in layout.pillars))


def round_of(layout: Layout) -> Layout:
    """The same layout, its pillars round."""
    return of_section(layout, "round")


def coarse_cells(patch: pytest.MonkeyPatch, level: int = 1, degree: int = 4) -> None:
    """Let arrays be drawn, conduct and be pressed by cells of one coarse grid: in a tenth of the time."""
    patch.setattr("fem.array.design_cell.GRID_LEVEL", level)
    patch.setattr("fem.array.design_cell.GRID_DEGREE", degree)


EXAMPLES = sorted((Path(__file__).parents[2] / "scenes").glob("*.toml"))

BLOCK = """
[body]
kind = "block"
size_mm = [30.0, 30.0, 10.0]
[material]
young_mpa = 6.1
poisson = 0.49
[[inclusion]]
base_mm = [10.0, 15.0, 0.0]
top_mm = [20.0, 15.0, 10.0]
section_mm = [2.0, 3.0]
young_mpa = 61.0
poisson = 0.3
[[load]]
center_mm = [15.0, 15.0]
size_mm = [10.0, 10.0]
traction_mpa = [0.0, 0.0, -1.0]
[[probe]]
name = "patch"
kind = "mean"
center_mm = [15.0, 15.0]
size_mm = [8.0, 9.0]
[[probe]]
name = "point"
kind = "point"
position_mm = [15.0, 15.0, 5.0]
[solve]
tolerance = 2e-3
"""

PILLAR = """
[body]
kind = "pillar"
section_mm = [2.0, 2.0]
base_mm = [0.0, 0.0, 0.0]
top_mm = [10.0, 0.0, 10.0]
[material]
young_mpa = 6.1
poisson = 0.49
[[load]]
center_mm = [10.0, 0.0]
size_mm = [2.0, 2.0]
traction_mpa = [0.0, 0.0, -0.01]
[[probe]]
name = "top"
kind = "mean"
center_mm = [10.0, 0.0]
size_mm = [2.0, 2.0]
"""

ARRAY = """
[body]
kind = "array"
[design.pillar_material]
young_mpa = 61.0
[[load]]
center_mm = [7.5, 7.5]
size_mm = [12.0, 12.0]
traction_mpa = [0.0, 0.0, -1.0]
[[probe]]
name = "U1"
kind = "mean"
center_mm = [2.5, 2.5]
size_mm = [2.0, 2.0]
"""


def mean(name: str, center_mm: Pair, size_mm: Pair) -> Probe:
    return Probe(name=name, kind="mean", center_mm=center_mm, size_mm=size_mm)


def pressed(body: Body, center_mm: Pair, size_mm: Pair, traction_mpa: Triple, **given: Any) -> Scene:
    """A body under one traction on a rectangle of its top, with a probe `patch` of the mean there unless told."""
    load = DeadLoad(center_mm=center_mm, size_mm=size_mm, traction_mpa=traction_mpa)
    return Scene(**{"body": body, "loads": (load,), "probes": (mean("patch", center_mm, size_mm),)} | given)


def pressed_block(size_mm: Triple, material: Material, traction_mpa: Triple = (0.0, 0.0, -1.0), **given: Any) -> Scene:
    """A block loaded all over its top, with a mean probe of all the top and a point probe at half height."""
    x, y, z = size_mm
    top = (x / 2, y / 2), (x, y)
    middle = Probe(name="middle", kind="point", position_mm=(0.4 * x, 0.6 * y, z / 2))
    given = {"material": material, "probes": (mean("top", *top), middle)} | given
    return pressed(Block(size_mm=size_mm), *top, traction_mpa, **given)


def on_tetrahedra(scene: Scene) -> Plan:
    """The plan of a scene of boxes changed to one of tetrahedra."""
    return replace(make_plan(scene), method="tetrahedra", mirrors=())


def box_mesh(n: tuple[int, int, int], size_mm: tuple[float, float, float], disorder: float = 0.0) -> MeshTet:
    """A box from the origin in 6·nx·ny·nz tetrahedra, inner points moved at random by a share of the edges."""
    grid = [np.linspace(0.0, extent, cells + 1) for cells, extent in zip(n, size_mm, strict=True)]
    mesh = MeshTet.init_tensor(*grid)
    if not disorder:
        return mesh
    points = mesh.p.copy()
    inner = np.ones(points.shape[1], dtype=bool)
    for axis, extent in enumerate(size_mm):
        inner &= (points[axis] > 0) & (points[axis] < extent)
    edges = np.array(size_mm) / np.array(n)
    moves = np.random.default_rng(7).uniform(-disorder, disorder, (3, int(inner.sum()))) * edges[:, None]
    points[:, inner] += moves
    return MeshTet(points, mesh.t)
