"""The cache: answers that are kept for the next time, each in a file named by the hash of all that it depends on."""

import json
import logging
import zlib
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from io import BytesIO
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from common.errors import FileFormatError
from common.storage.files import cache_folder, write_bytes
from common.storage.seal import LAST_LINE, require_intact, say_made_anew, sealed

Kept = TypeVar("Kept")


def kept(
    kind: str,
    cache_key: str,
    make: Callable[[], Kept],
    read: Callable[[Path], Kept],
    write: Callable[[Kept, Path], None],
    needed: bool = False,
) -> tuple[Kept, Path, bool]:
    """An answer from the cache if it is there, or made and kept there.

    `kind` is its file's kind and ending: "mesh.vtu" is in mesh-0123456789abcdef.vtu, by the hash of all that it depends
    on; an answer that states another `cache_key` is not taken. `read` raises a ValueError, as `FileFormatError` is, a
    KeyError or a TypeError for what is missing, damaged or older. Where a file is `needed`, an error of writing it is
    raised, else one line says so. Returns the answer, its file, and whether it was there already.
    """
    path = cache_folder() / f"{Path(kind).stem}-{cache_key}{Path(kind).suffix}"
    try:
        found = read(path)
        if getattr(found, "cache_key", cache_key) == cache_key:
            return found, path, True
    except (ValueError, KeyError, TypeError):
        say_made_anew(path)
    made = make()
    try:
        if path.is_dir():
            raise FileFormatError(f"{path}: a folder in the place of a file of the cache: delete it.")
        write(made, path)
    except (OSError, FileFormatError) as error:
        if needed:
            raise
        logging.getLogger("tripillar").warning("not kept for the next time: %s", error)
    return made, path, False


def kept_value(
    hint: type[Kept], kind: str, cache_key: str, make: Callable[[], Kept], **known: Any
) -> tuple[Kept, Path, bool]:
    """`kept` of a dataclass, or whatever `write_value` takes; fields that are `known` are not in the file."""
    return kept(
        kind,
        cache_key,
        make,
        lambda path: read_value(hint, path, **known),
        lambda made, path: write_value(made, path, *known),
    )


def write_value(value: Any, path: Path, *left_out: str) -> None:
    """Write arrays, numbers, texts and None, and dataclasses, tuples and dicts of them, without some of its fields."""
    arrays: list[NDArray[Any]] = []

    def plain(value: Any, left_out: tuple[str, ...] = ()) -> Any:
        if isinstance(value, np.ndarray):
            arrays.append(value)
            return len(arrays) - 1
        if is_dataclass(value):
            return {spec.name: plain(getattr(value, spec.name)) for spec in fields(value) if spec.name not in left_out}
        if isinstance(value, dict):
            return [[plain(key), plain(one)] for key, one in value.items()]
        return [plain(one) for one in value] if isinstance(value, tuple) else value

    text = json.dumps(plain(value, left_out), default=lambda number: number.item())
    write_arrays({"value": text} | {str(number): array for number, array in enumerate(arrays)}, path)


def read_value(hint: type[Kept], path: Path, **known: Any) -> Kept:
    """A value of `write_value` by its type, and what was left out of it; `FileFormatError` if it is no such value."""
    arrays = read_arrays(path)

    def built(hint: Any, plain: Any, **known: Any) -> Any:
        origin, parts = get_origin(hint), get_args(hint)
        if origin in (Union, UnionType):
            return None if plain is None else built(next(part for part in parts if part is not NoneType), plain)
        if np.ndarray in (hint, origin):
            return arrays[str(plain)]
        if origin in (dict, Mapping):
            return {built(parts[0], key): built(parts[1], one) for key, one in plain}
        if origin is tuple:
            each = parts[:1] * len(plain) if parts[1:] == (...,) else parts
            return tuple(built(part, one) for part, one in zip(each, plain, strict=True))
        if is_dataclass(hint):
            hints = get_type_hints(hint)
            return hint(**{name: built(hints[name], one) for name, one in plain.items()}, **known)  # type: ignore[operator]
        if not isinstance(plain, int | float if hint is float else hint):
            raise TypeError(f"{plain!r} is no {hint.__name__}")
        return hint(plain)

    try:
        found: Kept = built(hint, json.loads(str(arrays["value"])), **known)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(f"{path}: holds no value of this program ({error}): delete it.") from None
    return found


def write_arrays(arrays: Mapping[str, Any], path: Path) -> None:
    """Write arrays and numbers by their names, with the hash of their content, whole or not at all."""
    content = BytesIO()
    np.savez(content, **arrays)
    write_bytes(path, *sealed(content.getbuffer(), LAST_LINE))


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of `write_arrays`; `FileFormatError` if they are missing or damaged."""
    try:
        require_intact(path, "delete it", required=True)
        with path.open("rb") as file, np.load(file) as opened:
            return dict(opened)
    except (OSError, ValueError, EOFError, RuntimeError, BadZipFile, zlib.error) as error:
        raise FileFormatError(f"{path}: no arrays of this program ({error}): delete it.") from None
