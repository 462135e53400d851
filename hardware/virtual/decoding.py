"""A decoder's forces in torch: the same numbers as `Decoupler.forces`, with derivatives. Loads torch."""

import torch
from torch import Tensor

from dataset.measurement import SENSE_OHM
from decoupler.data.columns import DEAD_OHM, MAX_COUNTS_FROM_REST, MIN_RESTING
from decoupler.inverse.forward_model import MIN_WHOLE_OHM, ForwardModel
from decoupler.model.decoupler import Decoupler
from geometry.errors import DesignError
from geometry.layout import PILLARS


class TorchForward:
    """R = c |d + B F|² + o of a `ForwardModel`; F and R are its columns, (n, n_forces) and (n, n_pillars)."""

    def __init__(self, forward: ForwardModel, like: Tensor) -> None:
        n_components, n_pillars = forward.rest_mm.shape
        by_electrode = forward.influence.reshape(forward.n_forces, n_components, -1)
        self.influence = like.new_tensor(by_electrode[:, :, forward.top]).reshape(forward.n_forces, -1)
        self.rest_mm = like.new_tensor(forward.rest_mm)
        self.sign = None if forward.sign is None else like.new_tensor(forward.sign)
        self.ohm_per_mm2, self.offset_ohm = like.new_tensor(forward.ohm_per_mm2), like.new_tensor(forward.offset_ohm)
        self._shape = (-1, n_components, n_pillars)

    def vectors(self, force_n: Tensor) -> Tensor:
        """Vectors v = d + B F of the pillars, (n, n_components, n_pillars) [mm]."""
        return (force_n @ self.influence).reshape(self._shape) + self.rest_mm

    def squares(self, vectors: Tensor) -> Tensor:
        """Squared lengths, (n, n_pillars) [mm²]."""
        squared = vectors * vectors
        return (squared if self.sign is None else squared * self.sign).sum(dim=1)

    def lengths(self, force_n: Tensor) -> Tensor:
        """Lengths, (n, n_pillars) [mm]."""
        return self.squares(self.vectors(force_n)).clamp(min=0.0).sqrt()

    def resistances(self, force_n: Tensor) -> Tensor:
        """Resistances, (n, n_pillars) [Ω]; eq. 1."""
        return self.ohm_per_mm2 * self.squares(self.vectors(force_n)) + self.offset_ohm


class TorchDecoder:
    """A `Decoupler` in torch: ohms in, newtons out.

    Parameters
    ----------
    model : Decoupler
    like : Tensor
        Its type and device are those of all tensors.

    Raises
    ------
    DesignError
        If the model learned from samples at finite strain.
    """

    def __init__(self, model: Decoupler, like: Tensor) -> None:
        def tensor(values: object) -> Tensor:
            return like.new_tensor(values)

        if model.posterior is not None:
            raise DesignError(
                "a model of finite strain is not known in torch yet: give one that was trained on linear samples."
            )
        self.model = model
        self._pillars = [PILLARS.index(pillar) for pillar in model.component.pillars]
        dead = model.dead
        self._dead = None if dead is None else torch.as_tensor(dead[..., self._pillars].reshape(-1), device=like.device)
        self._input = tensor(model.input_scaling.centre), tensor(model.input_scaling.factor)
        self._output = tensor(model.output_scaling.half_range), tensor(model.output_scaling.centre)
        self._hidden, self._weights = tensor(model.hidden_weights.T), tensor(model.output_weights.T)
        resting = model.resting
        self._resting = None if resting is None else (tensor(resting.rest_ohm), float(resting.full_counts[0]))
        inverse = model.inverse
        if inverse is not None:
            self._forward = TorchForward(inverse.forward, like)
            self._start = tensor(inverse.centre_mm), tensor(inverse.centre_n)
            self._correctors = [tensor(corrector) for corrector in inverse.correctors]

    def forces(self, resistance_ohm: Tensor) -> Tensor:
        """Forces (e, rows, cols, k) [N] of resistances (e, rows, cols, 3) [Ω], k as the model's component has axes."""
        e, rows, cols, _ = resistance_ohm.shape
        columns = resistance_ohm[..., self._pillars].reshape(e, -1)
        if self._dead is not None:
            columns = torch.where(self._dead, DEAD_OHM, columns)
        inputs = self._inputs(columns)
        ones = torch.ones_like(inputs[:, :1])
        X = torch.cat([inputs, ones], dim=1)
        activations = X
        if self.model.network.hidden:
            hidden = torch.tanh(X @ self._hidden)
            activations = torch.cat([hidden, X if self.model.network.net == "skip" else ones], dim=1)
        half_range, centre = self._output
        return (activations @ self._weights * half_range + centre).reshape(e, rows, cols, -1)

    def _inputs(self, columns: Tensor) -> Tensor:
        """Inputs of the hidden layer, as `Decoupler.inputs`."""
        if self._resting is not None:
            columns = self._settled(columns, *self._resting)
        if self.model.inverse is not None:
            feature = self._inverse(columns)
        else:
            feature = columns.sqrt() if self.model.network.feature == "root" else columns
        centre, factor = self._input
        return (feature - centre) * factor

    def _inverse(self, columns: Tensor) -> Tensor:
        """Forces by the response's inverse, as `ModelInverse.forces`."""
        lengths = ((columns - self._forward.offset_ohm).clamp(min=MIN_WHOLE_OHM) / self._forward.ohm_per_mm2).sqrt()
        centre_mm, forces = self._start
        forces = forces + (lengths - centre_mm) @ self._correctors[0]
        for corrector in self._correctors[1:]:
            forces = forces + (lengths - self._forward.lengths(forces)) @ corrector
        return forces

    @staticmethod
    def _settled(columns: Tensor, rest_ohm: Tensor, full_counts: float) -> Tensor:
        """Readings that may be at rest put there where most of a scan's may, as `Resting.settled`."""
        off = (SENSE_OHM / (columns + SENSE_OHM) - SENSE_OHM / (rest_ohm + SENSE_OHM)).abs()
        alike = off <= MAX_COUNTS_FROM_REST / full_counts
        resting = alike.sum(dim=1, keepdim=True) > MIN_RESTING * columns.shape[1]
        return torch.where(alike & resting, rest_ohm, columns)
