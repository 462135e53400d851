"""The crossbar in torch: what it reads of resistances, and the resistances that its host finds. Loads torch."""

import math

import numpy as np
import torch
from torch import Tensor

from geometry.wiring import crossing_of_pillar
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import (
    EXACT,
    MAX_LOST,
    MAX_NEWTON_STEPS,
    MAX_OHM,
    MAX_SIEMENS,
    MAX_STEP,
    MIN_OHM,
    MIN_SIEMENS,
    STEP_SHARE,
    Crossbar,
)

MAX_CHORD_STEPS = 12  #: with the tangent at rest; scans that these do not settle get Jacobians of their own


class TorchCrossbar:
    """`Crossbar` and `Corrector` for many scans at once; all tensors are of the type and device of `like`."""

    def __init__(self, crossbar: Crossbar, like: Tensor, corrected: bool = True) -> None:
        self.crossbar, self.corrected = crossbar, corrected
        crossing = crossing_of_pillar(crossbar.rows, crossbar.cols)
        self._crossing = torch.as_tensor(crossing.reshape(-1), device=like.device)  # of each pillar
        self._pillar = torch.as_tensor(np.argsort(crossing.reshape(-1)), device=like.device)  # of each crossing
        self._row, self._column = (torch.as_tensor(end, device=like.device) for end in crossbar.ends)
        self._n_rows, self._is_grounded = 2 * crossbar.rows, crossbar.scan_mode == ScanMode.GROUNDED
        self._series = like.new_tensor(crossbar.series_ohm)
        self._shunts = like.new_tensor(crossbar.shunt_matrix)
        at_rest = np.full((1, len(self._pillar)), 1e-4)  # 10 kΩ each
        apparent, derivatives = crossbar.apparent_and_derivatives(at_rest)
        in_logarithms = derivatives[0] * at_rest / apparent[0][:, None]
        self._tangent = like.new_tensor(np.linalg.inv(in_logarithms).T)
        self._alike = like.new_tensor(at_rest / apparent)
        is_divider = crossbar.scan_mode == ScanMode.DIVIDER
        self._loss = None if is_divider else like.new_tensor(crossbar.loss_by_wire)
        coarse = 10.0 * torch.finfo(like.dtype).eps
        self._tolerance = max(coarse, EXACT if crossbar.full_scale is None else STEP_SHARE / crossbar.full_scale)

    def readings(self, resistance_ohm: Tensor) -> Tensor:
        """Shares of full scale (e, n_crossings) of pillars (e, rows, cols, 3) [Ω], without noise or converter."""
        ohms = resistance_ohm.flatten(1)[:, self._pillar].clamp(MIN_OHM, MAX_OHM)
        y, crossbar = self._apparent(1.0 / ohms, self._shunts), self.crossbar
        if crossbar.scan_mode == ScanMode.DIVIDER:
            return crossbar.sense_ohm / (crossbar.sense_ohm + 2.0 * (crossbar.switch_ohm + crossbar.line_ohm) + 1.0 / y)
        return crossbar.gain_ohm * y

    def counts(self, readings: Tensor) -> Tensor:
        """Counts of the converter, the nearest inside its range; their derivative is that of what they round."""
        full = float(self.crossbar.full_scale or 0)
        counts = (readings * full).clamp(1.0, full - 1.0)
        return counts + (counts.round() - counts).detach()

    def resistances(self, readings: Tensor) -> Tensor:
        """Resistances (e, rows, cols, 3) [Ω] that the host finds; it knows of no shunts."""
        crossbar = self.crossbar
        if not self.corrected:
            ohms = crossbar.sense_ohm / readings
            if crossbar.scan_mode != ScanMode.ZERO_POTENTIAL:
                ohms = (ohms - crossbar.sense_ohm).clamp(min=MIN_OHM)
            return self._as_pillars(ohms)
        if crossbar.scan_mode == ScanMode.DIVIDER:
            around = crossbar.sense_ohm / readings - crossbar.sense_ohm
            y = 1.0 / (around - 2.0 * (crossbar.switch_ohm + crossbar.line_ohm)).clamp(MIN_OHM, MAX_OHM)
        else:
            y = (readings / crossbar.gain_ohm).clamp(min=1.0 / MAX_OHM)
        wanted = y.log()
        u = self._solved(wanted.detach())
        if wanted.requires_grad:  # du = J⁻¹ d log y, of value 0
            u = u + torch.linalg.solve(self._jacobian(u), (wanted - wanted.detach())[..., None])[..., 0]
        return self._as_pillars(torch.exp(-u))

    @torch.no_grad()
    def _solved(self, wanted: Tensor) -> Tensor:
        """Logarithms of conductances from those of apparent ones, by Newton's method as `Corrector`."""
        u = wanted + (self._alike.log() if self._loss is None else self._gained(wanted.exp()))
        unsettled = torch.arange(len(u), device=u.device)
        for step in range(MAX_CHORD_STEPS + MAX_NEWTON_STEPS):
            some = u[unsettled]
            missing = wanted[unsettled] - self._apparent(some.exp(), None).log()
            is_off = (missing.abs() > self._tolerance).any(dim=1)
            unsettled, some, missing = unsettled[is_off], some[is_off], missing[is_off]
            if not len(unsettled):
                break
            if step < MAX_CHORD_STEPS:
                by = missing @ self._tangent
            else:
                by = torch.linalg.solve(self._jacobian(some), missing[..., None])[..., 0]
            moved = some + by.clamp(-MAX_STEP, MAX_STEP)
            u[unsettled] = moved.clamp(math.log(MIN_SIEMENS), math.log(MAX_SIEMENS))
        return u

    def _gained(self, y: Tensor) -> Tensor:
        """First guess of log g − log y, in closed form as `Corrector` has it."""
        assert self._loss is not None
        kept = torch.log1p(-(y @ self._loss).clamp(max=MAX_LOST))
        return -kept[:, self._row] - kept[:, self._column]

    def _jacobian(self, u: Tensor) -> Tensor:
        """Derivatives of log y by log g, (e, n_crossings, n_crossings); as `Crossbar.apparent_and_derivatives`."""
        g, row, column = u.exp(), self._row, self._column
        inverse, N = self._inverse(self._laplacian(g, None))
        y = self._shown(inverse, N)
        if N is None:
            U = inverse[:, :, row] - inverse[:, :, column]
            by_g = ((U[:, row] - U[:, column]) * y[:, :, None]) ** 2
        else:
            U = (inverse[:, row] - inverse[:, column]).mT
            by_g = -U[:, column] * U[:, row]
            if self._is_grounded:
                sense_ohm = self.crossbar.sense_ohm
                by_g = by_g - sense_ohm * y[:, :, None] * U[:, column] ** 2
                by_g = by_g / (1.0 + sense_ohm * self._own(N))[:, :, None]
        return by_g * g[:, None] / y[:, :, None]

    def _apparent(self, conductance: Tensor, shunts: Tensor | None) -> Tensor:
        """Apparent conductances y of pillars' ones g, each (e, n_crossings) [S]; as `Crossbar.apparent_of`."""
        return self._shown(*self._inverse(self._laplacian(conductance, shunts)))

    def _laplacian(self, conductance: Tensor, shunts: Tensor | None) -> Tensor:
        G = conductance.new_zeros(len(conductance), len(self._series), len(self._series))
        G[:, self._row, self._column] = conductance
        G[:, self._column, self._row] = conductance
        if shunts is not None:
            G = G + shunts
        return torch.diag_embed(G.sum(dim=2)) - G

    def _inverse(self, L: Tensor) -> tuple[Tensor, Tensor | None]:
        """K = (1 + R L)⁻¹ and the columns' rows of N = L K; of floating wires L⁻¹ alone."""
        if self.crossbar.scan_mode == ScanMode.DIVIDER:
            tie = L.diagonal(dim1=1, dim2=2).sum(dim=1) / L.shape[1] ** 2
            return torch.linalg.inv(L + tie[:, None, None]), None
        damped = self._series[:, None] * L
        damped.diagonal(dim1=1, dim2=2).add_(1.0)
        K = torch.linalg.inv(damped)
        return K, L[:, self._n_rows :] @ K

    def _shown(self, inverse: Tensor, N: Tensor | None) -> Tensor:
        """y of what `_inverse` gives."""
        if N is None:
            own = inverse.diagonal(dim1=1, dim2=2)
            return 1.0 / (own[:, self._row] + own[:, self._column] - 2.0 * inverse[:, self._row, self._column])
        y = -N[:, self._column - self._n_rows, self._row]
        return y / (1.0 + self.crossbar.sense_ohm * self._own(N)) if self._is_grounded else y

    def _own(self, N: Tensor) -> Tensor:
        """Admittance of each crossing's column with itself."""
        return N[:, self._column - self._n_rows, self._column]

    def _as_pillars(self, values: Tensor) -> Tensor:
        return values[:, self._crossing].reshape(-1, self.crossbar.rows, self.crossbar.cols, 3)
