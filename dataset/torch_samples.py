"""Samples as torch takes them, from memory or from disk. Loads torch."""

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset, TensorDataset, get_worker_info

from dataset.leaves import LEAF, n_leaves
from dataset.samples import SampleError, Samples, require_samples
from dataset.stored import StoredSamples
from geometry.errors import require_type


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
        names = _variables(dtype, displacement, samples.displacement_mm is not None)
        super().__init__(*(torch.from_numpy(np.ascontiguousarray(getattr(samples, name))).to(dtype) for name in names))


class TorchBatches(IterableDataset[tuple[Tensor, ...]]):
    """Shuffled batches of samples on disk, for ``DataLoader(batches, batch_size=None, num_workers=2)``.

    An epoch goes through all samples once. Each worker reads leaves of its own (8192 samples), in an order drawn for
    the epoch; the samples of a leaf are shuffled and cut into batches, the last of which may be smaller. The batches
    of an epoch are the same for any number of workers.

    `dtype` and `displacement` are as of `TorchSamples`; without `shuffle` the samples keep their order. `seed` gives
    the order, and `set_epoch` another with the same seed.

    Raises
    ------
    ArgumentError, SampleError
        If the samples are not on disk, a setting is none of those, or displacements are wanted and there are none.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> from dataset import read_samples
    >>> samples = Samples(force_n=np.ones((5, 2, 3, 3)), resistance_ohm=np.full((5, 2, 3, 3), 1e4))
    >>> path = Path(mkdtemp()) / "few.zarr"
    >>> samples.write(path)
    >>> batches = TorchBatches(read_samples(path), batch_size=4)
    >>> [force_n.shape for resistance_ohm, force_n in batches]
    [torch.Size([4, 2, 3, 3]), torch.Size([1, 2, 3, 3])]
    """

    def __init__(
        self,
        samples: StoredSamples,
        batch_size: int = 1024,
        dtype: torch.dtype = torch.float32,
        displacement: bool = False,
        shuffle: bool = True,
        seed: int = 0,
    ) -> None:
        require_type("samples", samples, StoredSamples, "read a zarr directory; TorchSamples takes those in memory")
        if not isinstance(batch_size, int) or batch_size < 1:
            raise SampleError(f"batch_size={batch_size!r} must be a whole number above 0; 1024 is usual.")
        self.samples, self.batch_size, self.dtype = samples, batch_size, dtype
        self.names = _variables(dtype, displacement, "displacement_mm" in samples.leaf(0))
        self.shuffle, self.seed = shuffle, seed
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()  # workers that persist see it change

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of the next pass."""
        self._epoch.fill_(epoch)

    def __len__(self) -> int:
        """Batches of an epoch."""
        whole, rest = divmod(len(self.samples), LEAF)
        return whole * -(-LEAF // self.batch_size) - (-rest // self.batch_size)

    def __iter__(self) -> Iterator[tuple[Tensor, ...]]:
        worker, epoch = get_worker_info(), int(self._epoch)
        leaves = np.arange(n_leaves(len(self.samples)))
        if self.shuffle:
            leaves = np.random.default_rng([self.seed, epoch]).permutation(leaves)
        for number in leaves if worker is None else leaves[worker.id :: worker.num_workers]:
            leaf = self.samples.leaf(int(number))
            tensors = [torch.from_numpy(leaf[name]).to(self.dtype) for name in self.names]
            order = torch.arange(len(tensors[0]))
            if self.shuffle:
                order = torch.from_numpy(np.random.default_rng([self.seed, epoch, number]).permutation(len(order)))
            for some in order.split(self.batch_size):
                yield tuple(tensor[some] for tensor in tensors)


def _variables(dtype: torch.dtype, displacement: bool, holds_displacement: bool) -> list[str]:
    """Names of the variables that are handed to torch, in their order."""
    if dtype not in (torch.float32, torch.float64):
        raise SampleError(f"dtype={dtype} must be torch.float32 or torch.float64.")
    if displacement and not holds_displacement:
        raise SampleError("the samples hold no displacement_mm: take what simulate gives, or displacement=False.")
    return ["resistance_ohm", *(["displacement_mm"] if displacement else []), "force_n"]
