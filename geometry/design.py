"""The sensor as numbers: frozen dataclasses for unit, array, pad and materials, refusing nonsense by name.

Lengths in mm, moduli in MPa, resistivity in Ω mm. A sweep is ``replace(design, ...)``.
"""

import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from html import escape
from typing import Any, ClassVar, Self

from common.errors import DesignError
from common.quantity import OPTIONAL, Sound, positive, quantity
from geometry.law import LAWS, RATIOS
from geometry.layout import SONG2018, Layout, crossing_pillars, footprint, min_span, pillar_widths

MAX_SLENDER = 60.0  #: length of a pillar over its width: a mesh of another rubber takes 8 s at 10, 90 s at 50


@dataclass(frozen=True, kw_only=True)
class Unit(Sound):
    """One sensing unit: pillars between electrodes, as its layout says; the paper's by default."""

    span_mm: float = positive(10.0, "distance between neighbouring electrodes of a unit, along x and along y")
    height_mm: float = positive(10.0, "height h of the pillars and of the slab; the top z = h is touched")
    pillar_width_mm: float = positive(2.0, "side of a pillar's square section, perpendicular to its axis")
    electrode_mm: float = positive(2.0, "side of the square electrodes")
    #: at the top of design files: by name, or as tables of its own
    layout: Layout = field(default=SONG2018, metadata=OPTIONAL)

    def __post_init__(self) -> None:
        super().__post_init__()
        places = {one.name: one.place for one in (*self.layout.upper, *self.layout.lower)}
        for one, width_mm in zip(self.layout.pillars, pillar_widths(self), strict=True):
            length_mm = math.hypot(math.dist(places[one.foot], places[one.top]) * self.span_mm / 2, self.height_mm)
            if width_mm * MAX_SLENDER < length_mm:
                size = f"{width_mm:g} mm wide and {length_mm:.4g} mm long: make it at least"
                least_mm = length_mm / MAX_SLENDER
                raise DesignError(f"pillar {one.name} is too thin to cast or mesh, {size} {least_mm:.3g} mm wide.")
        least_mm, met = min_span(self)
        if self.span_mm <= least_mm:
            raise DesignError(
                f"span_mm={self.span_mm:g} lets {met} of a unit merge: it must be above {least_mm:.4g}; widen the "
                "span, thin them or part their places."
            )
        if crossing := crossing_pillars(self):
            raise DesignError(
                f"pillars {' and '.join(crossing)} cross between their electrodes at span_mm={self.span_mm:g}: widen "
                "the span, thin them, or join other electrodes."
            )

    @property
    def body(self) -> "Unit":
        """The same without reference pillars, which stand beside the slab: what is cast and bends."""
        return self if self.layout.body is self.layout else replace(self, layout=self.layout.body)

    @property
    def footprint_mm(self) -> float:
        """Side of the smallest centred square that holds the unit's pillars and electrodes [mm]."""
        return footprint(self)


PAD_KINDS = ("soft", "stiff")
MIN_GAP = 0.02  #: between stiff pads, of the pitch
MAX_UNITS = 255  #: along x or y: what a board's frames can state


@dataclass(frozen=True, kw_only=True)
class Array(Sound):
    """A rows × cols grid of identical units on one slab."""

    rows: int = quantity(6, "units along y", within=(1, MAX_UNITS))
    cols: int = quantity(6, "units along x", within=(1, MAX_UNITS))
    pitch_mm: float = positive(15.0, "centre-to-centre distance of units; the paper says 10 to 20")


@dataclass(frozen=True, kw_only=True)
class Plate(Sound):
    """The plate of a stiff pad, for shapes that press on it; taken for rigid, as plastic of 1 mm would not be."""

    thickness_mm: float = quantity(2.0, "how far its face stands above the rubber", within=(0.2, 10.0))
    young_mpa: float = quantity(2000.0, "Young's modulus, by which its face gives; a plastic's", within=(10.0, 5e3))

    @property
    def face_mm_per_mpa(self) -> float:
        """How far its face gives under a pressure on it."""
        return self.thickness_mm / self.young_mpa


@dataclass(frozen=True, kw_only=True)
class Pad(Sound):
    """The square on a unit's top through which it is loaded."""

    size_mm: float = positive(12.0, "side of the contact pad; 12 covers both upper electrodes")
    offset_x_mm: float = quantity(0.0, "pad centre along x, from the unit's centre")
    offset_y_mm: float = quantity(0.0, "pad centre along y, from the unit's centre")
    kind: str = quantity(
        "soft", "soft: uniform traction; stiff: a rigid plate bonded to the rubber", True, of=PAD_KINDS
    )
    plate: Plate = quantity(Plate(), "the plate of a stiff pad, for shapes that press on it", True)


