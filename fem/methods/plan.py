"""Look at a scene before anything is computed: choose the method, name what is skipped, and say why.

Every saving has a name, by which `no_skip` switches it off: so a benchmark can show what it saves and that the answer
stays. Of the two methods for boxes the plan takes the one whose predicted time is shorter.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fem.discretization.graded_box import Level, box_part
from fem.discretization.mirrors import Mirror, flipped_points, flipped_rectangles, parities
from fem.scene.cells import has_alike_plates
from fem.scene.checks import SceneError
from fem.scene.loads import Rectangle
from fem.scene.scene import Region, Scene, Sensor
from geometry.design import Material
from geometry.layout import AXES

MAX_ITERATIONS = 5000  #: `fem.discretization.graded_box.conjugate_gradients` gives up there
SHEARED, REGIONS, NARROW = (
    8,
    3,
    2,
)  #: times as many unknowns: acute edges take two levels more, regions and narrow loads one
USUAL = Level(3, 2, 1, 0.8, 0.13)  #: the level of `fem.methods.high_order` that most scenes end at


def iterations(scene: Scene, regions: Sequence[Region]) -> float:
    """Predicted steps of conjugate gradients, whose preconditioner knows neither contrast, nor ν, nor shear.

    20 at ν = 0.3, 70 at 0.49, 700 at 0.4999; 230 to 300 at contrasts of 50 to 100; 500 at a shear of 45°, 3658 with ν
    = 0.4999 besides. A slender pillar bends far more softly than the preconditioner knows.
    """
    rubbers = [scene.material, *(material for _, material in regions)]
    moduli = [material.young_mpa for material in rubbers]
    shear = np.hypot(*scene.outline.lean)
    stretch = ((shear + np.sqrt(shear**2 + 4)) / 2) ** 4  # greatest over least stiffness of the sheared coordinates
    near_half = 1 / np.sqrt(1 - 2 * max(material.poisson for material in rubbers))
    slender = np.sqrt(max(1.0, scene.height_mm / min(scene.outline.section_mm)))
    return float(10 * near_half * (max(moduli) / min(moduli)) ** 0.35 * stretch * slender)


def seconds_by_order(scene: Scene, regions: Sequence[Region], mirrors: tuple[Mirror, ...]) -> float:
    """Processor seconds of `fem.methods.high_order`; infinite where its iteration would give up or knows no plates."""
    steps = iterations(scene, regions)
    if steps > MAX_ITERATIONS or scene.stiff_loads:
        return np.inf
    unknowns = float(np.prod(box_part(scene, regions, mirrors, USUAL).shape))
    narrow = any(min(load.size_mm) < scene.height_mm / 2 for load in scene.loads)
    unknowns *= (1 if scene.outline.is_upright else SHEARED) * (REGIONS if regions else 1) * (NARROW if narrow else 1)
    each = 3e-8 * max(1.0, unknowns / 4e4) ** 0.45  # of an unknown and step; beyond the processor's cache it is dearer
    return steps * unknowns * len(parities(mirrors)) * each


def seconds_by_splitting(scene: Scene, regions: Sequence[Region]) -> float:
    """Processor seconds of `fem.methods.box_refinement`, whatever the rubbers and the shear."""
    boxes = (30 + 30 * (len(regions) + len(scene.loads))) * (1e-2 / scene.tolerance) ** 0.3
    return float(0.02 * boxes)


Method = Literal["nothing", "grid", "cells", "tetrahedra", "finite"]

SAVINGS = {
    "zero-load": "a scene without load is answered without a mesh",
    "one-material": "what is of the body's own material gets no region",
    "hexahedra": "hexahedra where sides allow; off: tetrahedra",
    "symmetry": "a half or a quarter of the grid where the body mirrors itself, loads in even and odd parts",
    "substructuring": "arrays with pillars from one condensed cell; off: the whole array meshed",
    "field": "no displacement of the whole body, no file for pictures, unless asked for",
    "cache": "tetrahedral meshes are kept on disk and found again; off: meshed anew",
}
ELEMENTS = {
    "Qp": "few hexahedra whose order rises with the layers toward singular edges, the matrix never formed",
    "Q4": "boxes of order 4, split where the probes need it, factored: whatever contrast, ν, shear and slenderness",
    "Q2": "quadratic hexahedra that crowd at the edges of plates, two levels extrapolated",
    "Q2P": "quadratic hexahedra, the pressure linear in each and found there: neo-Hookean rubber does not lock",
    "TH": "Taylor-Hood tetrahedra, displacement P2 and pressure P1: they do not lock, whatever ν",
}
SOFT = 0.1  #: modulus of pillars over the matrix's, below which cells err more than they estimate: 1.4 % for 0.9 % at
#: 0.2, 3.4 % for 1.5 % at 0.025
SOFT_CELLS = 5e-2  #: tolerance that cells of such pillars keep
MAX_WHOLE = 4  #: units of such arrays that are meshed as a whole instead


@dataclass(frozen=True, kw_only=True)
class Decision:
    """One choice of the plan and its reason."""

    name: str
    choice: str
    reason: str

    def __str__(self) -> str:
        return f"{self.name}: {self.choice}, {self.reason}"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Choice of a method, its savings, and the reasons."""

    method: Method
    element: str  #: a key of `ELEMENTS`; empty where nothing is computed
    regions: tuple[Region, ...]  #: prisms inside the body that need a region of their own
    mirrors: tuple[Mirror, ...]  #: planes of symmetry to be used, at most one per axis
    keeps: frozenset[str]  #: names of the savings switched off
    decisions: tuple[Decision, ...]

    @property
    def lines(self) -> list[str]:
        """The decisions for people, one line each."""
        return [str(decision) for decision in self.decisions]

    def saves(self, name: str) -> bool:
        """True unless that saving was switched off."""
        return name not in self.keeps


