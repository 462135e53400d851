"""CalculiX by an expert's hand: a quarter of a block under a patch in its middle, in graded C3D20R elements.

The deck is written here and not timed; `ccx` alone is. Nothing estimates its error.
"""

import tempfile
from itertools import product
from pathlib import Path
from shutil import which

import numpy as np

from fem.scene.scene import Scene
from geometry.layout import FloatArray
from studies.bench.processes import timed

#: places of a C3D20's nodes, in halves of its edges
PLACES = "000 200 220 020 002 202 222 022 100 210 120 010 102 212 122 012 001 201 221 021"
NODES = np.array([list(map(int, place)) for place in PLACES.split()])
CORNERS, MIDDLES = slice(4, 8), slice(12, 16)  #: nodes of the upper face


def missing() -> str:
    """The program, where it is not installed."""
    return "" if which("ccx") else "ccx is not installed (Debian: calculix-ccx)"


def lines_of(scene: Scene, n: int) -> list[FloatArray]:
    """Lines of the quarter from its middle planes: n below half the patch, crowded at its edge, at base and top."""

    def crowded(start: float, end: float, boxes: int, both: bool) -> FloatArray:
        t = np.linspace(0, 1, boxes + 1)
        return start + (end - start) * ((1 - np.cos(np.pi * t)) / 2 if both else 1 - (1 - t) ** 2)

    more, (load,) = n + n // 2, scene.dead_loads
    halves = zip(load.size_mm, scene.outline.section_mm, strict=True)
    flat = [np.append(crowded(0, a / 2, n, False), crowded(a / 2, x / 2, more, True)[1:]) for a, x in halves]
    return [*flat, crowded(0, scene.height_mm, more, True)]


def deck_of(scene: Scene, n: int) -> tuple[str, dict[int, float]]:
    """The input of `ccx`, and weights of nodes in the mean of the patch."""
    lines = lines_of(scene, n)
    fine = [np.sort(np.append(line, (line[1:] + line[:-1]) / 2)) for line in lines]
    boxes = np.array(list(product(*(range(0, 2 * len(line) - 2, 2) for line in lines))))
    places, elements = np.unique((boxes[:, None] + NODES).reshape(-1, 3), axis=0, return_inverse=True)
    elements = elements.reshape(-1, 20) + 1
    points = np.column_stack([line[places[:, k]] for k, line in enumerate(fine)])
    (load,) = scene.dead_loads
    edge = np.array(load.size_mm) / 2 * (1 + 1e-9)
    high = np.column_stack([fine[k][boxes[:, k] + 2] for k in range(3)])
    loaded = (high[:, 2] == scene.height_mm) & (high[:, :2] <= edge).all(axis=1)
    weights: dict[int, float] = {}
    for k in np.flatnonzero(loaded).tolist():
        area = np.prod(high[k, :2] - [fine[axis][boxes[k, axis]] for axis in (0, 1)]) / edge.prod()
        for of, share in ((CORNERS, -1 / 12), (MIDDLES, 1 / 3)):
            for node in elements[k, of]:
                weights[int(node)] = weights.get(int(node), 0.0) + share * area
    out = ["*NODE, NSET=ALL", *(f"{k},{x:.12g},{y:.12g},{z:.12g}" for k, (x, y, z) in enumerate(points, 1))]
    out += ["*ELEMENT, TYPE=C3D20R, ELSET=E"]
    for k, nodes in enumerate(elements.tolist(), 1):
        out += [",".join(map(str, [k, *nodes[:15]])) + ",", ",".join(map(str, nodes[15:]))]
    for name, axis in (("X", 0), ("Y", 1), ("Z", 2)):
        out += [f"*NSET, NSET={name}", *map(str, np.flatnonzero(points[:, axis] == 0) + 1)]
    rubber = scene.material
    out += ["*NSET, NSET=P", *map(str, weights), "*MATERIAL, NAME=M", "*ELASTIC"]
    out += [f"{rubber.young_mpa},{rubber.poisson}", "*SOLID SECTION, ELSET=E, MATERIAL=M"]
    out += ["*BOUNDARY", "X,1", "Y,2", "Z,1,3", "*STEP", "*STATIC", "*DLOAD"]
    out += [f"{k + 1},P2,{-load.traction_mpa[2]}" for k in np.flatnonzero(loaded)]
    return "\n".join([*out, "*NODE PRINT, NSET=P", "U", "*END STEP", ""]), weights


def solve_by_calculix(scene: Scene, n: int) -> tuple[dict[str, FloatArray], float]:
    """The mean of the patch under the scene's one probe, and processor seconds of `ccx`, on one thread."""
    deck, weights = deck_of(scene, n)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "deck.inp").write_text(deck, encoding="ascii")
        _, seconds = timed("ccx", "-i", "deck", folder=Path(folder))
        rows = [line.split() for line in Path(folder, "deck.dat").read_text(encoding="ascii").splitlines()]
    sunk = sum(weights[int(row[0])] * float(row[3]) for row in rows if len(row) == 4 and row[0].isdigit())
    return {scene.probes[0].name: np.array([0.0, 0.0, sunk])}, seconds
