"""Look at a scene before anything is computed: choose the method, name what is skipped, and say why."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fem.mirrors import Mirror, flipped_points, flipped_rectangles, parities
from fem.scene.cells import has_alike_plates
from fem.scene.checks import SceneError
from fem.scene.loads import Rectangle
from fem.scene.scene import Region, Scene, Sensor
from geometry.design import Material
from geometry.layout import AXES

Method = Literal["nothing", "boxes", "cells", "tetrahedra", "finite", "finite on tetrahedra"]

BOXES = "split hexahedra of order 3 or 4"
HEXAHEDRA = "quadratic hexahedra"
MIXED = "mixed quadratic hexahedra"
TETRAHEDRA = "Taylor-Hood tetrahedra"
#: by the element's name, why it is used
ELEMENTS = {
    BOXES: "fine only where the probes need it, factored: whatever contrast, ν, shear and slenderness",
    HEXAHEDRA: "they crowd at the edges of plates, two levels extrapolated",
    MIXED: "the pressure linear in each and found there: neo-Hookean rubber does not lock",
    TETRAHEDRA: "displacement P2 and pressure P1: they do not lock, whatever ν",
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
    regions: tuple[Region, ...]  #: prisms inside the body that need a region of their own
    mirrors: tuple[Mirror, ...]  #: planes of symmetry to be used, at most one per axis
    decisions: tuple[Decision, ...]

    @property
    def lines(self) -> list[str]:
        """The decisions for people, one line each."""
        return [str(decision) for decision in self.decisions]


def make_plan(scene: Scene, *, field: bool = False) -> Plan:
    """Decide how to solve a scene.

    Parameters
    ----------
    scene : Scene
    field : bool
        True if the displacement of the whole body is asked for.

    Raises
    ------
    SceneError
        For a tolerance that arrays of soft pillars cannot keep.
    """
    regions, decisions = _regions(scene)
    method, mesh = _method(scene, regions, field)
    decisions.append(mesh)
    mirrors: tuple[Mirror, ...] = ()
    if method in ("boxes", "finite"):
        mirrors, symmetry = _symmetry(scene, regions, even=method == "finite")
        decisions.append(symmetry)
    if method != "nothing":
        element = _element(method, regions)
        decisions.append(Decision(name="element", choice=element, reason=ELEMENTS[element]))
    decisions.append(_field(scene, field))
    return Plan(method=method, regions=tuple(regions), mirrors=mirrors, decisions=tuple(decisions))


def _element(method: Method, regions: Sequence[Region]) -> str:
    """The key of `ELEMENTS` of a method."""
    if method == "cells":
        return TETRAHEDRA if regions else HEXAHEDRA
    return {"boxes": BOXES, "finite": MIXED}.get(method, TETRAHEDRA)


def _regions(scene: Scene) -> tuple[list[Region], list[Decision]]:
    every = scene.regions
    if not every:
        return [], []
    what = "pillar" if isinstance(scene.body, Sensor) else "inclusion"
    own = [entry for entry in every if entry[1] != scene.material]
    same = len(every) - len(own)
    if not same:
        theirs = " and ".join(sorted({_rubber(material) for _, material in own}))
        reason = f"{_count(own, what)} of {theirs} in {_rubber(scene.material)}"
        return own, [Decision(name="one-material", choice="nothing to skip", reason=reason)]
    reason = f"{same} of {_count(every, what)} are of the body's own material"
    return own, [Decision(name="one-material", choice="interfaces skipped", reason=reason)]


def _method(scene: Scene, regions: list[Region], field: bool) -> tuple[Method, Decision]:
    def tetrahedra(reason: str, choice: str = "tetrahedra") -> tuple[Method, Decision]:
        return "tetrahedra", Decision(name="mesh", choice=choice, reason=reason)

    is_sensor = isinstance(scene.body, Sensor)
    what = "pillar" if is_sensor else "inclusion"
    oblique = sum(not prism.is_upright for prism, _ in regions)
    if scene.is_unloaded and not field:
        return "nothing", Decision(name="mesh", choice="none", reason="nothing loads the body, so nothing moves")
    if not scene.is_linear:
        reason = f"finite strain under {', '.join(sorted({load.kind for load in scene.loads}))} loads"
        if oblique or (is_sensor and regions):
            reason += f", {oblique} of {_count(regions, what)} of another material lean"
            return "finite on tetrahedra", Decision(name="mesh", choice="tetrahedra", reason=reason)
        return "finite", Decision(name="mesh", choice="graded hexahedra", reason=reason)
    units = scene.body.design.n_units if isinstance(scene.body, Sensor) else 0
    soft = units > 1 and bool(regions) and _are_soft(scene)
    if soft and units > MAX_WHOLE and scene.tolerance < SOFT_CELLS and not field:
        raise SceneError(
            f"tolerance={scene.tolerance:g}: pillars less than {SOFT:g} times as stiff as their matrix are known to "
            f"{SOFT_CELLS:g} only in arrays of more than {MAX_WHOLE} units: ask for that, or for fewer units."
        )
    if soft and units <= MAX_WHOLE:
        reason = f"cells are known to {SOFT_CELLS:g} only where pillars are so soft"
        return tetrahedra(reason, "tetrahedra of the whole array")
    seen_by_means = not field and all(probe.kind == "mean" for probe in scene.probes)
    if seen_by_means and has_alike_plates(scene):
        reason = "plates lie on all units alike: one is condensed, its copies are coupled"
        return "cells", Decision(name="mesh", choice="one cell", reason=reason)
    if units > 1 and not scene.stiff_loads and seen_by_means:
        reason = f"{units} equal units: one is meshed and condensed, its copies are coupled"
        return "cells", Decision(name="mesh", choice="one cell", reason=reason)
    if oblique or (units and regions):
        return tetrahedra(f"{oblique} of {_count(regions, what)} of another material lean")
    shape = "" if scene.outline.is_upright else ", its sheared sides sheared with it"
    boxes = f"the body and {_count(regions, 'inclusion')} are boxes" if regions else "the body is one box"
    return "boxes", Decision(name="mesh", choice="hexahedra", reason=boxes + shape)


def _are_soft(scene: Scene) -> bool:
    """True of an array whose pillars are so much softer than the matrix that condensed cells say too little."""
    rubbers = [material.young_mpa for _, material in scene.regions]
    return isinstance(scene.body, Sensor) and min(rubbers) < SOFT * scene.material.young_mpa


def _symmetry(scene: Scene, regions: list[Region], even: bool) -> tuple[tuple[Mirror, ...], Decision]:
    """Planes that mirror the body; if `even`, the loads too."""
    mirrors = tuple(mirror for axis in (0, 1) if (mirror := _mirror(scene, regions, axis)))
    if not mirrors:
        return (), Decision(name="symmetry", choice="none", reason="no middle plane mirrors the body")
    if even:
        mirrors = tuple(mirror for mirror in mirrors if mirror.parities == (1,))
    if not mirrors:
        return (), Decision(name="symmetry", choice="unused", reason="no plane of the body mirrors the loads")
    planes = " and ".join(f"{AXES[mirror.axis]} = {mirror.position_mm:g}" for mirror in mirrors)
    share = {1: "half", 2: "a quarter"}[len(mirrors)]
    count = len(parities(mirrors))
    loads = "the loads as well" if count == 1 else f"the loads in {count} even and odd parts where that is cheaper"
    reason = f"the body mirrors in {planes} mm, {loads}"
    return mirrors, Decision(name="symmetry", choice=f"{share} of the body", reason=reason)


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


def _field(scene: Scene, asked: bool) -> Decision:
    if asked:
        return Decision(name="field", choice="computed", reason="a picture was asked for")
    return Decision(name="field", choice="skipped", reason=f"{_count(scene.probes, 'probe')} asked for, no picture")
