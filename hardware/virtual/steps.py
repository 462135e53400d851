"""Steps of a reading that torch differentiates: a converter's counts, and what pads share of a force."""

import torch
from torch import Tensor


def rounded(readings: Tensor, bits: int) -> Tensor:
    """Shares of full scale as a converter's counts hold them, the nearest inside its range; the derivative stays."""
    full = 2.0**bits - 1.0
    counts = (full * readings).clamp(1.0, full - 1.0)
    return (counts + (counts.round() - counts).detach()) / full


def shares(place_mm: Tensor, centres_mm: Tensor) -> Tensor:
    """Shares of the pads at these centres (n,) in forces at places (e, k), (e, k, n); they sum to 1."""
    if len(centres_mm) == 1:
        return torch.ones_like(place_mm)[..., None]
    within = torch.minimum(torch.maximum(place_mm, centres_mm[0]), centres_mm[-1])
    return (1.0 - (within[..., None] - centres_mm).abs() / (centres_mm[1] - centres_mm[0])).clamp(min=0.0)
