"""``python -m studies touched --model touch.safetensors``: touch of shapes that no library has, at rest, and lightly.

Cones, rings, roof edges and two balls on one tool, pressed and dragged as the protocol `indent` does its shapes;
``--newtons 0.5 5`` draws contacts by their net forces, ``--known`` shapes of the library's kinds.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from common.errors import DesignError
from dataset import Samples
from dataset.indentation import DEPTH, FRICTION, PRESSED_ONLY, SLIDE, drawn_press, largest_strain, samples_of
from dataset.measurement import ReadingError
from decoupler.model_file import read_model
from decoupler.touch.assessment import assess_touch
from decoupler.touch.bare import BareDecoder
from decoupler.touch.decoder import TouchDecoder
from fem import SolverError
from fem.contact import Contact, ContactError, Shape, Sphere, SurfaceCompliance, about_z, press, surface_compliance
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray
from studies.tables import OUT, Folder, Row, report
from tripillar.terminal.progress import Bars

MAX_STRAIN = 0.3
CELLS = 48
Newtons = tuple[float, float] | None  #: range of a net force
STEPS, CLOSE, TINY_N = 4, 0.1, 1e-6  #: of the search for a depth: how many, its logarithm's error, the least force


@dataclass(frozen=True, eq=False)
class Cone(Shape):
    """A tip that points down."""

    slope: float

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return np.asarray(self.slope * np.hypot(x_mm, y_mm))

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        return height_mm / self.slope, height_mm / self.slope


@dataclass(frozen=True, eq=False)
class Ring(Shape):
    """A torus that lies on the rubber."""

    radius_mm: float
    tube_mm: float

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        off = np.hypot(x_mm, y_mm) - self.radius_mm
        inside = np.minimum(np.abs(off), self.tube_mm)
        return np.where(np.abs(off) < self.tube_mm, self.tube_mm - np.sqrt(self.tube_mm**2 - inside**2), np.inf)

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        return self.radius_mm + self.tube_mm, self.radius_mm + self.tube_mm


@dataclass(frozen=True, eq=False)
class Edge(Shape):
    """A roof upside down: two planes that meet in an edge of some length."""

    slope: float
    length_mm: float

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return np.where(np.abs(x_mm) <= self.length_mm / 2, self.slope * np.abs(y_mm), np.inf)

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        return self.length_mm / 2, height_mm / self.slope


@dataclass(frozen=True, eq=False)
class TwoBalls(Shape):
    """Two balls on one tool, one of them a little higher."""

    radii_mm: tuple[float, float]
    apart_mm: float
    higher_mm: float

    def own_heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        (one, other), off = (Sphere(radius) for radius in self.radii_mm), self.apart_mm / 2
        return np.minimum(one.heights_mm(x_mm - off, y_mm), other.heights_mm(x_mm + off, y_mm) + self.higher_mm)

    def own_extents_mm(self, height_mm: float) -> tuple[float, float]:
        half = max(self.radii_mm) + self.apart_mm / 2
        return half, half


def unknown_contacts(
    surface: SurfaceCompliance, count: int, seed: int, newtons: Newtons = None, *, known: bool = False
) -> list[Contact]:
    """Contacts of the four kinds in turn, or of the library's kinds, each below a strain of 0.3.

    `newtons` is the range of their net force along z, drawn evenly in its logarithm; default: as deep as `indent` goes.
    """
    found: list[Contact] = []
    attempt = 0
    while len(found) < count:
        generator = np.random.default_rng([seed, len(found), attempt])
        attempt += 1
        try:
            contact = drawn_press(generator, surface) if known else _drawn(generator, surface, len(found) % 4)
            if newtons is not None:
                low, high = newtons
                contact = _pressed_to(contact, low * (high / low) ** generator.uniform())
        except (ContactError, SolverError):  # it misses the sensor, or finds no balance
            continue
        net_n = float(contact.net_force_n[2])
        is_within = newtons is None or newtons[0] <= net_n <= newtons[1]
        if is_within and largest_strain(contact) <= MAX_STRAIN:
            found.append(contact)
            attempt = 0
    return found


def _pressed_to(contact: Contact, net_n: float) -> Contact:
    """A contact's shape pressed to about a net force, and no deeper than `indent` goes; its slide in proportion."""
    for _ in range(STEPS):
        ratio = (net_n / max(float(contact.net_force_n[2]), TINY_N)) ** (2 / 3)  # as a ball's
        if abs(np.log(ratio)) < CLOSE:
            break
        depth_mm = min(contact.depth_mm * ratio, DEPTH[1] * contact.design.unit.height_mm)
        contact = press(
            contact.surface, contact.shape, depth_mm, at_mm=contact.at_mm, friction=contact.friction, cells=CELLS,
            slide_mm=(contact.slide_mm[0] * ratio, contact.slide_mm[1] * ratio),
        )  # fmt: skip
    return contact


def unknown_samples(
    design: SensorDesign, errors: ReadingError, count: int, seed: int, newtons: Newtons = None, *, known: bool = False
) -> Samples:
    """Such contacts with a sensor, as it is read."""
    data = samples_of(unknown_contacts(surface_compliance(design)[0], count, seed, newtons, known=known))
    read = errors.read(data.resistance_ohm, np.random.default_rng(seed))
    return replace(data, resistance_ohm=read, noise=errors.noise, bits=errors.bits)


