"""The errors of the paper's experiments by trial, and files of results that state what they were computed from."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from common.storage.files import write_text
from common.storage.seal import opened_json, say_made_anew, sealed_json

T = TypeVar("T")
KEY = "recipe"  #: entry of the file that holds the cache key


@dataclass(frozen=True, kw_only=True)
class ResultKey:
    """The data and the network that one error belongs to."""

    experiment: str  #: figure 9 or table 2
    loads: str  #: contact or independent
    component: str
    cap: float  #: largest strain of a pillar in the data
    samples: int  #: for training and test together
    network: str  #: a name of `experiments.NETWORKS`, `experiments.FLOOR` or a mark of `decoupler.model.baseline`
    hidden: int = 0  #: nodes; 0 where there are none
    fold: int = 0  #: from 1; 0 where there are none


@dataclass(frozen=True, kw_only=True)
class Result:
    """Error of one trial on its test samples."""

    trial: ResultKey
    rel_err: float  #: eq. 17, as a fraction
    rmse_n: float
    iterations: int = 0
    reason: str = ""  #: why training stopped
    seconds: float = 0.0  #: of training


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """Samples that several trials share."""

    loads: str
    component: str
    cap: float
    content_hash: str
    largest_strain: float  #: of any pillar in any sample
    least_mse: float  #: bound of a plain network of figure 9's largest width on the training forces, scaled


@dataclass(frozen=True, kw_only=True)
class ShownForces:
    """Forces of some test samples, actual and decoupled, for figure 11."""

    loads: str
    network: str
    hidden: int
    samples: list[int]  #: their numbers
    actual_n: list[float]  #: unit by unit, sample after sample
    decoupled_n: list[float]

    @property
    def percent(self) -> float:
        """Mean relative error of the forces shown, eq. 17 [%]."""
        actual_n, decoupled_n = np.array(self.actual_n), np.array(self.decoupled_n)
        return 100 * float(np.mean(np.abs(decoupled_n - actual_n) / np.abs(actual_n)))


@dataclass(frozen=True, kw_only=True)
class Results:
    """All errors of the experiments."""

    data_sets: list[DataSet]
    results: list[Result]
    shown: list[ShownForces]

    def chosen(self, **wanted: Any) -> list[Result]:
        """Results whose trial has the wanted values."""
        return [one for one in self.results if all(getattr(one.trial, name) == v for name, v in wanted.items())]

    def percent(self, **wanted: Any) -> float:
        """Mean relative error of the chosen results [%]; NaN if there are none."""
        chosen = self.chosen(**wanted)
        return 100 * float(np.mean([one.rel_err for one in chosen])) if chosen else float("nan")


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
