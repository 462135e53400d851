"""Results of a study in a JSON file that states their cache key: they are computed again only if that changed."""

from collections.abc import Callable
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from geometry.storage.files import write_text
from geometry.storage.seal import opened_json, say_made_anew, sealed_json

T = TypeVar("T")
KEY = "recipe"  #: entry of the file that holds the cache key


def kept(path: Path, cache_key: str, kind: type[T], make: Callable[[], T]) -> tuple[T, bool]:
    """The results in a file with this cache key, else new ones, written there; and whether they are new."""
    found = read_results(path, cache_key, kind)
    if found is not None:
        return found, False
    made = make()
    write_results(made, cache_key, path)
    return made, True


def write_results(found: Any, cache_key: str, path: Path) -> None:
    """Write a dataclass as JSON with its hash, whole or not at all."""
    write_text(sealed_json({KEY: cache_key, **asdict(found)}, 1) + "\n", path)


def read_results(path: Path, cache_key: str, kind: type[T]) -> T | None:
    """The dataclass in a file; None if there is no such file, it is damaged, or its cache key is another."""
    try:
        plain = opened_json(path.read_text(encoding="utf-8"))
        found: T | None = _as(kind, plain) if plain.pop(KEY) == cache_key else None
        return found
    except (OSError, ValueError, KeyError, TypeError):
        say_made_anew(path)
        return None


def _as(kind: Any, plain: Any) -> Any:
    """Plain JSON as the type that a field declares: dataclasses, lists and tuples, nested."""
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        return kind(**{name: _as(hints[name], value) for name, value in plain.items()})  # type: ignore[operator]
    if get_origin(kind) in (list, tuple):
        return get_origin(kind)(_as(get_args(kind)[0], value) for value in plain)
    return plain
