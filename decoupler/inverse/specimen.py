"""One sensor at finite strain: how its readings and forces change with what its maker left unknown.

The unknowns of a specimen, in order: a gain and an offset for each pillar, the logarithm of the modulus, the design's
other parameters, and corrections of the squared lengths that all units share. All but gains and offsets are changes
of the few features `FEW` of the maps of finite strain, so a specimen's model is the design's with other weights.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.strain_maps import FEW, N_AXES, N_CURVED, N_FEATURES, OWN
from geometry.layout import FloatArray

FULL = 4.0  #: full scale of a state's numbers, in their standard deviations
#: features that corrections shared by all units have: the own and the neighbours' states to the first order, products
#: of the own to the second, and with the square of the pressing one to the third
_CORRECTED = (
    [(i,) for i in range(3)],
    [(i, j) for i in range(3) for j in range(i, 3)],
    [(0, 2, 2), (1, 2, 2), (2, 2, 2)],
)


def _shared() -> tuple[NDArray[np.int64], FloatArray]:
    """Places of the shared corrections' features among `FEW`, and each one's value at full scale."""
    first = [1 + i for (i,) in _CORRECTED[0]] + [1 + OWN + OWN * n + i for n in range(8) for i in range(3)]
    pairs = [(i, j) for i in range(OWN) for j in range(i, OWN)]
    triples = [(i, j, k) for i in range(OWN) for j in range(i, OWN) for k in range(j, OWN)]
    start = N_FEATURES - N_CURVED
    second = [start + pairs.index(pair) for pair in _CORRECTED[1]]
    third = [start + len(pairs) + triples.index(triple) for triple in _CORRECTED[2]]
    orders = np.repeat([1, 2, 3], [len(first), len(second), len(third)])
    return np.array([*first, *second, *third]), FULL ** orders.astype(np.float64)


SHARED, AT_FULL_SCALE = _shared()


@dataclass(frozen=True, kw_only=True, eq=False)
class Specimen:
    """A sensor of P pillars on k units, p a unit, and how sure what is known of it is.

    The U unknowns are in units of their own: gains as they are, offsets over the resistance at rest, the modulus's
    logarithm, parameters in standard deviations, corrections over the square at rest at full scale.
    """

    changes: FloatArray  #: of the weights of `FEW` by one deviation of each parameter, (n_parameters, 292, 3 + p)
    shift: FloatArray  #: of the same weights, whatever the parameters, (292, 3 + p)
    unknowns: FloatArray  #: (U,)
    factor: FloatArray  #: L of their covariance L Lᵀ, (U, U)

    @classmethod
    def as_designed(cls, changes: FloatArray, n_pillars: int, shift: FloatArray | None = None) -> Self:
        """The design's own values, held to be exact."""
        still = np.zeros(changes.shape[1:]) if shift is None else shift
        nothing = cls(changes=changes, shift=still, unknowns=np.zeros(0), factor=np.zeros((0, 0)))
        size = nothing.n_unknowns(n_pillars)
        return replace(nothing, unknowns=np.zeros(size), factor=np.zeros((size, size)))

    def n_unknowns(self, n_pillars: int) -> int:
        """U of a sensor of so many pillars."""
        return 2 * n_pillars + 1 + len(self.changes) + len(SHARED) * (self.changes.shape[2] - N_AXES)

    @property
    def _ends(self) -> NDArray[np.int64]:
        p, parameters = self.changes.shape[2] - N_AXES, len(self.changes)
        n_pillars = (len(self.unknowns) - 1 - parameters - len(SHARED) * p) // 2
        return np.cumsum([n_pillars, n_pillars, 1, parameters])

    @property
    def parts(self) -> list[FloatArray]:
        """Gains less 1 (P,), offsets (P,), the modulus's logarithm (1,), parameters, corrections (39, p)."""
        gain, offset, modulus, parameters, shared = np.split(self.unknowns, self._ends)
        return [gain, offset, modulus, parameters, shared.reshape(len(SHARED), -1)]

    def model(self, designed: ForwardModel) -> ForwardModel:
        """The forward model of this specimen but for its gains and offsets; `designed` is the design's."""
        maps = designed.maps
        assert maps is not None
        _, _, modulus, parameters, shared = self.parts
        weights = maps.weights.copy()
        weights[FEW] += self.shift + np.tensordot(parameters, self.changes, axes=1)
        weights[FEW[SHARED], N_AXES:] += shared * _at_rest(designed, shared.shape[1]) / AT_FULL_SCALE[:, None]
        stiffer = np.exp(modulus[0])
        weights[:, :N_AXES] *= stiffer
        own = N_CURVED + 1 + np.arange(N_AXES)
        weights[own, np.arange(N_AXES)] += (stiffer - 1.0) * maps.sizes[:N_AXES]
        return replace(designed, maps=replace(maps, weights=weights))

    def derivatives(self, model: ForwardModel, state_n: FloatArray) -> FloatArray:
        """Change of the squares of a sensor as modelled by the unknowns under the same forces, (n, P, U) [mm²].

        Parameters
        ----------
        model : ForwardModel
            As `model` gives it.
        state_n : array, shape (n, 3 k)
            States [N].
        """
        maps = model.maps
        assert maps is not None
        y, by_state, force_n, by_force = model.at_states(state_n)
        n, P = y.shape
        p = self.changes.shape[2] - N_AXES
        k = P // p
        by_n = np.linalg.solve(by_force.swapaxes(1, 2), by_state.swapaxes(1, 2)).swapaxes(1, 2)  # (n, P, 3 k)
        gain, _, modulus, _, _ = self.parts
        rest = _at_rest(model, p)
        X = np.zeros((n, P, len(self.unknowns)))
        at, ends = np.arange(P), self._ends
        X[:, at, at] = y / (1.0 + gain)
        X[:, at, P + at] = np.tile(rest, k) / (1.0 + gain)
        X[:, :, ends[1]] = -(by_n @ force_n[..., None])[..., 0]
        few = maps.few(state_n)  # (n, k, 292)
        moved = np.einsum("nuf,tfc->ntuc", few, self.changes, optimize=True)
        forces = np.exp(modulus[0]) * moved[..., :N_AXES].reshape(n, len(self.changes), -1)
        squares = moved[..., N_AXES:].reshape(n, len(self.changes), P)
        X[:, :, ends[2] : ends[3]] = squares.swapaxes(1, 2) - by_n @ forces.swapaxes(1, 2)
        shared = X[:, :, ends[3] :].reshape(n, k, p, len(SHARED), p)
        values = few[..., SHARED] / AT_FULL_SCALE
        for pillar in range(p):
            shared[:, :, pillar, :, pillar] = values * rest[pillar]
        X[:, :, ends[3] :] = shared.reshape(n, P, -1)
        return X


def _at_rest(model: ForwardModel, p: int) -> FloatArray:
    """Squares of the lengths of a unit's pillars at rest by the linear response, (p,) [mm²]."""
    return (model.linear.lengths(np.zeros((1, model.n_forces)))[0] ** 2)[:p]