def make_plan(scene: Scene, *, no_skip: Iterable[str] = (), field: bool = False) -> Plan:
    """Decide how to solve a scene.

    Parameters
    ----------
    scene : Scene
    no_skip : names of `SAVINGS`
        Savings to switch off.
    field : bool
        True if the displacement of the whole body is asked for.

    Raises
    ------
    SceneError
        For an unknown name, or a tolerance that arrays of soft pillars cannot keep.
    """
    keeps = frozenset(no_skip)
    for name in sorted(keeps - SAVINGS.keys()):
        raise SceneError(f"unknown saving '{name}'; known are {', '.join(SAVINGS)}.")
    regions, decisions = _regions(scene, keeps)
    method, mesh = _method(scene, regions, keeps, field)
    decisions.append(mesh)
    mirrors: tuple[Mirror, ...] = ()
    element, why = "", ""
    if method == "finite":
        mirrors, symmetry = _symmetry(scene, regions, keeps)
        mirrors = tuple(mirror for mirror in mirrors if mirror.parities == (1,))
        decisions.append(_folded(mirrors) if symmetry.choice not in ("none", "unused") else symmetry)
    if method == "grid":
        mirrors, symmetry = _symmetry(scene, regions, keeps)
        seconds = {"Qp": seconds_by_order(scene, regions, mirrors), "Q4": seconds_by_splitting(scene, regions)}
        element, other = sorted(seconds, key=seconds.__getitem__)
        why = f"predicted {seconds[element]:.1g} s (by {other} {seconds[other]:.1g} s): {ELEMENTS[element]}"
        if element == "Q4" and any(len(mirror.parities) > 1 for mirror in mirrors):
            mirrors = tuple(mirror for mirror in mirrors if len(mirror.parities) == 1)
            symmetry = _folded(mirrors)
        decisions.append(symmetry)
    elif method != "nothing":
        element = "Q2P" if method == "finite" else "Q2" if method == "cells" and not regions else "TH"
        why = ELEMENTS[element]
    if element:
        decisions.append(Decision(name="element", choice=element, reason=why))
    decisions.append(_field(scene, keeps, field))
    return Plan(
        method=method,
        element=element,
        regions=tuple(regions),
        mirrors=mirrors,
        keeps=keeps,
        decisions=tuple(decisions),
    )


