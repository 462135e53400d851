"""What is typed plainly, read by the signatures of jobs alone: flags by their names, each once, with one value each.

All else, help and mistakes, too, is left to the parser, which takes as long to load as a small scene to solve.
"""

from collections.abc import Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from tripillar.cli.door import Job, parameters_of


def typed_plainly(job: Job, words: Sequence[str]) -> tuple[list[Any], dict[str, Any]] | None:
    """Arguments and options of a job as the parser gives them; None where it is to be asked.

    >>> from tripillar.cli.commands import job_of
    >>> typed_plainly(job_of("solve"), ["block.toml", "--tolerance", "1e-2", "--json"])
    ([PosixPath('block.toml')], {'tolerance': 0.01, 'json': True})
    >>> typed_plainly(job_of("solve"), ["block.toml", "--tolerance=1e-2"]) is None
    True
    """
    places: list[Any] = []
    needed: set[str | int] = set()
    flags: dict[str, tuple[str, Any, bool | None]] = {}
    for given, hint, flag in parameters_of(job):
        if flag.required or given.default is given.empty:
            needed.add(given.name if flag.name else len(places))
        if not flag.name:
            places.append(hint)
        is_bool = without_none(hint) is bool
        flags |= {name: (given.name, hint, True if is_bool else None) for name in flag.name}
        flags |= {name: (given.name, hint, False) for name in flag.negative}
    arguments: list[Any] = []
    options: dict[str, Any] = {}
    rest = iter(words)
    try:
        for word in rest:
            if not word.startswith("-"):
                arguments.append(_value(places[len(arguments)], word))
                continue
            name, hint, value = flags[word]
            if name in options:
                return None
            options[name] = _value(hint, next(rest)) if value is None else value
    except (IndexError, KeyError, StopIteration, ValueError):
        return None
    return (arguments, options) if needed <= {*options, *range(len(arguments))} else None


def _value(hint: Any, word: str) -> Any:
    """A word as a value of a type; `ValueError` where the parser is to be asked."""
    kind = without_none(hint)
    if get_origin(kind) is Literal and word in get_args(kind):
        return word
    if get_origin(kind) is list:
        return [_value(get_args(kind)[0], word)]
    if kind not in (Path, str, float, int) or not word or word.startswith("-"):
        raise ValueError
    return kind(word)


def without_none(hint: Any) -> Any:
    """The type of X | None."""
    kinds = [each for each in get_args(hint) if each is not NoneType]
    return kinds[0] if get_origin(hint) in (Union, UnionType) and len(kinds) == 1 else hint
