"""The paper's claim on spacing at every pitch: the disturbance of neighbours, and the lightest touch that is felt.

The paper: for a load on about 1 cm² "the distance between the adjacent sensitive units should be around 1–2 cm;
otherwise, it is very difficult for the sensitive units to feel or react to the touch" further off (section 3.1).
Finite elements of the whole array give how much a loaded pad moves its neighbours, and what that costs the map from
forces to readings. The closed form of an endless layer gives the touch that is just felt wherever it falls, since such
a touch lies on no pad.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from common.storage.files import digest
from dataset.measurement import ReadingError
from decoupler.data.columns import component_named
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from fem.array.closed_forms import layer_mean_compliance
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, array_response, response_cache_key
from geometry.design import Array, SensorDesign
from geometry.layout import (
    AXES,
    FloatArray,
    electrode_squares,
    pillar_vectors,
    rest_lengths,
    unit_centres,
)

VERSION = 2  #: raise when the same settings give other numbers
LOADS = {"normal": 2, "tangential": 0}  #: with the axis of the load; y is x mirrored
RINGS = (1, 2, 3)  #: pitches between a loaded unit and a neighbour
PLACES = 8  #: along x and y in one pitch, where a touch is tried
PRESSED_N = 100.0  #: 1 MPa, the least of the paper's pressures, on its 1 cm²
AROUND = 2  #: units on either side that may feel it


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The spacings of the study and its settings."""

    pitches_mm: tuple[float, ...] = (10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 18.0, 20.0)  #: the paper's 1 to 2 cm
    wider_mm: tuple[float, ...] = (25.0, 30.0, 40.0)  #: beyond, for touches only
    touch_mm: float = 10.0  #: side of the touch: the paper's 1 cm²
    noise: float = 0.001  #: of a reading
    sure: float = 3.0  #: standard deviations of noise that count as felt
    tolerance: float = 1e-2  #: of the responses
    far: float = 2.5  #: heights from the load, from where its decay is fitted


@dataclass(frozen=True, kw_only=True)
class Spaced:
    """One pitch. Shares are the largest among neighbours over the largest of the loaded unit itself."""

    pitch_mm: float
    span_mm: float
    pad_mm: float
    reading_share: dict[str, tuple[float, ...]]  #: by load, for neighbours at each of RINGS: changes of resistances
    condition: float  #: of the map from all forces to all relative changes of resistances, at rest
    noise_n: dict[str, float]  #: least error of a force by the readings' noise, root mean square over the units [N]
    distance_mm: tuple[float, ...]  #: of every electrode from the middle of the loaded pad
    moved: tuple[float, ...]  #: displacement of that electrode by a normal load, over the loaded unit's
    on_rim: tuple[bool, ...]  #: whether its unit has no neighbour on some side


@dataclass(frozen=True, kw_only=True)
class Touch:
    """The lightest touches that some pillar feels, at the place where that takes most [N]."""

    pitch_mm: float
    worst_n: dict[str, float]  #: by load


@dataclass(frozen=True, kw_only=True)
class Spacing:
    """The results of the study at every pitch."""

    asked: Asked
    smallest_mm: float  #: pitch below which the paper's units would merge
    decay_mm: float  #: e-fold length of an endless layer, far from the load
    fitted_mm: float  #: that of the finite elements inside the array
    spaced: tuple[Spaced, ...]
    touches: tuple[Touch, ...]

    @property
    def fitting(self) -> list[Spaced]:
        """Pitches at which the paper's unit fits."""
        return [one for one in self.spaced if one.pitch_mm >= self.smallest_mm]


def spacing_cache_key(design: SensorDesign, asked: Asked) -> str:
    """Hash of all that the study depends on."""
    settings = ResponseSettings(tolerance=asked.tolerance)
    responses = [response_cache_key(design_at(design, pitch), settings) for pitch in asked.pitches_mm]
    return digest("spacing", VERSION, design, asked, responses)