def _regions(scene: Scene, keeps: frozenset[str]) -> tuple[list[Region], list[Decision]]:
    every = scene.regions
    if not every:
        return [], []
    what = "pillar" if isinstance(scene.body, Sensor) else "inclusion"
    own = [entry for entry in every if entry[1] != scene.material]
    same = len(every) - len(own)
    if "one-material" in keeps:
        return every, [Decision(name="one-material", choice="off", reason=f"{_count(every, what)} with a region each")]
    if not same:
        theirs = " and ".join(sorted({_rubber(material) for _, material in own}))
        reason = f"{_count(own, what)} of {theirs} in {_rubber(scene.material)}"
        return own, [Decision(name="one-material", choice="nothing to skip", reason=reason)]
    reason = f"{same} of {_count(every, what)} are of the body's own material"
    return own, [Decision(name="one-material", choice="interfaces skipped", reason=reason)]


def _method(scene: Scene, regions: list[Region], keeps: frozenset[str], field: bool) -> tuple[Method, Decision]:
    def tetrahedra(reason: str, choice: str = "tetrahedra") -> tuple[Method, Decision]:
        return "tetrahedra", Decision(name="mesh", choice=choice, reason=reason)

    if scene.is_unloaded and not field and "zero-load" not in keeps:
        return "nothing", Decision(name="mesh", choice="none", reason="nothing loads the body, so nothing moves")
    if not scene.is_linear:
        loads = ", ".join(sorted({load.kind for load in scene.loads}))
        return "finite", Decision(name="mesh", choice="graded hexahedra", reason=f"finite strain under {loads} loads")
    is_sensor = isinstance(scene.body, Sensor)
    units = scene.body.design.n_units if isinstance(scene.body, Sensor) and regions else 0
    soft = units > 1 and _are_soft(scene)
    if soft and units > MAX_WHOLE and scene.tolerance < SOFT_CELLS and not field:
        raise SceneError(
            f"tolerance={scene.tolerance:g}: pillars less than {SOFT:g} times as stiff as their matrix are known to "
            f"{SOFT_CELLS:g} only in arrays of more than {MAX_WHOLE} units: ask for that, or for fewer units."
        )
    if soft and units <= MAX_WHOLE:
        reason = f"cells are known to {SOFT_CELLS:g} only where pillars are so soft"
        return tetrahedra(reason, "tetrahedra of the whole array")
    seen_by_means = not field and all(probe.kind == "mean" for probe in scene.probes)
    if seen_by_means and "substructuring" not in keeps and has_alike_plates(scene):
        reason = "plates lie on all units alike: one is condensed, its copies are coupled"
        return "cells", Decision(name="mesh", choice="one cell", reason=reason)
    if units > 1 and not scene.stiff_loads and seen_by_means and "substructuring" not in keeps:
        reason = f"{units} equal units: one is meshed and condensed, its copies are coupled"
        return "cells", Decision(name="mesh", choice="one cell", reason=reason)
    oblique = sum(not prism.is_upright for prism, _ in regions)
    if oblique or units:
        what = "pillar" if is_sensor else "inclusion"
        return tetrahedra(f"{oblique} of {_count(regions, what)} of another material lean")
    if "hexahedra" in keeps:
        return tetrahedra("the grid was switched off")
    shape = "" if scene.outline.is_upright else ", its sheared sides sheared with it"
    boxes = f"the body and {_count(regions, 'inclusion')} are boxes" if regions else "the body is one box"
    return "grid", Decision(name="mesh", choice="structured hexahedra", reason=boxes + shape)


