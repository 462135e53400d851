"""How strongly weights are held to what is known before training: ridge regression chosen by its own errors."""

import torch
from torch import Tensor

RIDGES = torch.logspace(-10, 3, 27, dtype=torch.float64)  #: per sample, of inputs and targets scaled to [-1, 1]


def best_ridge(A: Tensor, targets: Tensor) -> float:
    """The λ of min ‖A W − T‖² + λ‖W‖² that promises the least error on new samples.

    Parameters
    ----------
    A : tensor, shape (n_samples, n_features)
    targets : tensor, shape (n_samples, n_out)

    Notes
    -----
    Generalised cross-validation (Golub, Heath & Wahba, Technometrics 21, 1979): the λ with the least
    ‖residual‖²/(n − effective number of weights)², from one eigendecomposition of AᵀA.
    """
    n = len(A)
    energies, directions = torch.linalg.eigh(A.T @ A)
    energies = energies.clamp_min(energies[-1].item() * 1e-15)
    fitted = ((directions.T @ (A.T @ targets)) ** 2).sum(dim=1) / energies  # explained by each direction
    total = (targets**2).sum()
    kept = energies / (energies + RIDGES[:, None] * n)  # (n_ridges, n_features)
    residual = (total - fitted.sum()).clamp_min(0.0) + ((1.0 - kept) ** 2 * fitted).sum(dim=1)
    score = residual / (n - kept.sum(dim=1)).clamp_min(0.5) ** 2
    return RIDGES[score.argmin()].item() * n
