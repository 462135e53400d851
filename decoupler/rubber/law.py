"""A rubber as a series showed it: the numbers of its memory and of its force, and how well they are known."""

from dataclasses import MISSING, dataclass, field

import numpy as np

from common.quantity import Sound, positive, quantity
from dataset.memory import broken_contacts, log_rise, relaxed_forces
from geometry.design import LOG_RISES, RATES, Memory, Prony
from geometry.layout import FloatArray

#: numbers of the memory in the order of a covariance; rates and times by their logarithms
NAMES = ("g1", "g2", "a1", "a2", "b_lengthen", "b_shorten", "tau1_s", "tau2_s")
MODELS = ("linear", "neo-hookean", "mooney-rivlin", "yeoh")  #: laws whose force `settled_stress` gives
SIZES, STRAINS = (0.0, 1e12), (-0.95, 1e6)  #: that deviations and strains may have
LINEAR = 4  #: so many are no logarithms


def memory_of(numbers: FloatArray) -> Memory:
    """The memory of numbers (8,) in the order of `NAMES`; what no rubber has is cut off."""
    g1, g2, a1, a2 = np.clip(numbers[:LINEAR], *LOG_RISES)
    b_lengthen, b_shorten, *tau_s = np.exp(np.clip(numbers[LINEAR:], -18, 18))
    b_lengthen, b_shorten = np.clip([b_lengthen, b_shorten], *RATES)
    return Memory(a=(a1, a2), b_lengthen=b_lengthen, b_shorten=b_shorten, g1=g1, g2=g2, tau_s=tuple(tau_s))


def numbers_of(memory: Memory) -> FloatArray:
    """The numbers (8,) of a memory that has one."""
    rates = np.maximum([memory.b_lengthen, memory.b_shorten], 1e-6)
    return np.r_[memory.g1, memory.g2, memory.a, np.log(rates), np.log(memory.tau_s)]


def log_ratio(strain: FloatArray, seconds: FloatArray | float, memory: Memory) -> FloatArray:
    """ln R/R₀ of strains (time, ...) from rest on: 2 ln(1 + ε) of the shape, and what the rubber remembers."""
    return 2 * np.log1p(strain) + log_rise(strain, broken_contacts(strain, seconds, memory), memory)


def settled_stress(strain: FloatArray, stiffening: float = 0.0, second: float = 0.0) -> FloatArray:
    """Engineering stress over μ of a strip that strains (...) stretch, settled and of constant volume.

    (λ − λ⁻²) (1 − s + s/λ + 2 k (I₁ − 3)) with I₁ = λ² + 2/λ, k = c₂/c₁ of Yeoh's law, and s, the share of the second
    invariant, of Mooney's and Rivlin's; both 0: the neo-Hookean law.
    """
    stretch = 1.0 + strain
    first = stretch**2 + 2 / stretch - 3.0
    return (stretch - stretch**-2) * (1.0 - second + second / stretch + 2 * stiffening * first)


@dataclass(frozen=True, kw_only=True, eq=False)
class Elastic(Sound):
    """The force of a strip: a law of its rubber, how stiff it is, and how it relaxes."""

    model: str = quantity(MISSING, "law of the rubber", of=MODELS)
    stiffness_n: float = positive(MISSING, "shear modulus μ times section [N]")
    stiffening: float = quantity(0.0, "c₂/c₁ of Yeoh's law")
    second: float = quantity(0.0, "share of the second invariant, of Mooney's and Rivlin's law")
    prony: Prony = field(default_factory=Prony)

    def force(self, strain: FloatArray, seconds: FloatArray | float) -> FloatArray:
        """Force (time, ...) [N] under strains (time, ...) from rest on; it pulls where the strip is longer."""
        settled_n = self.stiffness_n * settled_stress(strain, self.stiffening, self.second)
        return relaxed_forces(settled_n, seconds, self.prony)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rubber(Sound):
    """A rubber as a series showed it; what has a meaning here stands in the table [rubber] of its file."""

    memory: Memory
    covariance: FloatArray  #: (8, 8) of the memory's numbers, in the order of `NAMES`
    noise: float = quantity(MISSING, "standard deviation of ln R about the law", within=SIZES)
    correlation_s: float = quantity(MISSING, "time over which these errors are alike [s]", within=SIZES)
    force_noise_n: float = quantity(MISSING, "standard deviation of the force about its law [N]", within=SIZES)
    min_strain: float = quantity(MISSING, "least and largest strain of the series", within=STRAINS)
    max_strain: float = quantity(MISSING, "beyond, nothing was measured", within=STRAINS)
    rest_ohm: float | None = positive(None, "resistance of the specimen at rest [Ω]; none of a mechanical test")
    wires: int = quantity(4, "that it was read by, 2 or 4: with 2 contacts are in it", within=(2, 4))
    section_mm2: float | None = positive(None, "of the specimen [mm²]")
    electrodes_mm: float | None = positive(None, "distance of the electrodes that read [mm]")
    contact_ohm: float | None = quantity(None, "of a contact of the specimen, median of the series [Ω]", within=SIZES)
    contact_spread: float | None = quantity(None, "standard deviation of its changes, relative", within=SIZES)
    elastic: Elastic = quantity(MISSING, "law of the force, which relaxes as [pillar_material.prony] says")
    unknown: tuple[tuple[str, str], ...] = ()  #: what the series does not tell, and which test would

    @property
    def numbers(self) -> FloatArray:
        """Its memory's, (8,) in the order of `NAMES`."""
        return numbers_of(self.memory)

    @property
    def young_mpa(self) -> float | None:
        """Young's modulus, settled; None where the section is not known."""
        return None if self.section_mm2 is None else 3 * self.elastic.stiffness_n / self.section_mm2

    @property
    def resistivity_ohm_mm(self) -> float | None:
        """Resistivity at rest; None where sizes are not known or contacts are in it."""
        if self.section_mm2 is None or self.electrodes_mm is None or self.rest_ohm is None or self.wires == 2:
            return None
        return self.rest_ohm * self.section_mm2 / self.electrodes_mm

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of each number of the memory; of rates and times by their logarithm's."""
        values = np.r_[self.numbers[:LINEAR], np.exp(self.numbers[LINEAR:])]
        deviations = np.sqrt(self.covariance.diagonal()) * np.r_[np.ones(LINEAR), values[LINEAR:]]
        return {name: (float(v), float(d)) for name, v, d in zip(NAMES, values, deviations, strict=True)}

    def memories(self, count: int, generator: np.random.Generator) -> list[Memory]:
        """So many memories that the series leaves possible."""
        values, directions = np.linalg.eigh(self.covariance)
        spread = directions * np.sqrt(np.maximum(values, 0.0))
        drawn = self.numbers + generator.standard_normal((count, len(NAMES))) @ spread.T
        return [memory_of(numbers) for numbers in drawn]
