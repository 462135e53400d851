"""`Pairs`: resistances of one sensor, measured under forces that are known, each as well as it is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from common.storage.files import digest
from dataset.imperfections import OPEN_OHM, PAPERS
from dataset.samples import SampleError, Samples
from dataset.variables import labels_of, senseless
from geometry.layout import AXES, FloatArray, Layout


@dataclass(frozen=True, kw_only=True, eq=False)
class Pairs:
    """n measured pairs of a sensor of rows × cols units: readings, and what is known of the forces under them.

    The forces of pair n are force_n[n] + Σₖ ξₖ unknown_n[n][k] with independent ξₖ of N(0, 1). A weight that is known
    to 1 % has one such direction, 1 % of its force. Of a plate whose sum alone is known, the shares of its pads are
    directions whose sum is 0, and the error of the sum is one more.

    Raises
    ------
    SampleError
        If shapes do not fit, a force is not finite or a reading is no resistance.

    Examples
    --------
    >>> pairs = Pairs(resistance_ohm=np.full((2, 1, 1, 3), 1e4), force_n=np.zeros((2, 1, 1, 3)))
    >>> len(pairs), pairs[:1].unknown_n[0].shape
    (2, (0, 1, 1, 3))
    """

    resistance_ohm: FloatArray  #: (n, rows, cols, n_pillars) [Ω]; NaN where not read
    force_n: FloatArray  #: (n, rows, cols, 3): expected forces along x, y, z [N]; Fz positive in compression
    unknown_n: tuple[FloatArray, ...] = ()  #: of each pair (k, rows, cols, 3) [N]; () if all forces are exact
    noise: float = 0.0  #: relative standard deviation of the resistances; 0 if not known
    bits: int | None = None  #: resolution of the converter; None if exact or not known
    names: tuple[str, ...] = ()  #: of the loads, for messages; () numbers them
    layout: Layout = PAPERS

    def __post_init__(self) -> None:
        shape = np.shape(self.force_n)
        if len(shape) != 4 or shape[3] != len(AXES) or not shape[0]:
            raise SampleError(f"force_n has shape {shape}, expected (n_pairs, rows, cols, 3) with at least one pair.")
        wanted = (*shape[:3], len(self.layout.pillars))
        if np.shape(self.resistance_ohm) != wanted:
            raise SampleError(
                f"resistance_ohm has shape {np.shape(self.resistance_ohm)}, expected {wanted}, as force_n with pillars "
                f"{', '.join(self.layout.pillar_names)}."
            )
        object.__setattr__(self, "names", self.names or tuple(f"pair {k}" for k in range(shape[0])))
        object.__setattr__(self, "unknown_n", self.unknown_n or (np.zeros((0, *shape[1:])),) * shape[0])
        if len(self.unknown_n) != shape[0] or len(self.names) != shape[0]:
            raise SampleError(f"{len(self.unknown_n)} unknown_n and {len(self.names)} names, expected {shape[0]} each.")
        labels = labels_of(self.layout)
        for k, (name, unknown_n) in enumerate(zip(self.names, self.unknown_n, strict=True)):
            if unknown_n.ndim != 4 or unknown_n.shape[1:] != shape[1:]:
                raise SampleError(f"unknown_n of '{name}' has shape {unknown_n.shape}, expected (k, *{shape[1:]}).")
            ohms = self.resistance_ohm[k : k + 1]
            read = np.where(np.isnan(ohms), 1.0, ohms)
            said = senseless("force_n", self.force_n[k : k + 1], labels) or senseless("resistance_ohm", read, labels)
            if said or not np.isfinite(unknown_n).all():
                raise SampleError(f"'{name}': {said or 'unknown_n is not finite'}: correct it or leave it out.")
        if np.isnan(self.resistance_ohm).all():
            raise SampleError("no pillar of any pair was read: measure resistances under these loads.")

    @classmethod
    def of(cls, samples: Samples) -> Self:
        """Pairs of labelled samples, whose forces are exact; dead and open pillars count as not read."""
        is_read = (samples.resistance_ohm < OPEN_OHM) & ~samples.is_dead
        ohms = np.where(is_read, samples.resistance_ohm, np.nan)
        force_n, layout = samples.force_n, samples.layout
        return cls(resistance_ohm=ohms, force_n=force_n, noise=samples.noise, bits=samples.bits, layout=layout)

    def labelled(self, max_unsure: float) -> Samples:
        """Those whose loads are known to within `max_unsure` of their size, the first if there are none, as samples.

        Pillars that are not read under all of these count as dead.
        """
        error2 = np.array([(each**2).sum() for each in self.unknown_n])
        known = error2 <= max_unsure**2 * (self.force_n**2).sum(axis=(1, 2, 3))
        some = self[np.flatnonzero(known) if known.any() else slice(1)]
        dead = np.asarray(np.isnan(some.resistance_ohm).any(axis=0))
        return Samples(
            force_n=some.force_n,
            resistance_ohm=np.where(dead, OPEN_OHM, some.resistance_ohm),
            noise=self.noise,
            bits=self.bits,
            dead=dead,
            layout=self.layout,
        )

    def __len__(self) -> int:
        return len(self.force_n)

    def __getitem__(self, which: slice | Sequence[int] | np.ndarray) -> "Pairs":
        """Some of the pairs, chosen as in an array."""
        numbers = np.arange(len(self))[which]
        return replace(
            self,
            resistance_ohm=self.resistance_ohm[numbers],
            force_n=self.force_n[numbers],
            unknown_n=tuple(self.unknown_n[k] for k in numbers),
            names=tuple(self.names[k] for k in numbers),
        )

    @cached_property
    def content_hash(self) -> str:
        """Hash of readings and of what is known of the forces."""
        return digest(self.force_n, self.resistance_ohm, *self.unknown_n, self.noise, self.bits)
