"""Material laws: stored energy, stress and tangent of rubber as functions of the deformation.

A law stores ψ = W(F) + λ/2 θ², with θ the change of volume. The second term is the pressure's, p = λ θ, which elements
find for themselves so that nearly incompressible rubber does not lock; a law says what θ is. First Piola-Kirchhoff
stress, with H = F − I the gradient of the displacement:

    P = ∂W/∂F + p ∂θ/∂F

All laws are Hooke's of the same λ and μ at small strain. Another one is a class with W and its two derivatives, and its
line in `LAWS`, by whose names designs and scenes know them.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray

if TYPE_CHECKING:
    from geometry.design import Material

MIN_LAME = 1e-9  #: least λ over μ, which mixed elements divide by where ν = 0
EPSILON = [(i, j, k, sign) for sign in (1, -1) for i, j, k in [(s, (s + sign) % 3, (s - sign) % 3) for s in range(3)]]


@dataclass(frozen=True, eq=False)
class Strain:
    """Deformation at points; free of cancellation where strains are tiny."""

    H: FloatArray  #: displacement gradient F − I, (3, 3, ...): component i by coordinate J
    C: FloatArray  #: ∂θ/∂F − I: cof F − I, or 0 where strains are small, (3, 3, ...)
    theta: FloatArray  #: change of volume θ: J − 1, or tr H where strains are small, (...)

    @property
    def J(self) -> FloatArray:
        """Ratio of volumes, (...)."""
        return 1.0 + self.theta

    @property
    def F(self) -> FloatArray:
        """Deformation gradient, (3, 3, ...)."""
        return plus_unit(self.H.copy(), 1.0)

    @property
    def cof(self) -> FloatArray:
        """∂θ/∂F: the cofactors J F⁻ᵀ, or the identity where strains are small, (3, 3, ...)."""
        return plus_unit(self.C.copy(), 1.0)


@dataclass(frozen=True, eq=False)
class Law(ABC):
    """Rubber of Lamé's constants, arrays that broadcast to the points [MPa]; ratios of its own are further fields."""

    mu_mpa: FloatArray
    lame_mpa: FloatArray

    @classmethod
    def ratios(cls) -> list[str]:
        """Names of its own constants, ratios of moduli, by which `Material` has them."""
        return [spec.name for spec in fields(cls) if spec.name not in Law.__annotations__]

    @classmethod
    def of(cls, materials: "Sequence[Material]", shares: FloatArray) -> Self:
        """The law of mixtures of rubbers, shares (n_materials, ...) of each at every point, as of their moduli."""
        lame = np.array([material.lame_mpa for material in materials])
        first, mu = np.tensordot(lame.T, shares, 1)
        own = {name: np.array([getattr(material, name) for material in materials]) for name in cls.ratios()}
        mixed = {name: np.tensordot(ratio * lame[:, 1], shares, 1) / mu for name, ratio in own.items()}
        return cls(mu_mpa=mu, lame_mpa=np.maximum(first, MIN_LAME * mu), **mixed)

    @property
    def is_linear(self) -> bool:
        return False

    def strain(self, H: FloatArray) -> Strain:
        """Deformation of displacement gradients (3, 3, ...)."""
        second = cofactors(H)
        trace = H[0, 0] + H[1, 1] + H[2, 2]
        determinant = H[0, 0] * second[0, 0] + H[0, 1] * second[0, 1] + H[0, 2] * second[0, 2]
        theta = trace + second[0, 0] + second[1, 1] + second[2, 2] + determinant
        second -= H.swapaxes(0, 1)
        return Strain(H=H, C=plus_unit(second, trace), theta=theta)

    @abstractmethod
    def energy(self, strain: Strain) -> FloatArray:
        """W, shape (...) [MPa = mJ/mm³]."""

    @abstractmethod
    def stress(self, strain: Strain, p: FloatArray) -> FloatArray:
        """P = ∂W/∂F + p ∂θ/∂F of pressures (...), shape (3, 3, ...) [MPa]."""

    @abstractmethod
    def tangent(self, strain: Strain, p: FloatArray) -> FloatArray:
        """∂²W/∂F² + p ∂²θ/∂F², shape (3, 3, 3, 3, ...), entry [i, J, j, L] [MPa]."""

    def part(self, some: slice | NDArray) -> Self:
        """The law at some of the places along the first axis of λ and μ."""
        parts = {name: np.broadcast_to(value, self.mu_mpa.shape)[some] for name, value in vars(self).items()}
        return replace(self, **parts)