def study_spacing(design: SensorDesign, asked: Asked, progress: Callable[[str], None] = lambda step: None) -> Spacing:
    """Solve every pitch; `progress` is called as each begins."""
    spaced = []
    for pitch_mm in asked.pitches_mm:
        progress(f"{pitch_mm:g} mm")
        response, _, _ = array_response(design_at(design, pitch_mm), ResponseSettings(tolerance=asked.tolerance))
        spaced.append(spaced_units(response, asked.noise))
    touches = []
    for pitch_mm in (*asked.pitches_mm, *asked.wider_mm):
        progress(f"touches, {pitch_mm:g} mm")
        touches.append(lightest_touch(design_at(design, pitch_mm), asked))
    height_mm = design.unit.height_mm
    return Spacing(
        asked=asked,
        smallest_mm=design.unit.footprint_mm,
        decay_mm=decay_length_mm(height_mm, design.matrix_material.poisson),
        fitted_mm=fitted_decay_mm(spaced, asked.far * height_mm),
        spaced=tuple(spaced),
        touches=tuple(touches),
    )


def design_at(design: SensorDesign, pitch_mm: float) -> SensorDesign:
    """A design at another pitch: as it is where it fits, else with the widest span and pad that do."""
    unit = design.unit
    if unit.footprint_mm > pitch_mm:
        spare = brentq(lambda span: replace(unit, span_mm=span).footprint_mm - pitch_mm, unit.span_mm / 4, unit.span_mm)
        unit = replace(unit, span_mm=float(np.floor(100 * spare) / 100))
    share = 2 * design.pad_room_mm / design.array.pitch_mm
    pad = replace(design.pad, size_mm=min(design.pad.size_mm, float(np.floor(100 * share * pitch_mm) / 100)))
    return replace(design, unit=unit, pad=pad, array=replace(design.array, pitch_mm=pitch_mm))


def spaced_units(response: ArrayResponse, noise: float) -> Spaced:
    """Influence on the neighbours of a unit in the middle, and condition and noise of the whole map."""
    design = response.design
    rows, cols = design.array.rows, design.array.cols
    forward = SensorModel.of(response, component_named("all"))
    at_rest = np.zeros((1, forward.n_forces))
    lengths, slopes = forward.jacobian(at_rest)
    readings = 2 * slopes[0] / lengths[0][:, None]  # ∂(ln R)/∂F, as R grows with l²
    unbiased_n = cramer_rao(forward, at_rest, ReadingError(noise=noise), (rows, cols)).reshape(-1, len(AXES))
    by_unit = readings.reshape(rows, cols, 3, rows, cols, 3)
    moved = np.linalg.norm(response.influence_mm_per_n, axis=3)  # of electrodes, whatever the direction
    row, col = (rows - 1) // 2, (cols - 1) // 2
    rim = ~np.pad(np.ones((rows - 2, cols - 2), dtype=bool), 1)
    centre = unit_centres(design)[row * cols + col]
    places = (electrode_squares(design).reshape(-1, 2, 2).mean(axis=1) - centre).reshape(-1, 2)
    share = moved[..., row, col, LOADS["normal"]] / moved[row, col, :, row, col, LOADS["normal"]].max()
    return Spaced(
        pitch_mm=design.array.pitch_mm,
        span_mm=design.unit.span_mm,
        pad_mm=design.pad.size_mm,
        reading_share={load: _ring_shares(np.abs(by_unit[..., row, col, a]), row, col) for load, a in LOADS.items()},
        condition=float(np.linalg.cond(readings)),
        noise_n={f"f{axis}": float(np.sqrt((unbiased_n[:, i] ** 2).mean())) for i, axis in enumerate(AXES)},
        distance_mm=tuple(np.linalg.norm(places, axis=1).tolist()),
        moved=tuple(share.ravel().tolist()),
        on_rim=tuple(np.repeat(rim, len(design.unit.layout.upper)).tolist()),
    )


