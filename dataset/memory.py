"""Rubber that remembers: resistances and forces that follow a strain's history.

States are exact for strains that change at a constant rate between their times, however long these are apart.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.design import Memory, Prony
from geometry.layout import FloatArray

BLOCK = 256  #: steps that are followed together, or more of fewer than `NARROW` states: they fit the processor's cache
NARROW = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class PillarMemory:
    """A `Memory` whose numbers are arrays, one for each pillar, of NumPy or torch."""

    a: tuple[Any, Any]
    b_lengthen: Any
    b_shorten: Any
    tau_s: tuple[Any, Any]
    g1: float
    g2: float
    direction: str = "unknown"

    @classmethod
    def spread(cls, memory: Memory, factors: Any) -> "PillarMemory":
        """Of pillars whose a₁, a₂, both b, τ₁ and τ₂ differ from a rubber's by `factors` (6, ...)."""
        a1, a2, lengthen, shorten, tau1, tau2 = factors
        own = {
            "a": (a1 * memory.a[0], a2 * memory.a[1]),
            "b_lengthen": lengthen * memory.b_lengthen,
            "b_shorten": shorten * memory.b_shorten,
            "tau_s": (tau1 * memory.tau_s[0], tau2 * memory.tau_s[1]),
        }
        return cls(**vars(memory) | own)


AnyMemory = Memory | PillarMemory


def lengthening(strain: Any, memory: AnyMemory) -> Any:
    """What grows where `b_lengthen` is of strains (...), of NumPy or torch: their size, of a rubber that loads so.

    No step between two of them may lead from one sign to the other if states are to be exact.
    """
    return abs(strain) if memory.direction == "loading" else strain


def decays(change: Any, seconds: Any, memory: AnyMemory) -> list[tuple[Any, Any]]:
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


def broken_contacts(
    strain: FloatArray, seconds: FloatArray | float, memory: AnyMemory, is_cycle: bool = False
) -> FloatArray:
    """Shares q (2, time, ...) of contacts that are broken under strains (time, ...), none at first.

    `seconds` are those since the time before, one number or (time − 1,). Of a cycle that ends where it begins, and that
    was gone through for ever, states begin as they end.
    """
    apart = np.broadcast_to(seconds, (len(strain) - 1,)).reshape(-1, *[1] * (strain.ndim - 1))
    return np.stack(
        [_followed(*each, is_cycle) for each in decays(np.diff(lengthening(strain, memory), axis=0), apart, memory)]
    )


def log_rise(strain: Any, broken: Any, memory: AnyMemory) -> Any:
    """Rise of ln R beside a pillar's shape, under strains (...) with shares (2, ...) of contacts broken."""
    a1, a2 = memory.a
    return memory.g1 * strain + memory.g2 * strain**2 + a1 * broken[0] + a2 * broken[1]


def remembered(
    strain: FloatArray, seconds: FloatArray | float, memory: AnyMemory, is_cycle: bool = False
) -> FloatArray | float:
    """Rise of ln R over a history of strains (time, ...), beside the pillar's shape; 0 of a rubber without memory.

    `seconds` and `is_cycle` as of `broken_contacts`.
    """
    if memory == Memory():
        return 0.0
    return np.asarray(log_rise(strain, broken_contacts(strain, seconds, memory, is_cycle), memory))


def relaxed_forces(
    settled_n: FloatArray, seconds: FloatArray | float, prony: Prony, is_cycle: bool = False
) -> FloatArray:
    """Forces (time, ...) of a rubber that relaxes, from those that it settles to; settled at first.

    `seconds` and `is_cycle` as of `broken_contacts`.
    """
    apart = np.broadcast_to(seconds, (len(settled_n) - 1,)).reshape(-1, *[1] * (settled_n.ndim - 1))
    change, force_n = np.diff(settled_n, axis=0), settled_n
    for share, tau_s in zip(prony.share, prony.tau_s, strict=True):
        if share:
            keep = np.exp(-apart / tau_s)
            gain = share * tau_s / apart * (1.0 - keep) * change
            force_n = force_n + _followed(np.broadcast_to(keep, change.shape), gain, is_cycle)
    return force_n


def _followed(keep: FloatArray, gain: FloatArray, is_cycle: bool = False) -> FloatArray:
    """States (time, ...) of x ← keep x + gain in steps (time − 1, ...), from 0 or round a cycle; by doubling."""
    states = np.zeros((len(gain) + 1, *gain.shape[1:]))
    if is_cycle:
        states[0] = _followed(keep, gain)[-1] / (1.0 - keep.prod(axis=0))
    block = BLOCK * max(1, NARROW // max(1, gain[:1].size))
    for start in range(0, len(gain), block):
        state, left, apart = gain[start : start + block].copy(), keep[start : start + block].copy(), 1
        while apart < len(state):
            state[apart:] += left[apart:] * state[:-apart]
            left[apart:] = left[apart:] * left[:-apart]
            apart *= 2
        states[start + 1 : start + 1 + len(state)] = state + left * states[start]
    return states
