"""Look at a scene before anything is computed: choose the method, name what is skipped, and say why."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fem.kernel.mirrors import Mirror, flipped_points, flipped_rectangles
from fem.meshes.leaning import Leaning
from fem.methods.cell_scene import has_alike_plates
from fem.scene.scene import Region, Scene, Sensor
from geometry.design import Material
from geometry.layout import AXES, FloatArray

Method = Literal["nothing", "boxes", "cells", "tetrahedra", "finite", "finite on tetrahedra"]

#: by method, its elements and why they are used; cells of two rubbers are of tetrahedra
ELEMENTS = {
    "boxes": "split hexahedra of order 3, then 4, fine only where the probes need it, factored: whatever contrast, ν, "
    "shear and slenderness",
    "cells": "quadratic hexahedra, they crowd at the edges of plates, two levels extrapolated",
    "finite": "mixed quadratic hexahedra, the pressure linear in each and found there: rubber does not lock",
    "tetrahedra": "Taylor-Hood tetrahedra, displacement P2 and pressure P1: they do not lock, whatever ν",
}
SAME = 1e-12  #: relative difference of equal numbers that rounding may make


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Choice of a method, its savings, and the reasons."""

    method: Method
    regions: tuple[Region, ...]  #: prisms inside the body that need a region of their own
    mirrors: tuple[Mirror, ...]  #: planes that mirror the body, at most one per axis; those of finite strain, the loads
    lines: tuple[str, ...]  #: for people: name, choice and reason of every decision


def make_plan(scene: Scene, *, field: bool = False) -> Plan:
    """Decide how to solve a scene; `field` asks for the displacement of the whole body."""
    regions = [entry for entry in scene.regions if entry[1] != scene.material]
    method, mesh = _method(scene, regions, field)
    lines = [*_one_material(scene, regions), f"mesh: {mesh}"]
    mirrors: tuple[Mirror, ...] = ()
    if method in ("boxes", "finite"):
        mirrors, symmetry = _symmetry(scene, regions, even=method == "finite")
        lines.append(f"symmetry: {symmetry}")
    if method != "nothing":
        of_tetrahedra = method == "finite on tetrahedra" or (method == "cells" and regions)
        lines.append(f"element: {ELEMENTS['tetrahedra' if of_tetrahedra else method]}")
    skipped = f"skipped, {_count(scene.probes, 'probe')} asked for, no picture"
    lines.append(f"field: {'computed, a picture was asked for' if field else skipped}")
    return Plan(method=method, regions=tuple(regions), mirrors=mirrors, lines=tuple(lines))


def _one_material(scene: Scene, own: list[Region]) -> list[str]:
    """What is said of prisms in the body, `own` of which are of another rubber."""
    every, what = scene.regions, "pillar" if isinstance(scene.body, Sensor) else "inclusion"
    if not every:
        return []
    if len(own) < len(every):
        same = len(every) - len(own)
        return [f"one-material: interfaces skipped, {same} of {_count(every, what)} are of the body's own material"]
    theirs = " and ".join(sorted({_rubber(material) for _, material in own}))
    return [f"one-material: nothing to skip, {_count(own, what)} of {theirs} in {_rubber(scene.material)}"]