def _ring_shares(sizes: FloatArray, row: int, col: int) -> tuple[float, ...]:
    """Largest of sizes (rows, cols, n) among neighbours 1, 2, 3 along the row or column, over the unit's own."""
    rows, cols, _ = sizes.shape
    shares = []
    for k in RINGS:
        ring = [(row + k, col), (row - k, col), (row, col + k), (row, col - k)]
        inside = [sizes[i, j].max() for i, j in ring if 0 <= i < rows and 0 <= j < cols]
        shares.append(float(max(inside, default=0.0) / sizes[row, col].max()))
    return tuple(shares)


def fitted_decay_mm(spaced: Sequence[Spaced], from_mm: float) -> float:
    """λ of the law exp(−r/λ)/√r that fits the electrodes inside the array best from a distance on [mm].

    All pitches together, of the paper's unit alone: those narrowed to fit have another displacement of their own. Units
    on the rim are left out: beside a free side the body is softer, and the law is that of a layer without sides.
    """
    widest = max(one.span_mm for one in spaced)
    chosen = [one for one in spaced if one.span_mm == widest]
    r, moved, on_rim = (
        np.concatenate([getattr(one, name) for one in chosen]) for name in ("distance_mm", "moved", "on_rim")
    )
    far = (r >= from_mm) & ~on_rim
    slope, _ = np.polyfit(r[far], np.log(moved[far] * np.sqrt(r[far])), 1)
    return float(-1 / slope)


def lightest_touch(design: SensorDesign, asked: Asked) -> Touch:
    """The lightest touches that move some pillar's reading by more than noise, over all places in one pitch."""
    pitch_mm = design.array.pitch_mm
    steps = (np.arange(PLACES) / PLACES - 0.5) * pitch_mm
    middles = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    felt = strongest_reading(design, middles, asked.touch_mm)
    worst_n = {load: float(asked.sure * asked.noise / felt[:, axis].min()) for load, axis in LOADS.items()}
    return Touch(pitch_mm=pitch_mm, worst_n=worst_n)


def strongest_reading(design: SensorDesign, middles_mm: FloatArray, touch_mm: float) -> FloatArray:
    """Largest relative change of any pillar's resistance by touches on an endless array.

    Touches are squares about middles (n, 2), from the centre of a unit, on an endless layer of the matrix. Gives (n, 3)
    by a force along x, y and z [1/N]: 2 Δl/l, since R grows as l².
    """
    near = replace(design, array=Array(rows=2 * AROUND + 1, cols=2 * AROUND + 1, pitch_mm=design.array.pitch_mm))
    touches = np.hstack([middles_mm - touch_mm / 2, middles_mm + touch_mm / 2])
    compliance = layer_mean_compliance(
        electrode_squares(near)[:, None], touches, design.unit.height_mm, design.matrix_material
    )
    moved = compliance.reshape(near.n_units, len(design.unit.layout.upper), len(touches), 3, 3)
    along = pillar_vectors(design.unit) / rest_lengths(design.unit)[:, None] ** 2
    readings = 2 * np.einsum("pi,kpnij->kpnj", along, moved[:, design.unit.layout.pillar_top])
    strongest: FloatArray = np.abs(readings).max(axis=(0, 1))
    return strongest


def decay_length_mm(height_mm: float, poisson: float) -> float:
    """Distance λ over which what a load does to a layer's surface falls by e, far from the load.

    Displacements fall as exp(−r/λ)/√r; λ is 1.35 heights as ν → 0.5. Far away counts the pole of the spectrum that is
    nearest the real axis: D = 0 at q = i x, x the root of 2κ cos 2x = 4x² − 1 − κ², and λ = h/x. As ν → 0.5, κ → 1 it
    is that of cos x = x. What twists the surface about the load (the transverse part) falls faster, with x = π/2.

    >>> round(decay_length_mm(10.0, 0.49), 2)
    13.37
    """
    kappa = 3 - 4 * poisson
    x = brentq(lambda x: 2 * kappa * np.cos(2 * x) - 4 * x**2 + 1 + kappa**2, 0.0, np.pi / 2)
    return float(height_mm / x)
