"""A scene as numbers: one body of rubber, what presses it and what to report, refusing nonsense by name.

Lengths in mm, moduli and tractions in MPa. The base z = 0 is clamped, the top face is loaded, every other face is free.
Coordinates: a block extends from the origin corner, a pillar stands where its ends are, a unit and an array are centred
on the origin as their design says.
"""

import reprlib
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from common.errors import SceneError
from common.quantity import is_finite, quantity
from fem.kernel.loads import LIMITS_MM, Checked, DeadLoad, Load, Rectangle, StiffLoad, rectangle_of
from geometry.design import Material, SensorDesign, lone_unit
from geometry.layout import FloatArray
from geometry.prism import Pair, Prism, Triple, pillar_prisms, prisms_at, slab_prism

ROUNDING = 1e-9  #: of a body's extent: how far rounding may put an edge past the face it lies on
PROBE_KEYS = {"mean": ("center_mm", "size_mm"), "point": ("position_mm",)}  #: where a probe of each kind looks
Region = tuple[Prism, Material]  #: a part of the body with a rubber of its own


def regions_at(points_mm: FloatArray, regions: Sequence[Region]) -> NDArray[np.int64]:
    """The region of each of the points (n, 3): 0 for the body's own, i + 1 for regions[i]."""
    return prisms_at(points_mm, [prism for prism, _ in regions])


@dataclass(frozen=True, kw_only=True)
class Block(Checked):
    """A box from the origin corner."""

    size_mm: Triple = quantity(
        MISSING, "extent of the block along x, y and z from the origin corner, in mm", count=3, above_0=True
    )

    @property
    def outline(self) -> Prism:
        x, y, z = self.size_mm
        return Prism(base_mm=(x / 2, y / 2, 0.0), top_mm=(x / 2, y / 2, z), section_mm=(x, y))