class Linear(Law):
    """Linear elasticity: W = μ ε : ε with ε = (H + Hᵀ)/2, θ = tr H."""

    @property
    def is_linear(self) -> bool:
        return True

    def strain(self, H: FloatArray) -> Strain:
        return Strain(H=H, C=np.zeros_like(H), theta=H[0, 0] + H[1, 1] + H[2, 2])

    def energy(self, strain: Strain) -> FloatArray:
        both = strain.H + strain.H.swapaxes(0, 1)
        return self.mu_mpa / 4 * (both**2).sum(axis=(0, 1))

    def stress(self, strain: Strain, p: FloatArray) -> FloatArray:
        return plus_unit(self.mu_mpa * (strain.H + strain.H.swapaxes(0, 1)), p)

    def tangent(self, strain: Strain, p: FloatArray) -> FloatArray:
        mu = np.broadcast_to(self.mu_mpa, strain.theta.shape)
        out = plus_unit_tensor(np.zeros((3, 3, 3, 3, *mu.shape)), mu)
        for i, j in product(range(3), range(3)):
            out[i, j, j, i] += mu
        return out


class NeoHookean(Law):
    """W = μ/2 (I₁ − 3) − μ ln J."""

    def energy(self, strain: Strain) -> FloatArray:
        H = strain.H  # (I₁ − 3)/2 = tr H + |H|²/2
        return self.mu_mpa * (H[0, 0] + H[1, 1] + H[2, 2] + (H**2).sum(axis=(0, 1)) / 2 - np.log1p(strain.theta))

    def stress(self, strain: Strain, p: FloatArray) -> FloatArray:
        over = self.mu_mpa / strain.J  # μ F + (p − μ/J) cof F
        P = (p - over) * strain.C
        P += self.mu_mpa * strain.H
        return plus_unit(P, p + over * strain.theta)

    def tangent(self, strain: Strain, p: FloatArray) -> FloatArray:
        over = self.mu_mpa / strain.J
        out = cofactor_slopes(strain.F, p - over)
        cof = strain.cof
        out += np.einsum("iJ...,jL...->iJjL...", over / strain.J * cof, cof)
        return plus_unit_tensor(out, np.broadcast_to(self.mu_mpa, strain.theta.shape))


@dataclass(frozen=True, eq=False)
class MooneyRivlin(Law):
    """W = c₁ (I₁ − 3) + c₂ (I₂ − 3) − 2 (c₁ + 2 c₂) ln J − 2 c₂ (J − 1)² with c₁ = (1 − r) μ/2, c₂ = r μ/2.

    I₂ = (I₁² − |C|²)/2 of C = FᵀF, ∂I₂/∂F = 2 (I₁ F − F C). The last term leaves λ at small strain what it is.
    """

    second_ratio: FloatArray | float = 0.0  #: r = c₂/(c₁ + c₂), as λ and μ

    def _constants(self) -> tuple[FloatArray, FloatArray]:
        return (1 - self.second_ratio) / 2 * self.mu_mpa, self.second_ratio / 2 * self.mu_mpa

    def energy(self, strain: Strain) -> FloatArray:
        first, second = self._constants()
        H = strain.H
        G = H + H.swapaxes(0, 1) + np.einsum("kJ...,kL...->JL...", H, H)  # FᵀF − I
        trace = G[0, 0] + G[1, 1] + G[2, 2]  # I₁ − 3; I₂ − 3 = 2 tr G + (tr² G − |G|²)/2
        more = 2 * trace + (trace**2 - (G**2).sum(axis=(0, 1))) / 2
        log = 2 * (first + 2 * second) * np.log1p(strain.theta)
        return first * trace + second * more - log - 2 * second * strain.theta**2

    def stress(self, strain: Strain, p: FloatArray) -> FloatArray:
        first, second = self._constants()
        F, H = strain.F, strain.H
        G = H + H.swapaxes(0, 1) + np.einsum("kJ...,kL...->JL...", H, H)
        over, pressed = 2 * (first + 2 * second) / strain.J, p - 4 * second * strain.theta
        # 2 c₁ F + 2 c₂ (I₁ F − F FᵀF) + (p − 2 (c₁ + 2 c₂)/J − 4 c₂ θ) cof F, its parts at rest cancelled
        out = 2 * (first + 2 * second) * H + (pressed - over) * strain.C
        out += 2 * second * ((G[0, 0] + G[1, 1] + G[2, 2]) * F - np.einsum("iK...,KJ...->iJ...", F, G))
        return plus_unit(out, over * strain.theta + pressed)

    def tangent(self, strain: Strain, p: FloatArray) -> FloatArray:
        first, second = self._constants()
        F, cof = strain.F, strain.cof
        right, left = np.einsum("kJ...,kL...->JL...", F, F), np.einsum("iK...,jK...->ij...", F, F)
        over = 2 * (first + 2 * second) / strain.J
        out = cofactor_slopes(F, p - over - 4 * second * strain.theta)
        out += np.einsum("iJ...,jL...->iJjL...", (over / strain.J - 4 * second) * cof, cof)
        out += 2 * second * (2 * np.einsum("iJ...,jL...->iJjL...", F, F) - np.einsum("iL...,jJ...->iJjL...", F, F))
        for i in range(3):
            out[i, :, i] -= 2 * second * right
            out[:, i, :, i] -= 2 * second * left
        trace = right[0, 0] + right[1, 1] + right[2, 2]
        return plus_unit_tensor(out, 2 * (first + second * trace))


