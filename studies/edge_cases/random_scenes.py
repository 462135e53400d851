"""Linear scenes drawn at random, by family, as the tables of scene files: what an error estimate is calibrated on.

Lengths in mm, moduli and tractions in MPa. Every scene has a seed of its own, which no other family shares.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from fem.scene.scene import Scene
from fem.scene.scene_file import scene_from_dict
from geometry.layout import FloatArray

SEED = 43
YOUNG_MPA = 6.1
RATIOS = (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999, 0.499999)
GAP_MM = 0.01  #: least distance of a rectangle from the edges of the top
Random = np.random.Generator
Table = dict[str, Any]


def numbers(values: Any) -> Any:
    """Floats of a file, to 0.1 µm."""
    return np.round(values, 4).tolist()


def rubber(random: Random, contrast: float = 1.0) -> Table:
    """Of the house's modulus times a contrast, of any ν."""
    return {"young_mpa": float(f"{YOUNG_MPA * contrast:.4g}"), "poisson": float(random.choice(RATIOS))}


def rectangle(random: Random, size: FloatArray, middle: bool = False, least: float = 0.15, most: float = 0.6) -> Table:
    """A rectangle on a top from the origin corner, in its middle or anywhere, as wide as some shares of it."""
    own = np.round(random.uniform(least, most, 2) * size[:2], 2)
    edge = own / 2 + GAP_MM
    return {
        "center_mm": numbers(size[:2] / 2 if middle else random.uniform(edge, size[:2] - edge)),
        "size_mm": numbers(own),
    }


def pushed(random: Random, where: Table) -> Table:
    """A load there: along z, along x, or any."""
    any_way = random.uniform((-0.4, -0.4, -1.0), (0.4, 0.4, 0.2))
    traction = ((0.0, 0.0, -1.0), (0.2, 0.0, 0.0), any_way, any_way)[random.integers(4)]
    return where | {"traction_mpa": numbers(traction)}


def probed(where: list[Table], points: list[FloatArray]) -> list[Table]:
    """Mean probes of rectangles, and probes of points."""
    means = [{"kind": "mean", "center_mm": one["center_mm"], "size_mm": one["size_mm"]} for one in where]
    places = [{"kind": "point", "position_mm": numbers(point)} for point in points]
    return [{"name": f"{one['kind']}-{number}"} | one for number, one in enumerate([*means, *places])]


def inside(random: Random, size: FloatArray) -> list[FloatArray]:
    """No point, or one or two of a box."""
    low, high = np.array([0.05, 0.05, 0.2]), np.array([0.95, 0.95, 1.0])
    return list(random.uniform(low, high, (int(random.integers(3)), 3)) * size)


def block(
    random: Random, low: Any = (5.0, 5.0, 2.0), high: Any = (30.0, 30.0, 12.0), loads: int = 1, besides: int = 1,
    least: float = 0.15, most: float = 0.6,
) -> Table:  # fmt: skip
    """A box under patches, which are probed, as are rectangles and points besides; a third have their patch in mid."""
    size = np.round(np.exp(random.uniform(np.log(low), np.log(high))), 2)
    middle = loads == 1 and random.random() < 1 / 3
    patches = [rectangle(random, size, middle, least, most) for _ in range(loads)]
    others = [rectangle(random, size, False, least, most) for _ in range(int(random.integers(besides + 1)))]
    return {
        "body": {"kind": "block", "size_mm": numbers(size)},
        "material": rubber(random),
        "load": [pushed(random, one) for one in patches],
        "probe": probed([*patches, *others], inside(random, size)),
    }


def slab(random: Random) -> Table:
    """Wide, and probed far from its load."""
    return block(random, (40.0, 40.0, 5.0), (100.0, 100.0, 12.0), besides=4, least=0.08, most=0.2)


def plate(random: Random) -> Table:
    """Some 20 to 100 times as wide as thick."""
    return block(random, (15.0, 15.0, 0.3), (30.0, 30.0, 1.0))


def several(random: Random) -> Table:
    """Patches, some over others."""
    return block(random, (15.0, 15.0, 4.0), (45.0, 45.0, 10.0), loads=int(random.integers(2, 7)), least=0.1, most=0.4)


def tiny(random: Random) -> Table:
    """A patch 100 to 3000 times less wide than the block."""
    share = float(np.exp(random.uniform(np.log(3e-4), np.log(1e-2))))
    found = block(random, (10.0, 10.0, 5.0), (30.0, 30.0, 10.0), least=0.15, most=0.4)
    size = np.maximum(np.round(share * np.array(found["load"][0]["size_mm"]) / 0.3, 4), 0.002).tolist()
    for one in (found["load"][0], found["probe"][0]):
        one["size_mm"] = size
    return found


