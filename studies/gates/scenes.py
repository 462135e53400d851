"""Scenes that are found nowhere else: drawn at random, and those that were wrong when the answers were frozen."""

import math

import numpy as np

from fem import Scene
from fem.scene.loads import DeadLoad, StiffLoad
from fem.scene.scene import Block, Inclusion, Pillar, Probe, Sensor
from geometry.design import Array, Material, Pad, SensorDesign, Unit
from geometry.layout import FloatArray, unit_centres
from geometry.prism import Pair, Triple
from studies.bench.scenes import RUBBER, loaded

RATIOS = (0.3, 0.45, 0.49, 0.499, 0.4999, 0.499999)  #: Poisson's, that scenes are drawn from
GAP_MM = 0.3  #: between inclusions
SOFT = Material(young_mpa=1.0, poisson=0.45)
OBLIQUE = {"ν = 0": (1.0, 0.0), "10 ×": (10.0, 0.49), "1000 ×": (1000.0, 0.49), "1/20": (0.05, 0.49)}
SQUARE = 4 / math.pi * (math.log(1 + math.sqrt(2)) + (1 - math.sqrt(2)) / 3)  #: mean sinking of a square, over p a/E*
#: places of four patches of 0.1 mm, and NGSolve's answers there [mm]
PATCHES: dict[Pair, Triple] = {
    (2.0, 2.3): (-7.049e-4, -3.069e-4, -0.0750571),
    (6.6, 1.9): (4.192e-4, -6.076e-4, -0.0750543),
    (2.1, 6.0): (-6.315e-4, 5.198e-4, -0.0751034),
    (7.0, 5.7): (6.410e-4, 2.928e-4, -0.0750234),
}
NEEDLE_MM, NEEDLE_SINKS_MM = (
    (100.0, 0.01, 0.01),
    -1.112e-4,
)  #: a block under 0.1 MPa all over its top, and NGSolve's answer


def random_block(number: int, n_inclusions: int) -> Scene:
    """A patch on a block with upright inclusions up to 1000 times as stiff or as soft, ν up to 0.499999."""
    random = np.random.default_rng([26, number])
    uniform = random.uniform
    material = Material(young_mpa=1.0, poisson=float(random.choice(RATIOS)))
    size = np.round([*uniform(10.0, 20.0, 2), uniform(4.0, 10.0)], 2)
    inside: list[Inclusion] = []
    while len(inside) < n_inclusions:
        section = np.round(uniform(1.0, 4.0, 2), 2)
        x, y = _place(random, section, size)
        z = np.sort(np.round(uniform(0.0, size[2], 2), 2)) if uniform() < 0.5 else np.array([0.0, size[2]])
        rubber = Material(young_mpa=float(10 ** uniform(-3.0, 3.0)), poisson=float(uniform(0.3, 0.499)))
        apart = [np.abs([x - one.base_mm[0], y - one.base_mm[1]]) - (section + one.section_mm) / 2 for one in inside]
        if z[1] - z[0] > 0.5 and all(gap.max() > GAP_MM for gap in apart):
            low, high = z.tolist()
            width: Pair = (float(section[0]), float(section[1]))
            inside.append(Inclusion(base_mm=(x, y, low), top_mm=(x, y, high), section_mm=width, material=rubber))
    patch = np.round(uniform(1.0, 6.0, 2), 2)
    push = (float(uniform(-0.05, 0.05)), float(uniform(-0.05, 0.05)), -0.1)
    body = Block(size_mm=(float(size[0]), float(size[1]), float(size[2])))
    return loaded(body, material, _place(random, patch, size), (float(patch[0]), float(patch[1])), push, *inside)


def _place(random: np.random.Generator, section: FloatArray, size: FloatArray) -> Pair:
    """Centre of a rectangle on a block."""
    x, y = np.round(random.uniform(section / 2, size[:2] - section / 2), 2).tolist()
    return float(np.clip(x, section[0] / 2, size[0] - section[0] / 2)), float(
        np.clip(y, section[1] / 2, size[1] - section[1] / 2)
    )


def random_pillar(number: int) -> Scene:
    """A free pillar that leans up to 67°, pushed all over its top."""
    uniform = np.random.default_rng([26, number]).uniform
    material = Material(young_mpa=1.0, poisson=RATIOS[number % len(RATIOS)])
    height, lean, way = uniform(4.0, 8.0), math.tan(math.radians(uniform(20.0, 67.0))), uniform(0.0, 2 * np.pi)
    section = (float(uniform(2.0, 4.0)), float(uniform(2.0, 4.0)))
    top = (height * lean * math.cos(way), height * lean * math.sin(way))
    body = Pillar(section_mm=section, base_mm=(0.0, 0.0, 0.0), top_mm=(*top, height))
    return loaded(body, material, top, section, (float(uniform(-0.05, 0.05)), float(uniform(-0.05, 0.05)), -0.1))


