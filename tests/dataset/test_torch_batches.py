"""Batches for torch from disk: every sample once an epoch, in another order each, by any number of workers."""

import pickle

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from dataset import DatasetSettings, SampleError, Samples, TorchBatches, TorchSamples, read_samples, simulate
from dataset.leaves import LEAF
from geometry.errors import ArgumentError

N = 2 * LEAF + 100


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Of one unit, each force its sample's number."""
    force_n = np.arange(N, dtype=float)[:, None, None, None] * np.ones((1, 1, 3))
    path = tmp_path_factory.mktemp("batches") / "data.zarr"
    Samples(force_n=force_n, resistance_ohm=1e4 + force_n).write(path, dtype="float32")
    return read_samples(path)


def numbers(batches):
    return [force_n[:, 0, 0, 0].tolist() for _, force_n in batches]


def flat(lists):
    return [number for each in lists for number in each]


def test_an_epoch_holds_every_sample_once_with_its_own_resistance(stored):
    batches = TorchBatches(stored, batch_size=1000, seed=3)
    found = list(batches)
    assert len(found) == len(batches) == 2 * 9 + 1  # 8192 samples are 8 batches and a part
    assert all(r.dtype == f.dtype == torch.float32 for r, f in found)
    assert all(torch.equal(r, 1e4 + f) for r, f in found)
    assert sorted(flat(numbers(found))) == list(range(N))


def test_order_depends_on_seed_and_epoch_alone(stored):
    batches = TorchBatches(stored, seed=3)
    first = numbers(batches)
    assert numbers(batches) == first == numbers(pickle.loads(pickle.dumps(batches)))
    batches.set_epoch(1)
    assert numbers(batches) != first
    batches.set_epoch(0)
    assert numbers(batches) == first
    in_order = TorchBatches(stored, shuffle=False, batch_size=LEAF)
    assert flat(numbers(in_order)) == list(range(N))


def test_workers_share_the_leaves_and_see_the_epoch(stored):
    """Spawned ones, as on Windows; the batches of an epoch are those of one process."""
    batches = TorchBatches(stored, batch_size=4096)
    loader = DataLoader(
        batches, batch_size=None, num_workers=2, persistent_workers=True, multiprocessing_context="spawn"
    )
    for epoch in (0, 1):
        batches.set_epoch(epoch)
        assert sorted(numbers(loader)) == sorted(numbers(batches))
    del loader


@pytest.mark.parametrize("displacement", [False, True])
def test_a_loader_takes_samples_in_memory(response, displacement):
    """In batches, in order, in the type asked for, by two processes."""
    data = simulate(response, DatasetSettings(protocol="contact", samples=5))
    samples = TorchSamples(data, dtype=torch.float64, displacement=displacement)
    batches = list(DataLoader(samples, batch_size=2, num_workers=2))
    assert [len(batch[0]) for batch in batches] == [2, 2, 1]
    names = ["resistance_ohm", *(["displacement_mm"] if displacement else []), "force_n"]
    for name, parts in zip(names, zip(*batches, strict=True), strict=True):
        assert np.array_equal(torch.cat(parts).numpy(), getattr(data, name))
    assert TorchSamples(data)[1][0].dtype == torch.float32


def test_other_samples_and_settings_are_refused(stored):
    for kind, samples in ((TorchBatches, stored), (TorchSamples, stored[:5])):
        with pytest.raises(SampleError, match="hold no displacement_mm"):
            kind(samples, displacement=True)
        with pytest.raises(SampleError, match=r"must be torch\.float32"):
            kind(samples, dtype=torch.int32)
    with pytest.raises(ArgumentError, match="TorchSamples takes those in memory"):
        TorchBatches(stored[:5])
    with pytest.raises(ArgumentError, match="samples is of type list, expected Samples"):
        TorchSamples([1, 2])
    with pytest.raises(SampleError, match="batch_size=0 must be"):
        TorchBatches(stored, batch_size=0)
