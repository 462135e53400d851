"""A small sensor whose electrodes follow a made-up linear influence: near-diagonal, decaying with distance."""

from dataclasses import replace

import numpy as np

from dataset import Samples, pillar_lengths, pillar_resistances
from decoupler.data.columns import component_named
from fem.array.closed_forms import layer_response
from fem.array.response import ArrayResponse, ConductedPillars
from fem.array.sensitivities import ResponseSensitivities
from geometry import Array, SensorDesign
from geometry.design import Unit
from geometry.layout import AXES, LAYOUTS, FloatArray, Layout, pillar_ends, pillar_volumes, unit_centres
from geometry.tolerances import RESISTIVITY, changed, usual_deviations
from tests.fem.scenes import BESIDE

EVERY = {**LAYOUTS, "reference": BESIDE}  #: layouts by name, one of them with a pillar that no load reaches
ALL = component_named("all")
_RANGE_N = {"x": (29.0, 144.0), "y": (29.0, 144.0), "z": (144.0, 720.0)}  #: of independent pad loads


def sensor(rows: int = 6, cols: int = 6, layout: str = "song2018") -> SensorDesign:
    return SensorDesign(unit=Unit(layout=EVERY[layout]), array=Array(rows=rows, cols=cols))


def _own(layout: Layout) -> FloatArray:
    """Motion (n_upper, 3, 3) [mm/N] of electrodes along x, y, z by forces along x, y, z (last) on their own unit."""
    found = np.tile(np.diag([1.0e-2, 1.0e-2, 4e-3]), (len(layout.upper), 1, 1))
    for k, electrode in enumerate(layout.upper):  # pressed towards the middle, about which shear tilts the top
        found[k, :2, 2], found[k, 2, :2] = -2e-3 * np.array(electrode.place), -1e-3 * np.array(electrode.place)
    return found


def labelled(design: SensorDesign, axes: str, n_samples: int, seed: int) -> Samples:
    """Independent random forces along `axes` on every unit, and the resistances they cause."""
    generator = np.random.default_rng(seed)
    rows, cols = design.array.rows, design.array.cols
    force_n = np.zeros((n_samples, rows * cols, 3))
    for axis in axes:
        force_n[..., AXES.index(axis)] = generator.uniform(*_RANGE_N[axis], (n_samples, rows * cols))
    pushed = force_n * [1.0, 1.0, -1.0]  # compression moves electrodes along −z
    displacement_mm = np.einsum("kl,eij,nlj->nkei", _neighbour(design), _own(design.unit.layout), pushed)
    length_mm = pillar_lengths(displacement_mm, design.unit).reshape(n_samples, rows, cols, -1)
    resistance_ohm = pillar_resistances(length_mm, pillar_volumes(design.unit), design.resistivity_ohm_mm)
    return Samples(resistance_ohm=resistance_ohm, force_n=force_n.reshape(n_samples, rows, cols, 3), design=design)


def response(design: SensorDesign) -> ArrayResponse:
    """The influence that `labelled` uses."""
    rows, cols = design.array.rows, design.array.cols
    influence = np.einsum("kl,eij->keilj", _neighbour(design), _own(design.unit.layout))
    influence = influence.reshape(rows, cols, -1, 3, rows, cols, 3)
    return ArrayResponse(design=design, influence_mm_per_n=influence, residual=0.0, unknowns=0, seconds={})


def layer_sensitivities(design: SensorDesign) -> ResponseSensitivities:
    """Derivatives of the closed form of a layer by all uncertain parameters of its design, central differences."""
    by = {}
    for name, sd in usual_deviations(design).items():
        if name != RESISTIVITY:
            above, below = (layer_response(changed(design, name, step * sd)).influence_mm_per_n for step in (0.1, -0.1))
            by[name] = (above - below) / (0.2 * sd)
    return sensitivities(design, by)


def softness(design: SensorDesign) -> ResponseSensitivities:
    """Derivatives of `response` by the rubber's modulus alone."""
    return sensitivities(design, {"rubber.young_mpa": -response(design).influence_mm_per_n / 6.1})


def sensitivities(design: SensorDesign, by: dict[str, FloatArray]) -> ResponseSensitivities:
    """Of derivatives by parameters, with their usual deviations."""
    sd = usual_deviations(design)
    names, influence = tuple(by), np.stack(list(by.values()))
    deviation = np.array([sd[name] for name in by])
    return ResponseSensitivities(design=design, parameters=names, deviation=deviation, influence_mm_per_n=influence)


def _neighbour(design: SensorDesign) -> FloatArray:
    """How much of its displacement a unit passes on to each, (n_units, n_units)."""
    centres = unit_centres(design)
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1) / design.array.pitch_mm
    return np.where(distance == 0, 1.0, -0.15 * np.exp(1.0 - distance))  # incompressible: neighbours bulge


def noisy(data: Samples, noise: float) -> Samples:
    """The same samples, read with relative noise."""
    errors = np.random.default_rng(1).standard_normal(data.resistance_ohm.shape)
    return replace(data, resistance_ohm=data.resistance_ohm * (1 + noise * errors), noise=noise)


def split(data: Samples, n_train: int) -> tuple[Samples, Samples]:
    """The first `n_train` samples and the others."""
    return data[:n_train], data[n_train:]


SMALL = sensor(2, 3)  #: a sensor that does for most
RESPONSE = response(SMALL)


def conducted(factor: float) -> ArrayResponse:
    """The response with resistances as by conduction: eq. 1 with components turned, one more whose square counts −1."""
    B = RESPONSE.influence_mm_per_n[:, :, SMALL.unit.layout.pillar_top]  # (rows, cols, 3 pillars, 3, ...)
    d = np.broadcast_to(np.diff(pillar_ends(SMALL.unit), axis=1)[:, 0], B.shape[:4])
    turn = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))[0]
    more = factor * B[..., :1, :, :, :]
    return replace(
        RESPONSE,
        conducted=ConductedPillars(
            rest_mm=np.concatenate([d @ turn.T, 0 * d[..., :1]], axis=3),
            influence_mm_per_n=np.concatenate([np.einsum("kb,ijpbrca->ijpkrca", turn, B), more], axis=3),
            sign=np.broadcast_to([1.0, 1.0, 1.0, -1.0], (*d.shape[:3], 4)),
            error_estimate=0.0,
        ),
    )