DIRECTIONS = ("unknown", "lengthening", "loading")
RATES = (0.0, 1e3)  #: of broken contacts, per strain
LOG_RISES = (-20.0, 20.0)  #: of ln R by memory, or per strain


@dataclass(frozen=True, kw_only=True)
class Memory(Sound):
    """What a conductive rubber's resistance remembers of its strain ε; nothing by default.

    ln R = ln R₀ + 2 ln(1 + ε) + g₁ ε + g₂ ε² + a₁ q₁ + a₂ q₂ with shares qᵢ of contacts that strain has broken and that
    heal: q̇ᵢ = b |ε̇| (1 − qᵢ) − qᵢ/τᵢ, b another one while a pillar lengthens than while it shortens. By `direction`
    loading, b_lengthen is of strains of either sign that grow in size; unknown is simulated as lengthening.
    """

    direction: str = quantity(
        "unknown", "which motion is b_lengthen's: lengthening, or loading; unknown: either", True, of=DIRECTIONS
    )
    a: tuple[float, float] = quantity((0.0, 0.0), "rise of ln R with all contacts broken", count=2, within=LOG_RISES)
    b_lengthen: float = quantity(0.0, "rate at which lengthening breaks contacts, per strain", within=RATES)
    b_shorten: float = quantity(0.0, "the same of shortening; 4 to 8 times as much in silicone", within=RATES)
    tau_s: tuple[float, float] = positive((5.0, 100.0), "times in which broken contacts heal [s]", count=2)
    g1: float = quantity(0.0, "rise of ln R with strain, beside the pillar's shape", within=LOG_RISES)
    g2: float = quantity(0.0, "the same with its square", within=LOG_RISES)


@dataclass(frozen=True, kw_only=True)
class Prony(Sound):
    """Relaxation of a rubber's force: F(t) = Y(t) + Σᵢ shareᵢ ∫ exp(−(t − s)/τᵢ) dY(s), Y settled; none by default."""

    share: tuple[float, float] = quantity((0.0, 0.0), "of the settled force, that relax", count=2, within=(0.0, 10.0))
    tau_s: tuple[float, float] = positive((1.0, 100.0), "times in which they do [s]", count=2)


SECOND_RATIO = 0.2  #: of mooney-rivlin, where none is given


@dataclass(frozen=True, kw_only=True)
class Material(Sound):
    """An isotropic rubber; the paper's by default.

    Its `model` is linear elasticity, or the neo-Hookean W = μ/2 (I₁ − 3) − μ ln J + λ/2 (J − 1)² of the same small
    strains.
    """

    # first, so that a design file never ends with a key that it may lack
    model: str = quantity("linear", "law: linear at small strain, all others at finite strain", True, of=LAWS)
    stiffening: float = quantity(0.0, "c₂/c₁ of yeoh, which stiffens as it is stretched", True, within=(0.0, 10.0))
    second_ratio: float = quantity(SECOND_RATIO, "c₂/(c₁ + c₂) of mooney-rivlin", True, within=(0.0, 1.0))
    young_mpa: float = positive(6.1, "Young's modulus E")
    poisson: float = quantity(0.49, "Poisson's ratio ν, from 0 to below 0.5")
    memory: Memory = quantity(Memory(), "what the resistance of the pillars' rubber remembers", True)
    prony: Prony = quantity(Prony(), "how its force relaxes, in histories and live", True)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, default in foreign_ratios(self.model).items():
            if (given := getattr(self, name)) != default:
                owner = next(model for model, law in LAWS.items() if name in law.ratios())
                raise DesignError(f"{name}={given:g} is of model = '{owner}', not {self.model}: leave it out.")
        if not 0 <= self.poisson < 0.5:
            raise DesignError(
                f"poisson={self.poisson:g} must be from 0 to below 0.5: rubber is nearly incompressible, "
                "write 0.49 (the paper's) or up to 0.4999."
            )
        least = self.second_ratio / (1 + 2 * self.second_ratio)
        if self.model == "mooney-rivlin" and self.poisson < least:
            raise DesignError(
                f"poisson={self.poisson:g} is below {least:.3g}, where mooney-rivlin of second_ratio="
                f"{self.second_ratio:g} stores energy below 0 in changes of volume: raise it, or take neo-hookean."
            )

    @property
    def settled(self) -> "Material":
        """The same without memory: what statics know of it."""
        return replace(self, memory=Memory(), prony=Prony())

    @property
    def lame_mpa(self) -> tuple[float, float]:
        """Lamé's λ and μ [MPa]: λ = Eν/((1+ν)(1−2ν)), μ = E/(2(1+ν))."""
        E, nu = self.young_mpa, self.poisson
        return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