def random_scenes() -> dict[str, Scene]:
    """Twenty: four homogeneous blocks, four each with one, two and three inclusions, four pillars."""
    found = {}
    for number in range(20):
        n = number // 4
        kind = "leaning pillar" if n == 4 else f"{n} inclusions"
        found[f"{number}, {kind}"] = random_pillar(number) if n == 4 else random_block(number, n)
    return found


def oblique_scenes() -> dict[str, Scene]:
    """The body of `scenes/oblique-inclusion.toml` with an inclusion of other moduli."""
    found = {}
    for name, (ratio, poisson) in OBLIQUE.items():
        inside = Inclusion(
            base_mm=(5.0, 6.0, 0.0), top_mm=(11.0, 6.0, 8.0), section_mm=(2.5, 2.0),
            material=Material(young_mpa=ratio * RUBBER.young_mpa, poisson=poisson),
        )  # fmt: skip
        probed = {"pillar's end": ((11.0, 6.0), (2.0, 2.0)), "patch": ((8.0, 6.0), (8.0, 8.0))}
        body = Block(size_mm=(16.0, 12.0, 8.0))
        found[f"oblique, {name}"] = loaded(
            body, RUBBER, (8.0, 6.0), (8.0, 8.0), (0.0, 0.0, -0.5), inside, probes=probed
        )
    return found


def small_patch(side_mm: float) -> Scene:
    """A patch on a block to which it is a half-space, but for the side over the height."""
    body = Block(size_mm=(9.0, 8.0, 4.0))
    return loaded(body, SOFT, (4.0, 4.0), (side_mm, side_mm), (0.0, 0.0, -1.0))


def sinking(side_mm: float) -> float:
    """Mean displacement along z of that patch on a half-space, 0.946 p a (1 − ν²)/E."""
    return -SQUARE * side_mm * (1 - SOFT.poisson**2) / SOFT.young_mpa


def solved_by_others() -> dict[str, tuple[Scene, dict[str, Triple], float]]:
    """Scenes, NGSolve's answers [mm] and what these are uncertain by."""
    size = (0.1, 0.1)
    four = Scene(
        body=Block(size_mm=(9.0, 8.0, 4.0)),
        material=SOFT,
        loads=tuple(DeadLoad(center_mm=at, size_mm=size, traction_mpa=(0.0, 0.0, -1.0)) for at in PATCHES),
        probes=tuple(Probe(name=f"{x}, {y}", kind="mean", center_mm=(x, y), size_mm=size) for x, y in PATCHES),
    )
    x, y, _ = NEEDLE_MM
    needle = loaded(Block(size_mm=NEEDLE_MM), RUBBER, (x / 2, y / 2), (x, y), (0.0, 0.0, -0.1))
    return {
        "four patches": (four, {f"{x}, {y}": u for (x, y), u in PATCHES.items()}, 2e-4),
        "needle": (needle, {"patch": (0.0, 0.0, NEEDLE_SINKS_MM)}, 1e-3),
    }


def slender_pillar() -> Scene:
    """A pillar at finite strain that its load bends by most of its length."""
    section, rubber = (2.0, 2.4), Material(model="neo-hookean")
    body = Pillar(section_mm=section, base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, 13.0))
    return loaded(body, rubber, (0.0, 0.0), section, (0.02, 0.01, -0.05))


def flat_array() -> SensorDesign:
    """An array whose samples of heavy loads are at the limit of what has an answer."""
    unit, pad = Unit(span_mm=8.0, height_mm=8.0), Pad(size_mm=10.8, kind="stiff")
    return SensorDesign(array=Array(rows=2, cols=2, pitch_mm=13.0), unit=unit, pad=pad)


def pads_pressed(design: SensorDesign, traction_mpa: FloatArray) -> Scene:
    """An array at finite strain, tractions (n_units, 3) [MPa] on its stiff pads, which are probed."""
    rubber, side = Material(model="neo-hookean"), design.pad.size_mm
    finite = SensorDesign(
        array=design.array, unit=design.unit, pad=design.pad, pillar_material=rubber, matrix_material=rubber
    )
    loads, probes = [], []
    for number, ((x, y), p) in enumerate(zip(unit_centres(design).tolist(), traction_mpa.tolist(), strict=True)):
        force = (p[0] * side**2, p[1] * side**2, p[2] * side**2)
        loads.append(StiffLoad(center_mm=(x, y), size_mm=(side, side), force_n=force))
        probes.append(Probe(name=f"pad {number}", kind="mean", center_mm=(x, y), size_mm=(side, side)))
    return Scene(body=Sensor(design=finite), material=rubber, loads=tuple(loads), probes=tuple(probes), tolerance=5e-2)