def _are_soft(scene: Scene) -> bool:
    """True of an array whose pillars are so much softer than the matrix that condensed cells say too little."""
    rubbers = [material.young_mpa for _, material in scene.regions]
    return isinstance(scene.body, Sensor) and min(rubbers) < SOFT * scene.material.young_mpa


def _symmetry(scene: Scene, regions: list[Region], keeps: frozenset[str]) -> tuple[tuple[Mirror, ...], Decision]:
    if "symmetry" in keeps:
        return (), Decision(name="symmetry", choice="unused", reason="it was switched off")
    mirrors = tuple(mirror for axis in (0, 1) if (mirror := _mirror(scene, regions, axis)))
    if not mirrors:
        return (), Decision(name="symmetry", choice="none", reason="no middle plane mirrors the body")
    return mirrors, _folded(mirrors)


def _folded(mirrors: tuple[Mirror, ...]) -> Decision:
    """The decision on symmetry for these mirrors."""
    if not mirrors:
        return Decision(name="symmetry", choice="unused", reason="the loads are neither even nor odd in any plane")
    planes = " and ".join(f"{AXES[mirror.axis]} = {mirror.position_mm:g}" for mirror in mirrors)
    share = {1: "half", 2: "a quarter"}[len(mirrors)]
    count = len(parities(mirrors))
    loads = "the loads as well" if count == 1 else f"the loads are split into {count} even and odd parts"
    reason = f"the body mirrors in {planes} mm, {loads}"
    return Decision(name="symmetry", choice=f"{share} of the grid", reason=reason)


def _mirror(scene: Scene, regions: list[Region], axis: int) -> Mirror | None:
    """The body's middle plane across an axis, if body and inclusions mirror themselves in it."""
    outline, slack = scene.outline, scene.rounding_mm
    if outline.base_mm[axis] != outline.top_mm[axis]:
        return None
    plane = Mirror(axis=axis, position_mm=outline.base_mm[axis], parities=(1, -1))
    own = [
        (np.array([prism.base_mm, prism.top_mm]), np.array(prism.section_mm), material) for prism, material in regions
    ]
    for ends, section, material in own:
        image = flipped_points(ends, (plane,))
        if not any(
            _near(image, other, slack) and _near(section, size, slack) and m == material for other, size, m in own
        ):
            return None
    whole = [
        parity
        for parity in (1, -1)
        if all(_loads_mirror(loads, plane, parity, slack) for loads in scene.summed_loads.values())
    ]
    return replace(plane, parities=(whole[0],)) if whole else plane


def _near(one: np.ndarray, other: np.ndarray, slack: float) -> bool:
    return bool(np.abs(one - other).max() <= slack)


def _loads_mirror(loads: dict[Rectangle, np.ndarray], plane: Mirror, parity: int, slack: float) -> bool:
    """True if the mirror image of the loads, times the parity, are the loads: vectors, and moments after them."""
    flip = np.where(np.arange(3) == plane.axis, -1.0, 1.0)
    for rectangle, traction in loads.items():
        image = flipped_rectangles(np.array(rectangle), (plane,))
        wanted = parity * np.concatenate([flip, -flip])[: len(traction)] * traction
        largest = np.abs(traction).max()
        if not any(
            _near(image, np.array(other), slack) and np.abs(wanted - given).max() <= 1e-12 * largest
            for other, given in loads.items()
        ):
            return False
    return True


def _count(entries: Sequence[object], what: str) -> str:
    return f"{len(entries)} {what}{'' if len(entries) == 1 else 's'}"


def _rubber(material: Material) -> str:
    return f"E = {material.young_mpa:g} MPa, ν = {material.poisson:g}"


def _field(scene: Scene, keeps: frozenset[str], asked: bool) -> Decision:
    if asked:
        return Decision(name="field", choice="computed", reason="a picture was asked for")
    if "field" in keeps:
        return Decision(name="field", choice="computed", reason="it was not to be skipped")
    return Decision(name="field", choice="skipped", reason=f"{_count(scene.probes, 'probe')} asked for, no picture")