def foreign_ratios(model: str) -> dict[str, Any]:
    """Ratios that other laws have of their own: a material of this model leaves them at these defaults."""
    foreign = {*RATIOS} - {*LAWS[model].ratios()}
    return {spec.name: spec.default for spec in fields(Material) if spec.name in foreign}


DRIFTS = (0.0, 0.5)  #: bounds of a drift's standard deviation: two of the largest leave a pillar no resistance
ELASTORESISTANCES = (-10.0, 10.0)  #: of either coefficient: beyond, strain leaves no resistivity above 0
EQUATIONS = ("eq1", "conduction")


@dataclass(frozen=True, kw_only=True)
class Drifts(Sound):
    """Standard deviations of drifts since the sensor was last tared, relative where no unit is stated."""

    #: lines of comment in design files
    NOTES: ClassVar[tuple[str, ...]] = (
        "The paper states no drift. Published of films of conductive polymer: below 5 % a decade of time under load,",
        "-15 % hot and +10 % hot and humid (Interlink, FSR 400 data sheet); 12 % in 48 h under load, 2.5 % of an ink",
        "of low drift (Sensitronics). After a warm-up 0.005, 0.005, 0.002 may do. Measure yours: unloaded, an hour.",
    )
    drift: float = quantity(
        0.0, "standard deviation of a drift that all readings share, relative: 0.005 is 0.5 %", True, within=DRIFTS
    )
    drift_tilt: float = quantity(
        0.0, "standard deviation at the rim of a drift that is linear along x and y", True, within=DRIFTS
    )
    drift_pillar: float = quantity(0.0, "standard deviation of a drift of each pillar alone", True, within=DRIFTS)
    drift_offset_ohm: float = quantity(
        0.0, "standard deviation of a drift that adds as much to all readings [Ω]", True, within=(0.0, 5e3)
    )

    def with_drifts_of(self, other: "Drifts | None") -> Self:
        """A copy with the larger of each drift that both state."""
        if other is None:
            return self
        return replace(
            self, **{spec.name: max(getattr(self, spec.name), getattr(other, spec.name)) for spec in fields(Drifts)}
        )


@dataclass(frozen=True, kw_only=True)
class Electrics(Drifts):
    """Model of the resistance of deformed pillars: the paper's eq. 1, or conduction.

    Elastoresistance is the relative change of resistivity per strain, m₁₁ along the current and m₁₂ across it (Mason
    and Thurston, J. Acoust. Soc. Am. 29 (1957) 1096).
    """

    model: str = quantity("eq1", "eq1: R = ρ l²/V; conduction: potentials in the deformed pillars", True, of=EQUATIONS)
    elastoresistance_along: float = quantity(
        0.0, "m₁₁ of the pillars' rubber, conduction only", True, within=ELASTORESISTANCES
    )
    elastoresistance_across: float = quantity(
        0.0, "m₁₂ of the pillars' rubber, conduction only", True, within=ELASTORESISTANCES
    )
    contact_ohm: float = quantity(
        0.0, "contact of each electrode; by two wires a pillar shows two of them [Ω]", True, within=(0.0, 1e6)
    )
    contact_spread: float = quantity(
        0.0, "relative standard deviation of contacts, from electrode to electrode", True, within=(0.0, 2.0)
    )
    temperature_coefficient: float = quantity(0.0, "relative change of resistivity [1/K]", True, within=(-0.1, 0.1))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.model == "eq1" and (self.elastoresistance_along or self.elastoresistance_across):
            raise DesignError(
                "eq. 1 has no elastoresistance: write model = 'conduction' in [electrics], or leave "
                "elastoresistance_along and elastoresistance_across at 0."
            )

    @property
    def is_conduction(self) -> bool:
        return self.model == "conduction"

    @property
    def contacts_ohm(self) -> float:
        """What both its contacts add to a pillar [Ω]."""
        return 2.0 * self.contact_ohm

    @property
    def by_four_wires(self) -> "Electrics":
        """The same read by wires of its own for the current and for the voltage: no contact shows."""
        return replace(self, contact_ohm=0.0, contact_spread=0.0)


