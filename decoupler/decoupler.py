"""A trained network with its scaling: ohms in, newtons out. In numpy: a live sensor loads no torch."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from decoupler.components import Component, pillar_columns
from decoupler.errors import SampleError
from decoupler.scaling import Scaling
from decoupler.settings import Feature, NetworkConfig
from geometry.design import SensorDesign
from geometry.layout import FloatArray


def features(columns_ohm: FloatArray, feature: Feature) -> FloatArray:
    """What a network sees of the resistances: R itself, or √R, which is proportional to a pillar's length."""
    return np.sqrt(columns_ohm) if feature == "root" else columns_ohm


@dataclass(frozen=True, kw_only=True)
class Decoupler:
    """A network as trained; never changed, only used."""

    component: Component
    rows: int
    cols: int
    network: NetworkConfig
    input_scaling: Scaling
    output_scaling: Scaling
    hidden_weights: FloatArray  #: (n_hidden, n_in + 1), bias last
    output_weights: FloatArray  #: (n_out, n_hidden + n_in + 1); without skip (n_out, n_hidden + 1); bias last
    design: SensorDesign | None  #: of the training data; None if they did not say
    made_from: dict[str, Any] = field(default_factory=dict)  #: recipe, data hash, seed, trainer, how it ended

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces on every unit.

        Parameters
        ----------
        resistance_ohm : array, shape (n_samples, rows, cols, 3)
            Resistance of the z, x and y pillars [Ω]; pillars that the component does not take may hold
            anything.

        Returns
        -------
        array, shape (n_samples, rows, cols, n_axes)
            Forces along ``component.axes`` [N]; Fz positive in compression.

        Raises
        ------
        SampleError
            If the array is another size than the model's, or a resistance is not finite or not above 0.

        Notes
        -----
        output = linear(input) + W₂ tanh(W₁ input) with skip, constant + W₂ tanh(W₁ input) without. Each
        sample is multiplied on its own, so that it gives the same bits alone and in any batch.
        """
        resistance_ohm = np.asarray(resistance_ohm, dtype=np.float64)
        columns = pillar_columns(resistance_ohm, self.component)
        if resistance_ohm.shape[1:3] != (self.rows, self.cols):
            given = " × ".join(map(str, resistance_ohm.shape[1:3]))
            raise SampleError(
                f"resistances are of {given} units, the model's sensor has {self.rows} × {self.cols}: "
                "train a model on data of this sensor."
            )
        scaled = self.input_scaling.scale(features(columns, self.network.feature))
        X = np.concatenate([scaled, np.ones((len(scaled), 1))], axis=1)  # (n_samples, n_in + 1)
        hidden = np.tanh(_each(self.hidden_weights, X))  # (n_samples, n_hidden)
        linear = X if self.network.net == "skip" else X[:, -1:]
        outputs = _each(self.output_weights, np.concatenate([hidden, linear], axis=1))
        n_axes = len(self.component.axes)
        return self.output_scaling.unscale(outputs).reshape(-1, self.rows, self.cols, n_axes)


def _each(weights: FloatArray, samples: FloatArray) -> FloatArray:
    """weights @ sample for each sample by itself; one product of all would round by the size of the batch."""
    return np.matmul(weights[None], samples[:, :, None])[:, :, 0]
