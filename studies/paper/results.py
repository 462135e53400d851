"""The errors of the paper's experiments by trial."""

from dataclasses import dataclass
from typing import Any

import numpy as np


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
    reason: str = ""  #: why training stopped


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
    samples: tuple[int, ...]  #: their numbers
    actual_n: tuple[float, ...]  #: unit by unit, sample after sample
    decoupled_n: tuple[float, ...]

    @property
    def percent(self) -> float:
        """Mean relative error of the forces shown, eq. 17 [%]."""
        actual_n, decoupled_n = np.array(self.actual_n), np.array(self.decoupled_n)
        return 100 * float(np.mean(np.abs(decoupled_n - actual_n) / np.abs(actual_n)))


@dataclass(frozen=True, kw_only=True)
class Results:
    """All errors of the experiments."""

    data_sets: tuple[DataSet, ...]
    results: tuple[Result, ...]
    shown: tuple[ShownForces, ...]

    def chosen(self, **wanted: Any) -> list[Result]:
        """Results whose trial has the wanted values."""
        return [one for one in self.results if all(getattr(one.trial, name) == v for name, v in wanted.items())]

    def percent(self, **wanted: Any) -> float:
        """Mean relative error of the chosen results [%]; NaN if there are none."""
        chosen = self.chosen(**wanted)
        return 100 * float(np.mean([one.rel_err for one in chosen])) if chosen else float("nan")
