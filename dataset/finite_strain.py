"""Samples at finite strain: stiff pads on rubber of its own law, solved in groups of a fixed size.

A group is drawn and solved as a whole, with random generators of its own. So a sample depends on the seed and its
number alone, not on how many are made with it, and groups can be made in any order, by any process, and kept.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from common.storage.files import digest
from common.threads import one_blas_thread
from dataset.loads import PAPERS
from dataset.measurement import Readout
from dataset.protocols import scaled_indenters
from dataset.resistance import largest_strains, pillar_lengths
from dataset.samples import Samples
from dataset.settings import DatasetSettings
from dataset.simulation import as_read, below_cap, labelled, origin
from fem.array.response import ArrayResponse
from fem.finite.samples import FiniteSamples, SampleSolver
from geometry.design import SensorDesign
from geometry.layout import FloatArray

METHOD = 10  #: raise when the same settings give other samples
GROUP = 8  #: samples drawn and solved together
MAX_DRAWS = 200  #: of one sample, before the protocol is held to be impossible under the cap
LOWERINGS, BORNE = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15), 0.75  #: of a design's own loads, until so many draws have answers
FAR = 1.1  #: of the cap: a draw strained beyond it is given up before it has settled
_STREAM = 17  #: parts these generators from those of linear samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Group:
    """`GROUP` samples of an array of k units, as they are kept until all are there."""

    traction_mpa: FloatArray  #: (GROUP, k, 3)
    displacement_mm: FloatArray  #: (GROUP, k, n_upper, 3)
    error_estimate: FloatArray  #: (GROUP,): relative, of the displacements, the linear response's error included
    iterations: NDArray[np.int64]  #: (GROUP,)
    redrawn: NDArray[np.int64]  #: (GROUP,): draws that passed the cap
    unsolved: NDArray[np.int64]  #: (GROUP,): draws that had no answer below the cap, drawn again as well
    resistance_ratio: FloatArray  #: (GROUP, k, n_pillars): resistances by the design's electrics over those of eq. 1
    ratio_error: FloatArray  #: (GROUP,): largest estimated error of these

    def as_plain(self) -> dict[str, Any]:
        """Lists and numbers that say every double exactly."""
        return {name: values.tolist() for name, values in vars(self).items()}

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> "Group":
        """From `as_plain`; `KeyError`, `TypeError` or `ValueError` if it is none."""
        return cls(**{name: np.array(plain[name]) for name in cls.__dataclass_fields__})


def group_cache_key(response: ArrayResponse, settings: DatasetSettings) -> str:
    """Hash of all that groups depend on: neither the number of samples nor how they are measured."""
    drawn = {name: getattr(settings, name) for name in ("protocol", "seed", "cap")}
    if settings.loads != PAPERS:
        drawn["loads"] = settings.loads
    if settings.table_mpa is not None:
        drawn["table"] = settings.table_mpa
    width = scaled_indenters(settings.protocol, response.design)
    return digest("finite samples", METHOD, GROUP, response.content_hash, response.design, drawn, *width)


def require_finite(design: SensorDesign) -> None:
    """Refuse designs whose samples at finite strain cannot be solved."""
    if design.pad.kind != "stiff":
        raise DesignError(
            "finite strain needs stiff pads: a uniform traction of fixed direction on soft rubber has no equilibrium "
            'from about half of its Young\'s modulus on. Write [pad] kind = "stiff" in the design.'
        )
    if design.electrics.is_conduction and not design.is_homogeneous:
        raise DesignError(
            "conduction at finite strain takes arrays of one rubber so far: give the pillars the matrix's, or write "
            "model = 'eq1' in [electrics]."
        )


class GroupSolver:
    """Draws and solves groups of one array, by its linear response; its two equilibria are found once.

    Of settings only protocol, seed, cap and loads count.
    """

    def __init__(self, response: ArrayResponse, settings: DatasetSettings) -> None:
        require_finite(response.design)
        self.design, self._linear_error = response.design, response.error_estimate
        k = self.design.n_units
        influence = response.influence_mm_per_n.reshape(k, -1, 3, k, 3)
        conducted = response.conducted
        per_n = None if conducted is None else conducted.relative_per_n.reshape(k, -1, k, 3)
        unit, far = self.design.unit, FAR * settings.cap
        self._solver = SampleSolver(self.design, influence, per_n, unwanted=lambda u: largest_strains(u, unit) > far)

    def answered(self, settings: DatasetSettings) -> float:
        """Share of a group's first draws that have answers below the cap."""
        generator = np.random.default_rng(_STREAM)
        found, over = self._solved(settings.on_pads.draw(generator, GROUP, self.design, settings.loads), settings.cap)
        return float((found.settled & ~over).mean())

    def _solved(self, traction_mpa: FloatArray, cap: float) -> tuple[FiniteSamples, NDArray[np.bool_]]:
        """Answers to tractions (n, k, 3) [MPa], and which are strained beyond the cap, (n,)."""
        with one_blas_thread():
            found = self._solver.displacements(traction_mpa * self.design.pad.size_mm**2)
        return found, largest_strains(found.displacement_mm, self.design.unit) > cap

    def group(self, settings: DatasetSettings, number: int) -> Group:
        """Samples number · GROUP and on; a `LoadError` if one was drawn `MAX_DRAWS` times in vain."""
        design, unsolved = self.design, np.zeros(GROUP, dtype=np.int64)
        names = [name for name in Group.__dataclass_fields__ if name not in ("redrawn", "unsolved")]

        def draw(waiting: np.ndarray, attempt: int) -> tuple[list[np.ndarray], np.ndarray]:
            traction = drawn_loads(settings, design, number * GROUP + waiting, attempt)
            found, over = self._solved(traction, settings.cap)
            unsolved[waiting] += ~over & ~found.settled
            estimate = np.hypot(found.error_estimate, self._linear_error)
            drawn = vars(found) | {"traction_mpa": traction, "error_estimate": estimate}
            return [drawn[name] for name in names], ~over & found.settled

        kept, redrawn = below_cap(draw, GROUP, MAX_DRAWS, settings, design)
        return Group(**dict(zip(names, kept, strict=True)), redrawn=redrawn - unsolved, unsolved=unsolved)