def pillar(random: Random, slope: float = 0.0) -> Table:
    """A free pillar under a load all over the top, or on a part; `slope` is the greatest lean over the height."""
    section, height = random.uniform(1.0, 3.0, 2).round(2), round(random.uniform(3.0, 20.0), 2)
    top = np.array([*random.uniform(-slope, slope, 2), 1.0]) * height
    if slope and random.random() < 1 / 3:
        top[1] = 0.0
    whole = {"center_mm": numbers(top[:2]), "size_mm": numbers(section)}
    part = {"center_mm": numbers(top[:2] - section / 8), "size_mm": numbers(section / 2)}
    loaded = pushed(random, part if random.random() < 1 / 3 else whole)
    loaded["traction_mpa"] = numbers(0.01 * np.array(loaded["traction_mpa"]))
    inner = np.append(random.uniform(-0.4, 0.4, 2) * section, 0.0) + random.uniform(0.3, 0.95) * top
    return {
        "body": {"kind": "pillar", "section_mm": numbers(section), "base_mm": [0.0] * 3, "top_mm": numbers(top)},
        "material": rubber(random),
        "load": [loaded],
        "probe": probed([whole], [inner] if random.random() < 0.5 else []),
    }


def leaning(random: Random) -> Table:
    """Up to 50 degrees along each axis."""
    return pillar(random, slope=1.2)


def inclusion(random: Random, count: int = 1, buried: float = 0.4, exponents: tuple[float, float] = (-3, 3)) -> Table:
    """A block with upright prisms side by side in it: from the base or buried, to the top or below it."""
    found = block(random, (10.0, 8.0, 5.0), (24.0, 20.0, 10.0))
    x, y, height = found["body"]["size_mm"]
    prisms = []
    for number in range(count):
        where = rectangle(random, np.array([x / count, y]), least=0.2, most=0.5)
        low, high = random.uniform((0.1, 0.5), (0.4, 0.9)) * (random.random(2) < buried)
        at = np.add(where["center_mm"], (number * x / count, 0.0))
        material = rubber(random, 10.0 ** random.uniform(*exponents))
        base, top = numbers([*at, low * height]), numbers([*at, (high or 1.0) * height])
        prisms.append({"base_mm": base, "top_mm": top, "section_mm": where["size_mm"]} | material)
    return found | {"inclusion": prisms}


def inclusions(random: Random) -> Table:
    """Two or three."""
    return inclusion(random, count=int(random.integers(2, 4)))


def void(random: Random) -> Table:
    """Almost nothing, buried."""
    found = inclusion(random, buried=1.0, exponents=(-3, -3))
    found["inclusion"][0]["poisson"] = 0.3
    return found


def rigid(random: Random) -> Table:
    """One or two rigid plates with forces and moments, sometimes beside a patch."""
    found = block(random, (16.0, 10.0, 4.0), (40.0, 25.0, 10.0), besides=1)
    x, y, _ = found["body"]["size_mm"]
    halves = [
        rectangle(random, np.array([x / 2, y]), middle=bool(random.integers(2)), least=0.3, most=0.8) for _ in range(2)
    ]
    halves[1]["center_mm"][0] = round(halves[1]["center_mm"][0] + x / 2, 4)
    force, moment = random.uniform((-3, -3, -20), (3, 3, 0), (2, 3)), random.uniform(-10.0, 10.0, (2, 3))
    plates = [
        one | {"kind": "stiff", "force_n": numbers(f), "moment_nmm": numbers(m * random.integers(2))}
        for one, f, m in zip(halves, force, moment, strict=True)
    ]
    if random.random() < 0.4:
        plates[1] = pushed(random, halves[1])
    loads = plates[: int(random.integers(1, 3))]
    besides = [one for one in found["probe"] if one["kind"] == "mean"][1:]
    points = [np.array(one["position_mm"]) for one in found["probe"] if one["kind"] == "point"]
    return found | {"load": loads, "probe": probed([*halves, *besides], points)}


#: families, the plainest first, and the number of scenes of each
FAMILIES: dict[Callable[[Random], Table], int] = {
    block: 16, slab: 12, pillar: 10, inclusion: 20, leaning: 12, plate: 12, rigid: 14, several: 10, void: 8,
    inclusions: 8, tiny: 10,
}  # fmt: skip


def random_tables() -> dict[str, Table]:
    """132 scenes as tables of scene files, by family and number."""
    seeds = np.random.SeedSequence(SEED).spawn(len(FAMILIES))
    return {
        f"{family.__name__}-{number}": family(np.random.default_rng(own))
        for (family, count), seed in zip(FAMILIES.items(), seeds, strict=True)
        for number, own in enumerate(seed.spawn(count))
    }


def random_scenes() -> dict[str, Scene]:
    """The same as scenes."""
    return {name: scene_from_dict(table, name) for name, table in random_tables().items()}