@dataclass(frozen=True, kw_only=True)
class SensorDesign(Sound):
    """Everything that defines a sensor; the default is the paper's."""

    resistivity_ohm_mm: float = positive(4000.0, "resistivity ρ of the pillars' rubber; 4000 rests z at 10 kΩ")
    unit: Unit = quantity(Unit(), "one sensing unit: three pillars between four electrodes")
    array: Array = quantity(Array(), "the grid of units on one slab of cols·pitch × rows·pitch × height")
    pad: Pad = quantity(Pad(), "the square on each unit's top through which it is loaded")
    electrics: Electrics = quantity(Electrics(), "how resistance follows deformation", optional=True)
    pillar_material: Material = quantity(Material(), "the conductive rubber of the pillars (paper, table 1)")
    matrix_material: Material = quantity(Material(), "the insulating rubber around them; the paper gives no value")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pillar_material.model != self.matrix_material.model:
            models = f"pillar_material is {self.pillar_material.model}, matrix_material {self.matrix_material.model}"
            raise DesignError(f"{models}: give both the same model.")
        if self.matrix_material != self.matrix_material.settled:
            raise DesignError("memory and prony belong to pillar_material: the rubber around conducts nothing.")
        pitch_mm, footprint_mm = self.array.pitch_mm, self.unit.footprint_mm
        if pitch_mm < footprint_mm:
            raise DesignError(
                f"pitch_mm={pitch_mm:g} is smaller than the unit, whose pillars take {footprint_mm:.4g} mm: "
                f"raise pitch_mm to at least {footprint_mm:.4g} or shrink span_mm or pillar_width_mm."
            )
        end_mm = max(abs(self.pad.offset_x_mm), abs(self.pad.offset_y_mm)) + self.pad.size_mm / 2
        if end_mm > self.pad_room_mm:
            may = "stiff pads may not touch" if self.pad.kind == "stiff" else "pads may touch, not overlap"
            raise DesignError(
                f"pad size_mm={self.pad.size_mm:g} with its offset ends {end_mm:g} mm from the unit's centre, where "
                f"{self.pad_room_mm:g} mm are free: {may}; shrink the pad or raise pitch_mm."
            )

    def _repr_html_(self) -> str:
        """Its numbers and words with their meanings as a table, for notebooks."""
        parts = [(f"{part.name}.", getattr(self, part.name)) for part in fields(self) if is_dataclass(part.type)]
        rows = [
            f"<tr><td>{name}{spec.name}<td>{getattr(part, spec.name)}<td>{escape(spec.metadata['meaning'])}"
            for name, part in (("", self), *parts)
            for spec in fields(part)
            if spec.type in (int, float, str)
        ]
        return f"<table>{''.join(rows)}</table>"

    @property
    def n_units(self) -> int:
        return self.array.rows * self.array.cols

    @property
    def pad_room_mm(self) -> float:
        """Largest distance of a pad's edge from its unit's centre [mm]; soft pads may touch, stiff ones may not."""
        return self.array.pitch_mm / 2 * (1 - MIN_GAP if self.pad.kind == "stiff" else 1)

    @property
    def slab_mm(self) -> tuple[float, float, float]:
        """Extent of the matrix slab along x, y and z [mm]; x and y centred on the origin, z from 0."""
        pitch_mm = self.array.pitch_mm
        return self.array.cols * pitch_mm, self.array.rows * pitch_mm, self.unit.height_mm

    @property
    def is_homogeneous(self) -> bool:
        """True if pillars and matrix are of one rubber, so that pillars need no mesh of their own."""
        return self.pillar_material.settled == self.matrix_material

    @property
    def body(self) -> "SensorDesign":
        """The same without reference pillars, which stand beside the slab: what is cast and bends."""
        return self if self.unit.body is self.unit else replace(self, unit=self.unit.body)


def lone_unit(design: SensorDesign) -> SensorDesign:
    """The design with one unit, whose slab is the cell."""
    return replace(design, array=replace(design.array, rows=1, cols=1))


def bent(design: SensorDesign) -> SensorDesign:
    """What bends of a sensor at small strain: no references, resistivity or contacts of its own, linear rubber."""
    electrics = replace(design.electrics.by_four_wires, temperature_coefficient=0.0)
    settled = replace(design, pillar_material=design.pillar_material.settled)
    return replace(at_rest(settled), unit=design.unit.body, resistivity_ohm_mm=1.0, electrics=electrics)


def at_rest(design: SensorDesign) -> SensorDesign:
    """The same sensor with the tangent at rest of its rubbers, which is linear rubber of the same E and ν."""
    return with_model(design, "linear")


def with_model(design: SensorDesign, model: str) -> SensorDesign:
    """The same sensor, its rubbers of another model.

    >>> with_model(SensorDesign(), "neo-hookean").matrix_material.model
    'neo-hookean'
    """
    changes: dict[str, Any] = {"model": model, **foreign_ratios(model)}
    pillar, matrix = (replace(rubber, **changes) for rubber in (design.pillar_material, design.matrix_material))
    return replace(design, pillar_material=pillar, matrix_material=matrix)