@dataclass(frozen=True, kw_only=True)
class _Straight(Prism, Checked):
    """A straight prism, upright or oblique, of constant horizontal section."""

    base_mm: Triple = quantity(MISSING, "centre of the lower end: x, y, z, in mm", count=3)
    top_mm: Triple = quantity(MISSING, "centre of the upper end: x, y, z, in mm", count=3)
    section_mm: Pair = quantity(MISSING, "extent of the horizontal section along x and y, in mm", count=2, above_0=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.height_mm >= LIMITS_MM[0]:
            raise SceneError(
                f"top_mm={list(self.top_mm)} must lie above base_mm={list(self.base_mm)}: its height would be "
                f"{self.height_mm:g} mm; swap or part them."
            )


@dataclass(frozen=True, kw_only=True)
class Pillar(_Straight):
    """A straight free pillar whose lower end is clamped."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.base_mm[2] != 0.0:
            raise SceneError(f"base_mm={list(self.base_mm)} must lie on the clamped base: its third number must be 0.")

    @property
    def outline(self) -> Prism:
        return self


@dataclass(frozen=True, kw_only=True)
class Inclusion(_Straight):
    """A straight prism of another material inside a block; it may touch the block's faces from inside."""

    material: Material = field(default_factory=Material)


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A unit or an array of a design: its slab with the pillars in it. A unit is the design as a 1 × 1 array."""

    design: SensorDesign = field(default_factory=SensorDesign)
    kind: Literal["unit", "array"] = "array"

    def __post_init__(self) -> None:
        if self.kind not in ("unit", "array"):
            raise SceneError(f"kind={reprlib.repr(self.kind)} must be 'unit' or 'array'.")
        if self.kind == "unit":
            object.__setattr__(self, "design", lone_unit(self.design))

    @property
    def outline(self) -> Prism:
        return slab_prism(self.design)

    @property
    def pillars(self) -> list[Prism]:
        """The pillars of every unit; those of a unit overlap at common electrodes."""
        return pillar_prisms(self.design)


Body = Block | Pillar | Sensor


@dataclass(frozen=True, kw_only=True)
class Probe(Checked):
    """A displacement to report: the mean over a rectangle of the top face, or that of a point."""

    name: str
    kind: Literal["mean", "point"]
    center_mm: Pair | None = quantity(None, "centre of a mean probe's rectangle: x, y, in mm", count=2)
    size_mm: Pair | None = quantity(None, "extent of a mean probe's rectangle: x, y, in mm", count=2, above_0=True)
    position_mm: Triple | None = quantity(None, "position of a point probe: x, y, z, in mm", count=3)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip() or not self.name.isprintable():
            raise SceneError(f"name={reprlib.repr(self.name)} must be a word by which the probe is reported.")
        if not isinstance(self.kind, str) or self.kind not in PROBE_KEYS:
            raise SceneError(f"kind={reprlib.repr(self.kind)} must be 'mean' or 'point'.")
        needed = PROBE_KEYS[self.kind]
        for key in sum(PROBE_KEYS.values(), ()):
            if (getattr(self, key) is not None) != (key in needed):
                raise SceneError(
                    f"a probe of kind '{self.kind}' takes {' and '.join(needed)}: "
                    f"{key} is {'missing' if key in needed else 'not one of them'}."
                )
        super().__post_init__()

    @property
    def rectangle(self) -> Rectangle:
        """The rectangle of a mean probe."""
        if self.center_mm is None or self.size_mm is None:
            raise SceneError(f"probe '{self.name}' is a point: it has no rectangle.")
        return rectangle_of(self.center_mm, self.size_mm)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One body, its materials, its loads and its probes: all that a solve needs to know.

    Of a unit or an array the rubbers are those of the design; `material` then states the matrix's.
    """

    body: Body
    material: Material = field(default_factory=Material)
    inclusions: tuple[Inclusion, ...] = ()
    loads: tuple[Load, ...] = ()
    probes: tuple[Probe, ...] = ()
    tolerance: float = 1e-3  #: relative error wanted on the probes

    def __post_init__(self) -> None:
        for name in ("inclusions", "loads", "probes"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not is_finite(self.tolerance) or not 0 < self.tolerance < 1:
            raise SceneError(
                f"tolerance={reprlib.repr(self.tolerance)} must be a number above 0 and below 1: the relative error "
                "wanted on the probes; write 1e-3."
            )
        object.__setattr__(self, "tolerance", float(self.tolerance))
        if isinstance(self.body, Sensor) and self.material != self.body.design.matrix_material:
            raise SceneError("material must be the design's matrix_material where the body is a unit or an array.")
        if self.inclusions and not isinstance(self.body, Block):
            raise SceneError("inclusions go with a block only: remove them, or make the body a block.")
        self._check_inclusions()
        self._check_loads_and_probes()

    def _check_inclusions(self) -> None:
        for number, inclusion in enumerate(self.inclusions, start=1):
            corners = inclusion.corners()
            if not self.outline.holds(corners, self.rounding_mm).all():
                raise SceneError(
                    f"inclusion {number} reaches from {_row(corners.min(axis=0))} to {_row(corners.max(axis=0))} mm, "
                    f"outside the block [0, 0, 0] to {_row(self.outline.corners().max(axis=0))}: move or shrink it."
                )
            if inclusion.material.model != self.material.model:
                raise SceneError(
                    f"inclusion {number} is not {self.material.model}, as the body is: give both one model."
                )
        for (one, first), (two, second) in combinations(enumerate(self.inclusions, start=1), 2):
            if first.cuts(second, self.rounding_mm):
                raise SceneError(f"inclusions {one} and {two} overlap: part or shrink them; they may touch.")

    def _check_loads_and_probes(self) -> None:
        if not self.probes:
            raise SceneError("the scene has no probe, so there is nothing to report: add a [[probe]].")
        names = [probe.name for probe in self.probes]
        for name in names:
            if names.count(name) > 1:
                raise SceneError(f"two probes have the name {reprlib.repr(name)}: give each a name of its own.")
        for number, load in enumerate(self.loads, start=1):
            self._require_on_top(f"load {number}", load.rectangle)
        self._check_plates()
        for probe in self.probes:
            if probe.kind == "mean":
                self._require_on_top(f"probe '{probe.name}'", probe.rectangle)
            elif not self.outline.holds(np.array([probe.position_mm]), self.rounding_mm)[0]:
                corners = self.outline.corners()
                raise SceneError(
                    f"probe '{probe.name}' at {_row(probe.position_mm or ())} mm is in the air: the body lies within "
                    f"{_row(corners.min(axis=0))} to {_row(corners.max(axis=0))}"
                    f"{'' if self.outline.is_upright else ' along its oblique axis'}; move it inside."
                )

    def _check_plates(self) -> None:
        for (one, first), (two, second) in combinations(enumerate(self.loads, start=1), 2):
            n_plates = isinstance(first, StiffLoad) + isinstance(second, StiffLoad)
            a, b = np.array(first.rectangle), np.array(second.rectangle)
            overlap = (np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])).min()
            if n_plates and overlap > {1: self.rounding_mm, 2: -self.rounding_mm}[n_plates]:
                allowed = "they may touch" if n_plates == 1 else "touching plates would be a hinge"
                raise SceneError(f"loads {one} and {two} share a stiff plate's rectangle: part them; {allowed}.")

    def _require_on_top(self, name: str, rectangle: Rectangle) -> None:
        x0, y0, x1, y1 = self.top_mm
        a0, b0, a1, b1 = rectangle
        if max(x0 - a0, y0 - b0, a1 - x1, b1 - y1) > self.rounding_mm:
            raise SceneError(
                f"{name} covers x {a0:g} to {a1:g}, y {b0:g} to {b1:g} mm, not wholly on the body's top face, "
                f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g}: move or shrink it."
            )

    @property
    def outline(self) -> Prism:
        """The body's own shape."""
        return self.body.outline

    @property
    def height_mm(self) -> float:
        return self.outline.height_mm

    @property
    def rounding_mm(self) -> float:
        """Largest distance of coordinates that mean the same place."""
        return ROUNDING * float(np.ptp(self.outline.corners(), axis=0).max())

    @property
    def top_mm(self) -> Rectangle:
        """The top face."""
        return rectangle_of(self.outline.top_mm[:2], self.outline.section_mm)

    @property
    def regions(self) -> list[Region]:
        """Every prism inside the body with its material, whether it differs from the body's or not."""
        if isinstance(self.body, Sensor):
            return [(pillar, self.body.design.pillar_material) for pillar in self.body.pillars]
        return [(inclusion, inclusion.material) for inclusion in self.inclusions]

    @property
    def is_linear(self) -> bool:
        """True if the rubber is linear elastic: small strain."""
        return self.material.model == "linear"

    def under(self, share: float) -> "Scene":
        """The same scene under a share of its loads."""
        return self if share == 1.0 else replace(self, loads=tuple(load.times(share) for load in self.loads))

    @property
    def stiff_loads(self) -> tuple[StiffLoad, ...]:
        return tuple(load for load in self.loads if isinstance(load, StiffLoad))

    @property
    def dead_loads(self) -> tuple[DeadLoad, ...]:
        """The loads as small strain sees them: a pressure pushes along −z, a plate's force is spread over the plate."""
        return tuple(dead for load in self.loads for dead in load.spread)

    @property
    def plate_rectangles_mm(self) -> FloatArray:
        """Rectangles of the stiff loads' plates, loaded or not, shape (n_plates, 4)."""
        return self._on_top([load.rectangle for load in self.stiff_loads])

    @property
    def load_rectangles_mm(self) -> FloatArray:
        """Rectangles of `dead_loads`, shape (n_loads, 4)."""
        return self._on_top([load.rectangle for load in self.dead_loads])

    @property
    def tractions_mpa(self) -> FloatArray:
        """Traction of every one of `dead_loads`, shape (n_loads, 3)."""
        return np.array([load.traction_mpa for load in self.dead_loads], dtype=np.float64).reshape(-1, 3)

    @property
    def mean_probes(self) -> list[Probe]:
        return [probe for probe in self.probes if probe.kind == "mean"]

    @property
    def probe_rectangles_mm(self) -> FloatArray:
        """Rectangles of the mean probes, in their order, shape (n_means, 4)."""
        return self._on_top([probe.rectangle for probe in self.mean_probes])

    @property
    def probe_points_mm(self) -> FloatArray:
        """Positions of the point probes, in their order, shape (n_points, 3)."""
        points = [probe.position_mm for probe in self.probes if probe.kind == "point"]
        return np.array(points, dtype=np.float64).reshape(-1, 3)

    @property
    def summed_loads(self) -> dict[str, dict[Rectangle, FloatArray]]:
        """By kind, tractions of every loaded rectangle along x, y, z (pressures along −z), or force and moment."""
        return _summed(self.loads)

    @property
    def is_unloaded(self) -> bool:
        """True if no load remains once those on equal rectangles are added up."""
        return not any(sums.any() for loads in _summed(self.dead_loads).values() for sums in loads.values())

    def _on_top(self, rectangles: list[Rectangle]) -> FloatArray:
        """Rectangles without what rounding puts past the top face."""
        x0, y0, x1, y1 = self.top_mm
        limits = np.array([[x0, y0, x0, y0], [x1, y1, x1, y1]])
        return np.clip(np.array(rectangles, dtype=np.float64).reshape(-1, 4), *limits)


def _summed(loads: Sequence[Load]) -> dict[str, dict[Rectangle, FloatArray]]:
    sums: dict[str, dict[Rectangle, FloatArray]] = {}
    for load in loads:
        own = sums.setdefault(load.kind, {})
        own[load.rectangle] = own.get(load.rectangle, 0.0) + np.array(load.components)
    return sums


def _row(numbers: Any) -> str:
    return "[" + ", ".join(f"{number:.6g}" for number in numbers) + "]"
