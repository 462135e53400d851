"""Samples for torch's loaders."""

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from dataset import DatasetSettings, SampleError, TorchSamples, simulate
from geometry.errors import ArgumentError


@pytest.mark.parametrize("displacement", [False, True])
def test_a_loader_takes_samples(response, displacement):
    """In batches, in order, in the type asked for."""
    data = simulate(response, DatasetSettings(protocol="contact", samples=5))
    batches = list(DataLoader(TorchSamples(data, dtype=torch.float64, displacement=displacement), batch_size=2))
    assert [len(batch[0]) for batch in batches] == [2, 2, 1]
    names = ["resistance_ohm", *(["displacement_mm"] if displacement else []), "force_n"]
    for name, parts in zip(names, zip(*batches, strict=True), strict=True):
        assert np.array_equal(torch.cat(parts).numpy(), getattr(data, name))
    with pytest.raises(SampleError, match="hold no displacement_mm"):
        TorchSamples(data.labels(), displacement=True)
    with pytest.raises(SampleError, match=r"must be torch\.float32"):
        TorchSamples(data, dtype=torch.int32)
    with pytest.raises(ArgumentError, match="samples is of type list, expected Samples"):
        TorchSamples([1, 2])
