"""Data sets of any size: leaves made by workers, each kept as it comes, put in place as a zarr directory when all are.

Until then they are in a folder beside it, so that a killed run is taken up again and nothing is copied in the end.
"""

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from common.errors import NotWrittenError
from common.pool import open_pool
from common.storage.files import digest, reported
from common.storage.journal import Journal, hashes_of, intact
from dataset.leaves import Leaf, leaf_size, n_leaves, packed, put, write_header, write_leaf
from dataset.measurement import Readout
from dataset.samples import Samples
from dataset.settings import DatasetSettings
from dataset.simulation import dataset_cache_key, simulate_part
from dataset.stored import is_current, read_samples
from dataset.variables import LABELS
from decoupler.twin.twin_file import TwinFile
from decoupler.twin.twin_samples import simulate_twin
from fem.array.response import ArrayResponse
from tripillar.datasets.parts import made_parts
from tripillar.terminal.interrupts import last_words


@dataclass(frozen=True, kw_only=True, eq=False)
class LeafJob:
    """All that the leaves of one data set need."""

    response: ArrayResponse
    settings: DatasetSettings
    readout: Readout | None = None
    twin: TwinFile | None = None  #: samples are drawn from it
    only: tuple[str, ...] | None = None  #: variables beside forces and resistances; None keeps all
    dtype: str = "float64"  #: of the numbers in the files

    @property
    def cache_key(self) -> str:
        """Hash of all that leaves depend on: not the number of samples, of which the last leaf alone knows."""
        of_one = dataset_cache_key(self.response, replace(self.settings, samples=1), self.readout)
        more = [] if self.twin is None else [self.twin.decoder_hash]
        return digest("leaves", self.leaf_size, of_one, self.named, self.dtype, *more)

    @property
    def leaf_size(self) -> int:
        """Samples, or series, of a leaf."""
        return leaf_size(self.settings.moments)

    @property
    def numbers(self) -> range:
        """Numbers of all leaves."""
        return range(n_leaves(self.settings.samples, self.leaf_size))

    @property
    def named(self) -> list[str] | None:
        """`only`, in one order."""
        return None if self.only is None else sorted({*LABELS, *self.only})

    def size(self, number: int) -> int:
        """Number of samples of a leaf."""
        return min(self.leaf_size, self.settings.samples - number * self.leaf_size)

    def key(self, number: int) -> str:
        """Where a journal keeps a leaf: the last one of another number of samples is another one."""
        return f"{number:07d}-{self.size(number)}"

    def whole(self, progress: Callable[[int], None]) -> Samples:
        """All samples, in memory."""
        return self.part(range(self.settings.samples), progress, os.cpu_count() or 1)

    def part(self, numbers: range, progress: Callable[[int], None] = lambda samples: None, threads: int = 1) -> Samples:
        """Samples of these numbers, the first a multiple of `BLOCK`."""
        if self.twin is None:
            return simulate_part(self.response, self.settings, numbers, progress, self.readout, self.only, threads)
        samples = simulate_twin(self.twin, self.response, self.settings, progress, self.readout, numbers)
        return samples if self.only is None else samples.only(*self.only)


def leaf(number: int, job: LeafJob) -> tuple[Leaf, int]:
    """Make a leaf, in a worker; it, and how often its samples were redrawn."""
    # products of a linear twin's matrices round by the number of rows: whole leaves are the same whatever is wanted
    is_whole = job.twin is not None and not job.twin.is_at_strain
    first, size = number * job.leaf_size, job.leaf_size if is_whole else job.size(number)
    samples = job.part(range(first, first + size))
    arrays = {name: values[: job.size(number)] for name, values in samples.arrays().items()}
    chunk = min(job.leaf_size, job.settings.samples)
    return packed(arrays, number, chunk, job.dtype), samples.made_from["redrawn"]


def make_directory(
    job: LeafJob,
    out: Path,
    count: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda samples: None,
) -> dict[str, Any]:
    """Make a data set of any size; a run that was stopped or killed is taken up again.

    Gives its ``recipe``, the draws that were ``redrawn``, and how many samples of earlier runs were ``kept``.

    Parameters
    ----------
    job : LeafJob
    out : Path
        Zarr directory. It appears when all samples are there; what is there is replaced then.
    count, scheduler
        As of `open_pool`. With one process, or one leaf, this one makes them itself.
    progress : function
        Called with the number of samples that were added, those of earlier runs first.

    Raises
    ------
    LoadError
        If samples cannot be made.
    DesignError
        If another process makes it, workers were lost with some leaves, or the scheduler is lost. What was made is
        kept.
    NotWrittenError
        If the disk is full or the place may not be written to. What was made is kept.
    """
    first = job.part(range(1))  # refuses what no worker could make
    recipe = digest("zarr", first.made_from["recipe"], job.named, job.dtype)
    folder = unfinished(out, job)
    tree = folder / "data.zarr"
    if is_current(out, recipe):
        progress(job.settings.samples)
        shutil.rmtree(folder, ignore_errors=True)
        return {"recipe": recipe, "redrawn": int(read_samples(out).made_from["redrawn"]), "kept": job.settings.samples}
    journal, numbers = Journal(folder), job.numbers
    go_on = f"the samples in {folder} are kept: give the same command again to go on."
    with reported(out, folder / "any"), journal.alone(), last_words(f"stopped; {go_on}"):
        try:
            found = journal.kept(map(job.key, numbers), partial(intact, tree))
            missing = [number for number in numbers if job.key(number) not in found]
            kept = job.settings.samples - sum(map(job.size, missing))
            progress(kept)
            with open_pool(count, scheduler, len(missing)) as pool:
                for number, (made, redrawn) in made_parts(pool, leaf, missing, "parts of the data set", job):
                    write_leaf(tree, made)
                    record = {"redrawn": redrawn, "files": hashes_of(made.content), "hashes": made.hashes}
                    found[job.key(number)] = record
                    journal.keep(job.key(number), record)
                    progress(job.size(number))
            redrawn = sum(record["redrawn"] for record in found.values())
            records = [found[job.key(number)] for number in numbers]
            _finish(tree, job, records, first.attributes() | {"redrawn": redrawn, "recipe": recipe})
            put(tree, Path(os.path.realpath(out)))
        except Exception as error:
            if not journal.keys():
                shutil.rmtree(folder, ignore_errors=True)
            elif isinstance(error, NotWrittenError):
                raise NotWrittenError(f"{error} {go_on[0].upper()}{go_on[1:]}") from None
            raise
    shutil.rmtree(folder, ignore_errors=True)
    return {"recipe": recipe, "redrawn": redrawn, "kept": kept}


def unfinished(out: Path, job: LeafJob) -> Path:
    """Folder of a data set's leaves until all are there; that of other settings is another one."""
    target = Path(os.path.realpath(out))
    return target.with_name(f"{target.name}.unfinished-{job.cache_key[:8]}")


def _finish(tree: Path, job: LeafJob, records: Sequence[dict[str, Any]], attributes: Mapping[str, Any]) -> None:
    """Add the headers, last of all, where nothing but the leaves is left: no longer data set's, no half a header."""
    wanted = {tree / name for record in records for name in record["files"]}
    for path in list(tree.rglob("*")):
        if path.is_file() and path not in wanted:
            path.unlink()
    hashes = {name: [record["hashes"][name] for record in records] for name in records[0]["hashes"]}
    design = job.response.design
    shape = job.settings.samples, design.array.rows, design.array.cols
    write_header(tree, shape, hashes, attributes, job.dtype, design.unit.layout, job.settings.time_s)
