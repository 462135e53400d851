"""What the experiments gave, by trial, and its JSON form."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geometry.storage.seal import opened_json, say_made_anew, sealed_json
from tripillar.terminal.writing import write_text


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What one error is the error of."""

    experiment: str  #: figure 9 or table 2
    loads: str  #: contact or independent
    component: str
    cap: float  #: largest strain of a pillar in the data
    samples: int  #: for training and test together
    network: (
        str  #: its name in `experiments.NETWORKS`; `experiments.FLOOR`; or that of a mark in `decoupler.model.baseline`
    )
    hidden: int  #: nodes; 0 where there are none
    fold: int = 0  #: from 1; 0 where there are none


@dataclass(frozen=True, kw_only=True)
class Result:
    """Error of one trial on its test samples."""

    trial: Trial
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
    least_mse: float  #: what a plain network of figure 9's largest width can reach on the training forces, scaled


@dataclass(frozen=True, kw_only=True)
class Shown:
    """Forces of some test samples, actual and decoupled, for figure 11."""

    loads: str
    network: str
    hidden: int
    samples: list[int]  #: their numbers
    actual_n: list[float]  #: unit by unit, sample after sample
    decoupled_n: list[float]


@dataclass(frozen=True, kw_only=True)
class Results:
    """All that the experiments gave."""

    recipe: str  #: hash of all that it depends on
    own_trainings: int  #: the paper's own: its network on contact data, figure 9 and table 2
    own_seconds: float  #: from the first sample to the end of the last of those, processes started included
    all_trainings: int
    all_seconds: float
    cores: int
    data_sets: list[DataSet]
    results: list[Result]
    shown: list[Shown]

    def chosen(self, **wanted: Any) -> list[Result]:
        """Results whose trial has the wanted values."""
        return [one for one in self.results if all(getattr(one.trial, name) == v for name, v in wanted.items())]

    def percent(self, **wanted: Any) -> float:
        """Mean relative error of the chosen results [%]."""
        return 100 * float(np.mean([one.rel_err for one in self.chosen(**wanted)]))


def write_results(results: Results, path: Path) -> None:
    """Write the JSON file with its hash, whole or not at all."""
    write_text(sealed_json(asdict(results), 1) + "\n", path)


def read_results(path: Path, recipe: str) -> Results | None:
    """The results in a file if they have that recipe; None if not, or if there is no such file."""
    try:
        plain = opened_json(path.read_text(encoding="utf-8"))
        if plain["recipe"] != recipe:
            return None
        lists = {
            "data_sets": [DataSet(**one) for one in plain["data_sets"]],
            "results": [Result(**one | {"trial": Trial(**one["trial"])}) for one in plain["results"]],
            "shown": [Shown(**one) for one in plain["shown"]],
        }
        return Results(**plain | lists)
    except (OSError, ValueError, KeyError, TypeError):
        say_made_anew(path)
        return None
