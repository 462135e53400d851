"""What a network is: scaled inputs in, scaled forces out, its last layer linear. A form is one class, in `NETWORKS`."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import rowwise
from decoupler.model.settings import NETWORKS, Net, NetworkConfig, Progress, TrainingConfig
from decoupler.solve import best_ridge
from geometry.layout import FloatArray

Reason = Literal["goal", "iterations", "stagnation", "validation"]  #: why a training stopped
RIDGE = 1e-9  #: λ on the last layer, in units of n_samples; keeps near-linear hidden nodes from cancelling
SCARCE_RIDGE = 1e-4  #: the same for plain nets with no more samples than output weights; halves their error
STEP = 1e-30  #: of an input along the imaginary axis: derivatives without a difference, exact to rounding


@dataclass(frozen=True)
class Outcome:
    """The end of a training: iterations, error and reason."""

    iterations: int
    mse: float
    reason: Reason


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What a network is to learn, of an array of rows and columns, and how."""

    inputs: FloatArray  #: (n, n_in), unit by unit, each within [-1, 1]
    targets: FloatArray  #: (n, n_out), unit by unit, each within [-1, 1]; with `is_known` less the inputs
    load: NDArray[np.int64]  #: (n,): number of each sample's load
    shape: tuple[int, int]
    is_known: bool  #: inputs are forces already, so that a network of weights 0 is the start
    form: NetworkConfig
    training: TrainingConfig
    progress: Progress

    @cached_property
    def ridge(self) -> float:
        """λ on the weights of the last layer: stronger where these could meet any forces whatever."""
        n = len(self.inputs)
        if self.is_known:
            return best_ridge(np.column_stack([self.inputs, np.ones(n)]), self.targets, n / (self.load.max() + 1))
        scarce = self.form.net == "plain" and n <= self.form.hidden + 1
        return (SCARCE_RIDGE if scarce else RIDGE) * n

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """A random order of the samples in which readings of one load stay together; files may be sorted by load."""
        by_load = np.random.default_rng(self.training.seed).permutation(self.load.max() + 1).argsort()
        return np.argsort(by_load[self.load], kind="stable")

    @cached_property
    def held_out(self) -> NDArray[np.int64]:
        """Numbers of the samples, the last in that order, that variable projection keeps for validation.

        No load is split; a plain net has no linear map to fall back to, and keeps none.
        """
        load, n = self.load[self.order], 0
        if self.training.trainer == "varpro" and self.form.net != "plain":
            n = int(self.training.held_out * len(load))
        while 0 < n < len(load) and load[-n] == load[-n - 1]:
            n -= 1
        return self.order[len(load) - n :]


@dataclass(frozen=True, kw_only=True, eq=False)
class Network(ABC):
    """y = W a(x) of inputs x and activations a, which a form says; never changed, only used.

    Its arrays are fields; what it computes of them is written for NumPy and torch alike (`data.columns.namespace`), so
    that it has the same bits alone and in any batch, runs in torch and is exported.
    """

    output: FloatArray  #: W, (n_out, n_activations)
    sees_inputs: ClassVar[bool] = True  #: activations end in the inputs and a 1, so that y may be linear in x

    @classmethod
    @abstractmethod
    def fitted(cls, task: Task) -> tuple[Self, Outcome]:
        """The network that has learned a task, and how its training ended."""

    @abstractmethod
    def activations(self, inputs: FloatArray) -> FloatArray:
        """a of inputs (n, n_in), (n, n_activations)."""

    @property
    @abstractmethod
    def below(self) -> int:
        """Number of weights below the last layer that are not 0; all outputs share them."""

    def outputs(self, inputs: FloatArray) -> FloatArray:
        """y of inputs (n, n_in), (n, n_out)."""
        return rowwise(self.activations(inputs), self.output.T)

    def slopes(self, inputs: FloatArray) -> FloatArray:
        """Derivatives of the outputs by the inputs, (n, n_out, n_in), by a step along the imaginary axis."""
        n, n_in = inputs.shape
        stepped = inputs[:, None] + 1j * STEP * np.eye(n_in)
        by_step = self.activations(stepped.reshape(n * n_in, n_in)).imag / STEP
        return np.asarray((by_step @ self.output.T).reshape(n, n_in, -1).swapaxes(1, 2))

    def beside_inputs(self) -> Self:
        """The same network with its inputs added to its outputs."""
        output, n_out = self.output.copy(), len(self.output)
        output[:, -n_out - 1 : -1] += np.eye(n_out)
        return replace(self, output=output)


def named(place: str) -> Any:
    """What stands at a place "module:name"."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def form_named(net: Net) -> type[Network]:
    """The class of a form of network."""
    found: type[Network] = named(NETWORKS[net])
    return found