def _drawn(generator: np.random.Generator, surface: SurfaceCompliance, kind: int) -> Contact:
    design = surface.design
    h, slab, turn = design.unit.height_mm, np.array(design.slab_mm[:2]), about_z(generator.uniform(0.0, 180.0))
    shape = (
        lambda: Cone(generator.uniform(0.2, 0.8)),
        lambda: Ring(h * generator.uniform(0.4, 1.0), h * generator.uniform(0.15, 0.5)),
        lambda: Edge(generator.uniform(0.2, 0.8), h * generator.uniform(0.5, 3.0), turn=turn),
        lambda: TwoBalls(
            (h * generator.uniform(0.3, 1.2), h * generator.uniform(0.3, 1.2)), h * generator.uniform(1.2, 4.5),
            h * generator.uniform(0, 0.03), turn=turn,
        ),
    )[kind]()  # fmt: skip
    angle = generator.uniform(0, 2 * np.pi)
    slide = h * generator.uniform(*SLIDE) * (generator.uniform() >= PRESSED_ONLY)
    x, y = (slab * generator.uniform(-0.5, 0.5, 2)).tolist()
    depth = h * generator.uniform(0.03 if kind == 3 else DEPTH[0], DEPTH[1])
    return press(
        surface, shape, depth, at_mm=(x, y), slide_mm=(slide * np.cos(angle), slide * np.sin(angle)),
        friction=generator.uniform(*FRICTION), cells=CELLS,
    )  # fmt: skip


def at_rest_and_lightly(decoder: BareDecoder, scans: int, seed: int) -> list[Row]:
    """Errors with nothing on the sensor and under touches of 1 N, of the library's presses made as light as that."""
    generator, library = np.random.default_rng(seed), decoder.library
    rest = np.repeat(decoder.rest_resistances()[None], scans, axis=0)
    rows = generator.choice(np.flatnonzero((library.how[:, 1:] != 0).any(axis=1)), scans, replace=False)
    unit = library.unit[rows].astype(float)
    light = (1.0 / unit[:, :, 2].sum(axis=1))[:, None]
    ohms = decoder.sensing.ohms(decoder.sensing.reading(library.moved_mm[rows].astype(float) * light))
    found: list[Row] = []
    for name, exact, true_n in (
        ("at rest", rest, 0 * unit[..., :3]),
        ("under 1 N", ohms.reshape(rest.shape), (unit * light[..., None])[..., :3]),
    ):
        touches = decoder.touches(decoder.errors.read(exact, generator))
        error_n = np.stack([each.force_n for each in touches]) - true_n
        half_n = np.stack([each.half_widths_n[1] for each in touches])
        net = np.abs(error_n[..., 2].sum(axis=1))
        net_sd = np.linalg.norm([each.factors[2::5].sum(axis=0) for each in touches], axis=1)
        largest = np.abs(error_n[..., 2])
        found.append(
            {
                "scans": f"{scans} {name}",
                "fz a unit, largest / 99 % [N]": [float(largest.max()), float(np.quantile(largest, 0.99))],
                "net, largest [N]": float(net.max()),
                "net within 0.5 N or two deviations [%]": 100 * float((net <= np.maximum(0.5, 2 * net_sd)).mean()),
                "errors within the 95 % deviation [%]": 100 * float((np.abs(error_n) <= half_n).mean()),
            }
        )
    return found


def read_touch(path: Path) -> TouchDecoder:
    """Read a decoder of touch; `DesignError` if it is one of pads."""
    decoder = read_model(path)
    if not isinstance(decoder, TouchDecoder):
        raise DesignError(f"{path} is no decoder of touch: make one by 'tripillar train --touch'.")
    return decoder


def assessed(decoder: TouchDecoder, data: Samples) -> Row:
    """Errors of contacts, as a row."""
    with Bars() as bars:
        advance = bars.begin("touches", total=len(data))
        found = assess_touch(decoder, data, lambda done: advance(done, ""))
    each = [found.by_force[f"f{axis}"] for axis in AXES]
    return {
        "fx / fy / fz [N]": [one.errors.rmse_n for one in each],
        "0 N misses fz by [N]": float(np.sqrt((data.force_n[..., 2] ** 2).mean())),
        "net Fz, median [%]": found.net_fz_median_pct,
        "centre, median [mm]": found.centre_mm,
        "fz over 1 N [N]": found.loaded_rmse_n,
        "fz within 68 / 95 % [%]": [100 * part for part in each[2].coverage],
        "fz over 1 N within 68 / 95 % [%]": [100 * part for part in found.loaded_coverage],
    }


def touched(
    *,
    model: Annotated[Path, Parameter(help="File of `tripillar train --touch`.")],
    contacts: Annotated[int, Parameter(help="Contacts of unknown shapes.")] = 120,
    seed: Annotated[int, Parameter(help="Seed of the contacts and of the noise.")] = 77,
    newtons: Annotated[Newtons, Parameter(help="Least and largest net force [N].")] = None,
    known: Annotated[bool, Parameter(help="Press shapes of the library's kinds.")] = False,
    out: Folder = OUT,
) -> None:
    """Judge touch on shapes that its library has not, at rest and under touches of 1 N."""
    decoder = read_touch(model)
    data = unknown_samples(decoder.design, decoder.errors, contacts, seed, newtons, known=known)
    tables = {f"{contacts} contacts": [assessed(decoder, data)]}
    if newtons is None and isinstance(decoder, BareDecoder):
        tables["At rest and lightly"] = at_rest_and_lightly(decoder, 200, seed)
    report(tables, out / "touched.json")
