"""Samples in a zarr directory: leaves of `LEAF` samples, each a chunk of every variable with the hash of its numbers.

Leaves can be made in any order, by any process; whoever reads one checks its hash, so that no reader needs them all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dataset.variables import ARRAYS, COORDINATES, SOLVED
from dataset.zarr_folder import (
    Variable,
    chunk_name,
    encoded,
    replacing_folder,
    require_zarr_place,
    write_header,
)
from geometry.storage.files import digest, reported

LEAF = 8192  #: samples of a leaf: 3.5 MB of a variable of 6 × 6 units in float32
HASHES = "leaf_hashes"  #: attribute of a variable: a hash of each leaf's numbers
LEAF_SIZE = "leaf_samples"  #: attribute of a directory
KNOWN = ARRAYS | {name: (("sample",), notes) for name, notes in SOLVED.items()}


@dataclass(frozen=True, kw_only=True)
class Leaf:
    """One leaf as it is stored, by variable."""

    content: dict[str, bytes]  #: of its files
    hashes: dict[str, str]  #: of its numbers


def n_leaves(samples: int) -> int:
    """Leaves of so many samples."""
    return -(-samples // LEAF)


def packed(arrays: Mapping[str, np.ndarray], samples: int, dtype: str) -> Leaf:
    """A leaf of variables (up to `LEAF`, ...) of a dataset of so many samples."""
    typed = {name: np.ascontiguousarray(values, dtype=dtype) for name, values in arrays.items()}
    return Leaf(
        content={name: encoded(values, min(LEAF, samples)) for name, values in typed.items()},
        hashes={name: digest(values) for name, values in typed.items()},
    )


def write_leaf(folder: Path, number: int, leaf: Leaf) -> None:
    """Write the files of a leaf, each whole or not at all, by way of a file beside the folder."""
    temporary = folder.with_name("chunk.new")
    for name, content in leaf.content.items():
        path = folder / chunk_name(name, number, len(KNOWN[name][0]))
        with reported(folder, temporary):
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(content)
            temporary.replace(path)


def write_leaves_header(
    folder: Path,
    shapes: Mapping[str, tuple[int, ...]],
    hashes: Mapping[str, Sequence[str]],
    attributes: Mapping[str, Any],
    dtype: str,
) -> None:
    """Write the rest of a directory: variables of these shapes (samples, ...), their hashes, attributes."""
    variables = {
        name: Variable(
            dims=KNOWN[name][0],
            shape=shape,
            dtype=dtype,
            attributes={**KNOWN[name][1], HASHES: list(hashes[name])},
        )
        for name, shape in shapes.items()
    }
    dims = {dim for spec in variables.values() for dim in spec.dims}
    said = {
        name: value.tolist() if isinstance(value, np.generic | np.ndarray) else value
        for name, value in attributes.items()
    }
    said |= {LEAF_SIZE: LEAF, "content_hash": leaves_hash(hashes)}
    write_header(folder, variables, LEAF, {dim: labels for dim, labels in COORDINATES.items() if dim in dims}, said)


def leaves_hash(hashes: Mapping[str, Sequence[str]]) -> str:
    """Hash of forces and resistances by the hashes of their leaves."""
    return digest("leaves", LEAF, list(hashes["force_n"]), list(hashes["resistance_ohm"]))


def write_leaves(path: Path, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any], dtype: str) -> None:
    """Write variables (samples, ...) as a zarr directory, whole or not at all; errors as of `Samples.write`."""
    require_zarr_place(path, "resistance_ohm")
    samples = len(arrays["force_n"])
    hashes: dict[str, list[str]] = {name: [] for name in arrays}
    with replacing_folder(path) as folder:
        for number in range(n_leaves(samples)):
            of_leaf = slice(number * LEAF, (number + 1) * LEAF)
            leaf = packed({name: values[of_leaf] for name, values in arrays.items()}, samples, dtype)
            write_leaf(folder, number, leaf)
            for name, of_numbers in leaf.hashes.items():
                hashes[name].append(of_numbers)
        shapes = {name: np.shape(values) for name, values in arrays.items()}
        write_leaves_header(folder, shapes, hashes, attributes, dtype)