def drawn_loads(
    settings: DatasetSettings, design: SensorDesign, numbers: NDArray[np.int64], attempt: int
) -> FloatArray:
    """Tractions (n, k, 3) [MPa] of samples of these numbers (n,), each by a generator of its own."""
    seeds = [[settings.seed, int(number), attempt, _STREAM] for number in numbers]
    draw = settings.on_pads.draw
    return np.concatenate([draw(np.random.default_rng(seed), 1, design, settings.loads) for seed in seeds])


def borne(
    response: ArrayResponse, settings: DatasetSettings, answered: Callable[[DatasetSettings], float] | None = None
) -> tuple[DatasetSettings, float]:
    """Settings with a design's own loads, by the linear response, lowered to what finite strain bears; and by how much.

    Very soft rubber folds long before linear rubber strains its pillars by the cap. Loads that are given, or are the
    paper's, stay as they are. `answered` says which share of a few loads has answers; default: those of a solver.
    """
    suited = settings.suited(response)
    if suited == settings:
        return settings, 1.0
    answered = answered or GroupSolver(response, settings).answered
    name = "pressure_mpa" if suited.pressure_mpa else "shear_mpa"
    low, high = getattr(suited, name)
    for factor in LOWERINGS:
        own: dict[str, Any] = {name: (float(f"{factor * low:.3g}"), float(f"{factor * high:.3g}"))}
        lowered = replace(settings, **own)
        if answered(lowered) >= BORNE:
            break
    return (settings, 1.0) if factor == 1.0 else (lowered, factor)


def n_groups(samples: int) -> int:
    """Groups of so many samples."""
    return -(-samples // GROUP)


def samples_of(
    response: ArrayResponse, settings: DatasetSettings, groups: Sequence[Group], readout: Readout | None = None
) -> Samples:
    """Samples of all groups in order, measured as `settings` say; errors as of `Imperfections.apply`."""
    design, n = as_read(response, readout).design, settings.samples
    joined = {name: np.concatenate([getattr(group, name) for group in groups])[:n] for name in vars(groups[0])}
    displacement, effective, told = joined["displacement_mm"], None, {}
    if design.electrics.is_conduction:
        effective = pillar_lengths(displacement, design.unit) * np.sqrt(joined["resistance_ratio"])
        told = {"resistance_error_estimate": float(joined["ratio_error"].max())}
    return Samples(
        design=design,
        **labelled(joined["traction_mpa"], displacement, effective, design, settings, readout),
        strain_model=np.ones(n),
        error_estimate=joined["error_estimate"],
        iterations=joined["iterations"],
        **settings.of_samples(design),
        made_from={
            **origin(response, settings, int(joined["redrawn"].sum()), readout),
            "strain": "finite",
            **told,
            "unsolved": int(joined["unsolved"].sum()),
            "recipe": digest(group_cache_key(response, settings), settings, *([] if readout is None else [readout])),
        },
    )
