"""Contacts in the words of their users: force, place and size of each, with deviations."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from decoupler.touch.morph import Fit
from geometry.layout import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class TouchContact:
    """One contact on a sensor; deviations are standard deviations."""

    force_n: FloatArray  #: (3,): Fz positive in compression
    force_deviation_n: FloatArray  #: (3,)
    centre_mm: FloatArray  #: (2,): of its pressure, from the array's middle
    centre_deviation_mm: FloatArray  #: (2,)
    half_mm: FloatArray  #: (2,): half axes along x and y of the ellipse whose even pressure spreads as widely
    half_deviation_mm: FloatArray  #: (2,)

    def plain(self) -> dict[str, Any]:
        """The same as JSON has it, to 0.1 mN and 0.1 µm."""
        return {name: values.round(4).tolist() for name, values in vars(self).items()}


def contacts_of(fits: Sequence[Fit], weights: FloatArray) -> tuple[TouchContact, ...]:
    """Contacts by weighted fits: those of all that have as many as the best."""
    parts = len(fits[int(weights.argmax())].parts)
    chosen = [k for k, fit in enumerate(fits) if len(fit.parts) == parts]
    share = weights[chosen] / weights[chosen].sum()
    each = [fits[k].contacts() for k in chosen]
    values = np.stack([found for found, _ in each])  # (fits, parts, 7)
    mean = np.einsum("f,fpa->pa", share, values)
    own = np.stack([(slopes**2).sum(axis=-1) for _, slopes in each])
    deviation = np.sqrt(np.einsum("f,fpa->pa", share, own + (values - mean) ** 2))
    return tuple(
        TouchContact(
            force_n=found[:3], force_deviation_n=by[:3], centre_mm=found[3:5], centre_deviation_mm=by[3:5],
            half_mm=found[5:], half_deviation_mm=by[5:],
        )
        for found, by in zip(mean, deviation, strict=True)
    )  # fmt: skip
