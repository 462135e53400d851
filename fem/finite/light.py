"""Samples under light loads by stored derivatives: without a solve.

About a uniform pressure s between none and half of `MAX_MPA` the displacements and their first derivative are Hermite
polynomials in s, for both ends give their values and slopes; the second derivative is linear in s. Of the third one
only forces on a pad and its four neighbours count, about the middle of s. A sample is expanded about the middle of its
own pressures, so that no pad is further from it than half of `MAX_MPA`.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields
from io import BytesIO
from itertools import combinations, combinations_with_replacement
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fem.finite.derivatives import second_order
from fem.finite.preloads import PreloadedArray
from geometry.errors import FileFormatError
from geometry.layout import FloatArray
from geometry.storage.files import keep, write_bytes
from geometry.storage.seal import LAST_LINE, require_intact, say_made_anew, sealed

MAX_MPA, MAX_SHEAR_MPA = 1.0, 0.3  #: largest pressure and shear on a pad for which the third order does
BLOCK = 256  #: samples of one product, filled up where there are fewer: so a sample's bits are its own
AT_ONCE = 8  #: series expanded together
STEP_MPA = 0.5  #: of the loads from which third derivatives are found; they are exact for any
#: error of the series over (third order)² / second order: 0.5 to 3.5 on 3 × 3 units at up to 1 MPa and 0.3 MPa of shear
TRUNCATED = 4.0
VERSION = 1  #: raise when the same array gives another response, so that cached ones are not used again

Corrected = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, kw_only=True, eq=False)
class LightResponse:
    """Derivatives of the electrodes' displacements of k units, by shares of `MAX_MPA` / 2 and by newtons [mm]."""

    along: FloatArray  #: value, slope and curvature along s at no load and at half of `MAX_MPA`, (6, 6 k)
    first: FloatArray  #: first derivatives there and their slopes along s, (4, 6 k, 3 k)
    pairs: NDArray[np.float32]  #: half the second ones by forces i ≤ j, there one after the other, (2 n_pairs, 6 k)
    triples: NDArray[np.int64]  #: numbers of three forces, (n_triples, 3)
    third: NDArray[np.float32]  #: by their products, of the coarse grid alone, (n_triples, 6 k)
    grid_error: FloatArray  #: of the second order: difference of both grids, relative, ()
    pressing: FloatArray  #: newtons of 1 MPa on every pad, (3 k,)

    @classmethod
    def of(cls, coarse: PreloadedArray, fine: PreloadedArray, corrected: Corrected) -> "LightResponse":
        """From two grids; `corrected` makes of their rows (..., 6 k) those of an answer."""
        design, half = coarse.design, MAX_MPA / 2
        n = 3 * design.n_units
        pressing = np.tile([0.0, 0.0, -(design.pad.size_mm**2)], design.n_units)
        i, j = np.triu_indices(n)
        twice = np.where(i == j, 1.0, 2.0)[:, None]
        of_grids = []
        for array in (coarse, fine):
            ends = [second_order(array, level) for level in (0.0, half)]
            slopes = [2 * half * np.einsum("i,ijo->oj", pressing, end.second) for end in ends]
            along = [
                row
                for end, slope in zip(ends, slopes, strict=True)
                for row in (end.at_rest, half * end.first @ pressing, half * slope @ pressing)
            ]
            first = [end.first.T for end in ends] + [slope.T for slope in slopes]
            pairs = np.concatenate([twice * end.second[i, j] for end in ends])
            of_grids.append((np.array(along), np.array(first), pairs))
        whole = [corrected(*both) for both in zip(*of_grids, strict=True)]
        triples, third = _third_order(coarse, half / 2)
        return cls(
            along=whole[0],
            first=whole[1].swapaxes(1, 2).copy(),
            pairs=whole[2].astype(np.float32),
            triples=triples,
            third=third.astype(np.float32),
            grid_error=np.array(np.linalg.norm(of_grids[1][2] - of_grids[0][2]) / np.linalg.norm(whole[2])),
            pressing=pressing,
        )

    def takes(self, force_n: FloatArray) -> NDArray[np.bool_]:
        """Which samples of forces (m, k, 3) [N] are light enough, (m,)."""
        mpa = force_n / -self.pressing[2]
        pressed = (mpa[..., 2] <= 0) & (mpa[..., 2] >= -MAX_MPA)
        return np.asarray((pressed & (np.hypot(mpa[..., 0], mpa[..., 1]) <= MAX_SHEAR_MPA)).all(axis=1))

    def displacements(self, force_n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Displacements (m, 6 k) [mm] under forces (m, k, 3) [N]; norms of their second and third orders, (m,)."""
        m, size = len(force_n), force_n[0].size
        moved, second, third = np.empty((m, self.along.shape[1])), np.empty(m), np.empty(m)
        for start in range(0, m, BLOCK):
            own = slice(start, min(start + BLOCK, m))
            block = np.zeros((BLOCK, size))
            block[: own.stop - start] = force_n[own].reshape(-1, size)
            for whole, part in zip((moved, second, third), self._block(block), strict=True):
                whole[own] = part[: own.stop - start]
        return moved, second, third

    def _block(self, force: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        pressure = force[:, 2::3] / self.pressing[2]
        middle = (pressure.min(axis=1) + pressure.max(axis=1))[:, None] / 2
        t = middle / (MAX_MPA / 2)
        away = force - middle * self.pressing
        small, share = away.astype(np.float32), t.astype(np.float32)
        products = np.empty((len(force), len(self.pairs)), dtype=np.float32)
        start, n, half = 0, force.shape[1], len(self.pairs) // 2
        for i in range(n):
            np.multiply(small[:, i:], small[:, i : i + 1], out=products[:, start : start + n - i])
            start += n - i
        np.multiply(products[:, :half], share, out=products[:, half:])
        products[:, :half] -= products[:, half:]
        second = (products @ self.pairs).astype(np.float64)
        a, b, c = self.triples.T
        third = (small[:, a] * small[:, b] * small[:, c] @ self.third).astype(np.float64)
        weights = ((1 + 2 * t) * (1 - t) ** 2, t**2 * (3 - 2 * t), t * (1 - t) ** 2, t**2 * (t - 1))
        linear = sum(weight * (away @ matrix.T) for weight, matrix in zip(weights, self.first, strict=True))
        moved = _quintic(t, self.along) + linear + second + third
        return moved, np.linalg.norm(second, axis=1), np.linalg.norm(third, axis=1)


def _quintic(t: FloatArray, ends: FloatArray) -> FloatArray:
    """Polynomial of t (m, 1) with value, slope and curvature at 0 and at 1, (6, n); shape (m, n)."""
    a, b, c, d, e, f = ends
    value, slope, curvature = d - a - b - c / 2, e - b - c, f - c
    cubic = 10 * value - 4 * slope + curvature / 2
    quartic = -15 * value + 7 * slope - curvature
    fifth = 6 * value - 3 * slope + curvature / 2
    return np.asarray(a + t * (b + t * (c / 2 + t * (cubic + t * (quartic + t * fifth)))))


def _third_order(array: PreloadedArray, preload_mpa: float) -> tuple[NDArray[np.int64], FloatArray]:
    """Triples of forces on neighbouring pads, and the displacements (n_triples, 6 k) by their products [mm/N³]."""
    k, cols = array.design.n_units, array.design.array.cols
    units = [tuple(range(3 * unit, 3 * unit + 3)) for unit in range(k)]
    near = [(u, w) for u, w in combinations(range(k), 2) if w - u == cols or (w - u == 1 and w % cols)]
    groups = [units[u] + units[w] for u, w in near] or units
    step = STEP_MPA * array.design.pad.size_mm**2
    at_rest = array.base(preload_mpa).system.force_n
    found: dict[tuple[int, ...], FloatArray] = {}
    for group in groups:
        triples = list(combinations_with_replacement(group, 3))
        loads = np.zeros((len(triples), 3 * k))
        for load, triple in zip(loads, triples, strict=True):
            np.add.at(load, list(triple), 1.0)
        products = loads[:, np.array(triples)].prod(axis=2)  # of each load, for each triple
        answers = [
            array.series(preload_mpa, at_rest + step * loads[some : some + AT_ONCE].reshape(-1, k, 3), 3)[0][3]
            for some in range(0, len(loads), AT_ONCE)
        ]
        by_product = np.linalg.solve(products, np.concatenate(answers).reshape(len(loads), -1)) / step**3
        found |= dict(zip(triples, by_product, strict=True))
    return np.array(list(found)), np.array(list(found.values()))


def kept_response(path: Path, make: Callable[[], LightResponse]) -> LightResponse:
    """The response in a file of the cache, made and kept where there is none; a damaged file is said and made anew."""
    try:
        require_intact(path, "delete it", required=True)
        with path.open("rb") as file, np.load(file) as opened:
            return LightResponse(**{each.name: opened[each.name] for each in fields(LightResponse)})
    except (FileFormatError, OSError, KeyError, ValueError, TypeError, EOFError, RuntimeError, BadZipFile, zlib.error):
        say_made_anew(path)
    response = make()
    content = BytesIO()
    np.savez(content, **vars(response))
    keep(lambda path: write_bytes(path, *sealed(content.getbuffer(), LAST_LINE)), path)
    return response