@dataclass(frozen=True, eq=False)
class Yeoh(NeoHookean):
    """W = μ/2 (G + k G²) with G = I₁ − 3 − 2 ln J: Yeoh's c₁ = μ/2 and c₂ = k c₁ where volume is kept.

    With s = 1 + 2 k G: P = s μ (F − F⁻ᵀ) + p cof F. G, which is of second order, leaves small strain Hooke's.
    """

    stiffening: FloatArray | float = 0.0  #: k = c₂/c₁, as λ and μ

    def energy(self, strain: Strain) -> FloatArray:
        return super().energy(strain) * (1.0 + self.stiffening * self._G(strain))

    def stress(self, strain: Strain, p: FloatArray) -> FloatArray:
        s = self._stiffer(strain)
        return s * super().stress(strain, p / s)

    def tangent(self, strain: Strain, p: FloatArray) -> FloatArray:
        s, slope = self._stiffer(strain), super().stress(strain, np.zeros_like(strain.theta))  # slope: μ ∂G/∂F / 2
        own = 4 * self.stiffening / self.mu_mpa * np.einsum("iJ...,jL...->iJjL...", slope, slope)
        return s * super().tangent(strain, p / s) + own

    def _G(self, strain: Strain) -> FloatArray:
        return 2 / self.mu_mpa * super().energy(strain)

    def _stiffer(self, strain: Strain) -> FloatArray:
        return 1.0 + 2 * self.stiffening * self._G(strain)


LAWS: dict[str, type[Law]] = {
    "linear": Linear,
    "neo-hookean": NeoHookean,
    "mooney-rivlin": MooneyRivlin,
    "yeoh": Yeoh,
}
RATIOS = tuple(dict.fromkeys(name for law in LAWS.values() for name in law.ratios()))  #: of all laws


def plus_unit(A: FloatArray, scale: FloatArray | float) -> FloatArray:
    """A + scale I, in place, of matrices (3, 3, ...)."""
    for i in range(3):
        A[i, i] += scale
    return A


def plus_unit_tensor(A: FloatArray, scale: FloatArray) -> FloatArray:
    """A + scale δᵢⱼ δ_JL, in place, of tensors (3, 3, 3, 3, ...)."""
    for i, J in product(range(3), range(3)):
        A[i, J, i, J] += scale
    return A


def cofactor_slopes(F: FloatArray, scale: FloatArray) -> FloatArray:
    """Scale times ∂ cof F/∂F = εᵢⱼₖ ε_JLK F_kK, in [i, J, j, L], shape (3, 3, 3, 3, ...)."""
    own = scale * F
    out = np.zeros((3, 3, 3, 3, *own.shape[2:]))
    for (i, j, k, s), (J, L, K, t) in product(EPSILON, EPSILON):
        out[i, J, j, L] += s * t * own[k, K]
    return out


def cofactors(F: FloatArray) -> FloatArray:
    """Cofactors of matrices (3, 3, ...), of the same shape: J F⁻ᵀ."""
    return bilinear_cofactors(F, F) / 2


def bilinear_cofactors(A: FloatArray, B: FloatArray) -> FloatArray:
    """Twice the symmetric bilinear form of the cofactors: cof(A + B) − cof A − cof B; matrices (3, 3, ...).

    >>> bool(np.allclose(bilinear_cofactors(np.eye(3), np.eye(3)), 2 * np.eye(3)))
    True
    """
    out = np.empty(np.broadcast_shapes(A.shape, B.shape))
    for i, d in product(range(3), range(3)):
        i1, i2, d1, d2 = (i + 1) % 3, (i + 2) % 3, (d + 1) % 3, (d + 2) % 3
        out[i, d] = A[i1, d1] * B[i2, d2] - A[i1, d2] * B[i2, d1]
        if A is B:
            out[i, d] *= 2
        else:
            out[i, d] += B[i1, d1] * A[i2, d2] - B[i1, d2] * A[i2, d1]
    return out
