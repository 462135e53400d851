"""Samples at finite strain: stiff pads on neo-Hookean rubber, solved in groups of a fixed size.

A group is drawn and solved as a whole, with random generators of its own. So a sample depends on the seed and its
number alone, not on how many are made with it, and groups can be made in any order, by any process, and kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dataset.measurement import Readout
from dataset.protocols import pad_protocol
from dataset.resistance import pillar_lengths, pillar_strains
from dataset.samples import Samples
from dataset.simulation import (
    DatasetSettings,
    LoadError,
    forces,
    measured_resistances,
    origin,
)
from fem.array.response import ArrayResponse
from fem.finite.samples import SampleSolver
from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.layout import FloatArray
from geometry.storage.files import digest

METHOD = 8  #: raise when the same settings give other samples
GROUP = 8  #: samples drawn and solved together
MAX_DRAWS = 200  #: of one sample, before the protocol is held to be impossible under the cap
FAR = 1.1  #: of the cap: a draw strained beyond it is given up before it has settled
_STREAM = 17  #: parts these generators from those of linear samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Group:
    """`GROUP` samples of an array of k units, as they are kept until all are there."""

    traction_mpa: FloatArray  #: (GROUP, k, 3)
    displacement_mm: FloatArray  #: (GROUP, k, 2, 3)
    error_estimate: FloatArray  #: (GROUP,): relative, of the displacements, the linear response's error included
    iterations: NDArray[np.int64]  #: (GROUP,)
    redrawn: NDArray[np.int64]  #: (GROUP,): draws that passed the cap
    unsolved: NDArray[np.int64]  #: (GROUP,): draws that had no answer below the cap, drawn again as well
    resistance_ratio: FloatArray  #: (GROUP, k, 3): resistances by the design's electrics over those of eq. 1
    ratio_error: FloatArray  #: (GROUP,): largest estimated error of these

    def as_plain(self) -> dict[str, Any]:
        """Lists and numbers that say every double exactly."""
        return {name: values.tolist() for name, values in vars(self).items()}

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> "Group":
        """From `as_plain`; `KeyError`, `TypeError` or `ValueError` if it is none. Older ones know eq. 1 alone."""
        k = np.reshape(plain["traction_mpa"], (GROUP, -1, 3)).shape[1]
        eq1 = {"resistance_ratio": np.ones((GROUP, k, 3)), "ratio_error": np.zeros(GROUP)}
        return cls(**{name: np.array((eq1 | plain)[name]) for name in cls.__dataclass_fields__})


def group_cache_key(response: ArrayResponse, settings: DatasetSettings) -> str:
    """Hash of all that groups depend on: neither the number of samples nor how they are measured."""
    drawn = {name: getattr(settings, name) for name in ("protocol", "seed", "cap")}
    return digest("finite samples", METHOD, GROUP, response.content_hash, response.design, drawn)


def require_finite(design: SensorDesign) -> None:
    """Refuse designs whose samples at finite strain cannot be solved."""
    if design.pad.kind != "stiff":
        raise DesignError(
            "finite strain needs stiff pads: a uniform traction of fixed direction on soft rubber has no equilibrium "
            'from about half of its Young\'s modulus on. Write [pad] kind = "stiff" in the design.'
        )
    if not design.is_homogeneous:
        raise DesignError("finite strain takes arrays of one rubber so far: give the pillars the matrix's.")


class GroupSolver:
    """Draws and solves groups of one array; its two equilibria are found once.

    Parameters
    ----------
    response : ArrayResponse
        Linear response of the same array, of stiff pads.
    settings : DatasetSettings
        Only their protocol and their cap count.
    """

    def __init__(self, response: ArrayResponse, settings: DatasetSettings) -> None:
        require_finite(response.design)
        self.design, self.cap, self._linear_error = response.design, settings.cap, response.error_estimate
        k = self.design.n_units
        influence = response.influence_mm_per_n.reshape(k, 2, 3, k, 3)
        conducted = response.conducted
        per_n = None if conducted is None else conducted.relative_per_n.reshape(k, -1, k, 3)
        self._solver = SampleSolver(self.design, influence, per_n, unwanted=self._is_far)

    def _strain(self, displacement_mm: FloatArray) -> FloatArray:
        lengths = pillar_lengths(displacement_mm, self.design.unit)
        return pillar_strains(displacement_mm, lengths, self.design.unit).max(axis=(1, 2))

    def _is_far(self, displacement_mm: FloatArray) -> NDArray[np.bool_]:
        return self._strain(displacement_mm) > FAR * self.cap

    def group(self, settings: DatasetSettings, number: int) -> Group:
        """Samples number · GROUP and on; of `settings` only protocol, seed and cap count.

        Raises
        ------
        LoadError
            If a sample was drawn `MAX_DRAWS` times in vain.
        """
        k, protocol = self.design.n_units, pad_protocol(settings.protocol)
        traction, displacement = np.empty((GROUP, k, 3)), np.empty((GROUP, k, 2, 3))
        estimate = np.empty(GROUP)
        ratio, ratio_error = np.ones((GROUP, k, 3)), np.zeros(GROUP)
        iterations, redrawn, unsolved = np.zeros((3, GROUP), dtype=np.int64)
        waiting = np.arange(GROUP)
        for attempt in range(MAX_DRAWS):
            for sample in waiting:
                generator = np.random.default_rng([settings.seed, number * GROUP + int(sample), attempt, _STREAM])
                traction[sample] = protocol.draw(generator, 1, self.design)[0]
            with threadpool_limits(1, "blas"):
                found = self._solver.displacements(traction[waiting] * self.design.pad.size_mm**2)
            over = self._strain(found.displacement_mm) > settings.cap
            redrawn[waiting] += over
            unsolved[waiting] += ~over & ~found.settled
            displacement[waiting] = found.displacement_mm
            estimate[waiting] = np.hypot(found.error_estimate, self._linear_error)
            iterations[waiting] = found.iterations
            ratio[waiting], ratio_error[waiting] = found.resistance_ratio, found.ratio_error
            waiting = waiting[over | ~found.settled]
            if not len(waiting):
                break
        else:
            raise LoadError(
                f"protocol '{settings.protocol}' strained some pillar beyond cap={settings.cap:g} in {MAX_DRAWS} draws "
                "on end: raise the cap, or lower the forces by a smaller pad "
                f"(size_mm={self.design.pad.size_mm:g})."
            )
        return Group(
            traction_mpa=traction,
            displacement_mm=displacement,
            error_estimate=estimate,
            iterations=iterations,
            redrawn=redrawn,
            unsolved=unsolved,
            resistance_ratio=ratio,
            ratio_error=ratio_error,
        )


def n_groups(samples: int) -> int:
    """Groups of so many samples."""
    return -(-samples // GROUP)


def samples_of(
    response: ArrayResponse, settings: DatasetSettings, groups: Sequence[Group], readout: Readout | None = None
) -> Samples:
    """Samples of all groups in order, measured as `settings` say.

    Raises
    ------
    DesignError
        As `Imperfections.apply` does.
    """
    design, n = response.design, settings.samples
    rows, cols = design.array.rows, design.array.cols
    joined = {name: np.concatenate([getattr(group, name) for group in groups])[:n] for name in vars(groups[0])}
    traction = joined["traction_mpa"].reshape(n, rows, cols, 3)
    displacement = joined["displacement_mm"].reshape(n, rows, cols, 2, 3)
    length = pillar_lengths(displacement, design.unit)
    effective, told = length, {}
    if design.electrics.is_conduction:
        effective = length * np.sqrt(joined["resistance_ratio"].reshape(length.shape))
        told = {"resistance_error_estimate": float(joined["ratio_error"].max())}
    readings = [] if readout is None else [readout]
    return Samples(
        design=design,
        traction_mpa=traction,
        force_n=forces(traction, design),
        displacement_mm=displacement,
        length_mm=length,
        effective_length_mm=effective if design.electrics.is_conduction else None,
        resistance_ohm=measured_resistances(effective, design, settings, settings.seed, readout),
        strain_model=np.ones(n),
        error_estimate=joined["error_estimate"],
        iterations=joined["iterations"].astype(np.float64),
        noise=settings.noise,
        bits=settings.bits,
        dead=settings.dead_mask(rows, cols),
        made_from={
            **origin(response, settings, int(joined["redrawn"].sum()), readout),
            "strain": "finite",
            **told,
            "unsolved": int(joined["unsolved"].sum()),
            "recipe": digest(group_cache_key(response, settings), settings, *readings),
        },
    )
