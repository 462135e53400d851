"""Samples as torch takes them. Loads torch."""

import numpy as np
import torch
from torch.utils.data import TensorDataset

from dataset.samples import SampleError, Samples, require_samples


class TorchSamples(TensorDataset):
    """Samples for `torch.utils.data.DataLoader`, one tuple of tensors each: resistances, then forces.

    `displacement` puts the electrodes' displacements between them. Samples that hold none, or a type that is neither
    torch.float32 nor torch.float64, are a `SampleError`.

    Examples
    --------
    >>> samples = Samples(force_n=np.ones((5, 2, 3, 3)), resistance_ohm=np.full((5, 2, 3, 3), 1e4))
    >>> loader = torch.utils.data.DataLoader(TorchSamples(samples), batch_size=4)
    >>> [(resistance_ohm.shape, force_n.dtype) for resistance_ohm, force_n in loader][0]
    (torch.Size([4, 2, 3, 3]), torch.float32)
    """

    def __init__(self, samples: Samples, dtype: torch.dtype = torch.float32, displacement: bool = False) -> None:
        require_samples("samples", samples)
        if dtype not in (torch.float32, torch.float64):
            raise SampleError(f"dtype={dtype} must be torch.float32 or torch.float64.")
        if displacement and samples.displacement_mm is None:
            raise SampleError("the samples hold no displacement_mm: take what simulate gives, or displacement=False.")
        names = ["resistance_ohm", *(["displacement_mm"] if displacement else []), "force_n"]
        super().__init__(*(torch.from_numpy(np.ascontiguousarray(getattr(samples, name))).to(dtype) for name in names))
