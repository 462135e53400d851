"""Rubber that remembers: resistances and forces that follow a strain's history.

States are exact for strains that change at a constant rate between their times, however long these are apart.
"""

from typing import Any

import numpy as np

from geometry.design import Memory, Prony
from geometry.layout import FloatArray


def decays(change: Any, seconds: Any, memory: Memory) -> list[tuple[Any, Any]]:
    """How both shares q of broken contacts follow strains (...) that change so much: q ← keep q + gain.

    Takes tensors of torch as well as arrays; `seconds` are above 0.
    """
    rate = change.clip(min=0.0) * memory.b_lengthen - change.clip(max=0.0) * memory.b_shorten
    found = []
    for tau_s in memory.tau_s:
        both = rate + seconds / tau_s
        keep = (-both).exp() if hasattr(both, "exp") else np.exp(-both)
        found.append((keep, rate / both * (1.0 - keep)))
    return found


def broken_contacts(strain: FloatArray, seconds: FloatArray | float, memory: Memory) -> FloatArray:
    """Shares q (2, time, ...) of contacts that are broken under strains (time, ...), none at first.

    `seconds` are those since the time before, one number or (time − 1,).
    """
    apart = np.broadcast_to(seconds, (len(strain) - 1,)).reshape(-1, *[1] * (strain.ndim - 1))
    return np.stack([_followed(*each) for each in decays(np.diff(strain, axis=0), apart, memory)])


def log_rise(strain: Any, broken: Any, memory: Memory) -> Any:
    """Rise of ln R beside a pillar's shape, under strains (...) with shares (2, ...) of contacts broken."""
    a1, a2 = memory.a
    return memory.g1 * strain + memory.g2 * strain**2 + a1 * broken[0] + a2 * broken[1]


def relaxed_forces(settled_n: FloatArray, seconds: FloatArray | float, prony: Prony) -> FloatArray:
    """Forces (time, ...) of a rubber that relaxes, from those that it settles to; settled at first."""
    apart = np.broadcast_to(seconds, (len(settled_n) - 1,)).reshape(-1, *[1] * (settled_n.ndim - 1))
    change, force_n = np.diff(settled_n, axis=0), settled_n
    for share, tau_s in zip(prony.share, prony.tau_s, strict=True):
        if share:
            keep = np.exp(-apart / tau_s)
            gain = share * tau_s / apart * (1.0 - keep) * change
            force_n = force_n + _followed(np.broadcast_to(keep, change.shape), gain)
    return force_n


def _followed(keep: FloatArray, gain: FloatArray) -> FloatArray:
    """States (time, ...) of x ← keep x + gain in steps (time − 1, ...), from 0; by doubling."""
    keep, gain, apart = keep.copy(), gain.copy(), 1
    while apart < len(gain):
        gain[apart:] += keep[apart:] * gain[:-apart]
        keep[apart:] = keep[apart:] * keep[:-apart]
        apart *= 2
    return np.concatenate([np.zeros((1, *gain.shape[1:])), gain])