def _method(scene: Scene, regions: list[Region], field: bool) -> tuple[Method, str]:
    """The method, and what is said of its mesh."""
    is_sensor = isinstance(scene.body, Sensor)
    oblique = sum(not prism.is_upright for prism, _ in regions)
    leaning = f"{oblique} of {_count(regions, 'pillar' if is_sensor else 'inclusion')} of another material lean"
    if scene.is_unloaded and not field:
        return "nothing", "none, nothing loads the body, so nothing moves"
    if not scene.is_linear:
        loads = f"finite strain under {', '.join(sorted({load.kind for load in scene.loads}))} loads"
        if oblique or (is_sensor and regions):
            return "finite on tetrahedra", f"tetrahedra, {loads}, {leaning}"
        return "finite", f"graded hexahedra, {loads}"
    units = scene.body.design.n_units if isinstance(scene.body, Sensor) else 0
    seen_by_means = not field and all(probe.kind == "mean" for probe in scene.probes)
    if seen_by_means and has_alike_plates(scene):
        return "cells", "one cell, plates lie on all units alike: one is condensed, its copies are coupled"
    if (units > 1 or (units and regions)) and not scene.stiff_loads and seen_by_means:
        if units == 1:
            return "cells", "one cell, the unit itself, its sides free"
        return "cells", f"one cell, {units} equal units: one is meshed and condensed, its copies are coupled"
    if units and regions:
        return "tetrahedra", f"tetrahedra, {leaning}"
    prisms = [prism for prism, _ in regions]
    if any(prism.lean != scene.outline.lean for prism in prisms):
        if field:
            return "tetrahedra", f"tetrahedra, {leaning} and a picture needs the same elements on both sides of a face"
        if Leaning.of(scene.outline, prisms, scene.rounding_mm) is None:
            return "tetrahedra", f"tetrahedra, {leaning} and lines along their faces would meet"
        return "boxes", f"hexahedra whose lines lean with inclusions, {leaning}"
    shape = "" if scene.outline.is_upright else ", its sheared sides sheared with it"
    boxes = f"the body and {_count(regions, 'inclusion')} are boxes" if regions else "the body is one box"
    return "boxes", f"hexahedra, {boxes}{shape}"


def _symmetry(scene: Scene, regions: list[Region], even: bool) -> tuple[tuple[Mirror, ...], str]:
    """Planes that mirror the body, if `even` the loads, too; and what is said of those where loads are even, or odd."""
    mirrors = tuple(mirror for axis in (0, 1) if (mirror := _mirror(scene, regions, axis)))
    if not mirrors:
        return (), "none, no middle plane mirrors the body"
    used = tuple(mirror for mirror in mirrors if mirror.parities == (1,) or (len(mirror.parities) == 1 and not even))
    if not used:
        return (() if even else mirrors), "unused, no plane of the body mirrors the loads"
    planes = " and ".join(f"{AXES[mirror.axis]} = {mirror.position_mm:g}" for mirror in used)
    share = {1: "half", 2: "a quarter"}[len(used)]
    return (used if even else mirrors), f"{share} of the body, the body mirrors in {planes} mm, the loads as well"


def _mirror(scene: Scene, regions: list[Region], axis: int) -> Mirror | None:
    """The body's middle plane across an axis, if body and inclusions mirror themselves in it."""
    outline, slack = scene.outline, scene.rounding_mm
    if outline.base_mm[axis] != outline.top_mm[axis]:
        return None
    plane = Mirror(axis=axis, position_mm=outline.base_mm[axis], parities=(1, -1))
    own = [
        (np.array([prism.base_mm, prism.top_mm]), np.array([*prism.section_mm, rubber.young_mpa, rubber.poisson]))
        for prism, rubber in regions
    ]
    if not _are_among([(flipped_points(ends, (plane,)), size) for ends, size in own], own, slack):
        return None
    flip = np.where(np.arange(3) == axis, -1.0, 1.0)

    def is_whole(parity: int) -> bool:
        """True if the mirror image of the loads, times the parity, are the loads: vectors, and moments after them."""
        signs = parity * np.concatenate([flip, -flip])
        for loads in scene.summed_loads.values():
            given = [(np.array(rectangle), load) for rectangle, load in loads.items()]
            images = [(flipped_rectangles(at, (plane,)), signs[: len(load)] * load) for at, load in given]
            if not _are_among(images, given, slack):
                return False
        return True

    whole = [parity for parity in plane.parities if is_whole(parity)]
    return replace(plane, parities=tuple(whole[:1])) if whole else plane


Placed = list[tuple[FloatArray, FloatArray]]  #: places and values


def _are_among(ones: Placed, others: Placed, slack: float) -> bool:
    """True if each of some values has its equal in the same place, up to a slack, among others."""
    return all(
        any(
            np.abs(at - place).max() <= slack and np.abs(value - given).max() <= SAME * np.abs(value).max()
            for place, given in others
        )
        for at, value in ones
    )


def _count(entries: Sequence[object], what: str) -> str:
    return f"{len(entries)} {what}{'' if len(entries) == 1 else 's'}"


def _rubber(material: Material) -> str:
    return f"E = {material.young_mpa:g} MPa, ν = {material.poisson:g}"
