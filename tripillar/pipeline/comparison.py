"""Decouplers side by side on the same test samples, beside the errors that the paper prints.

Every decoupler reads exact samples, the same samples through noise and converter, and the sensor at rest. Networks also
read a sensor as made (`manufactured.py`), which is also identified from a few pairs, and single pads touched by 0.1 to
20 N.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from dataset import Imperfections, Samples
from dataset.measurement import ReadingError
from decoupler.data.columns import COMPONENTS, Columns, Component
from decoupler.data.pairs import Pairs
from decoupler.evaluation.assessment import light_touches
from decoupler.evaluation.metrics import ForceErrors, component_errors, evaluate, pca_floor
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.baseline import HOOKE, LINEAR, LeastSquares, hooke_forces
from decoupler.model.decoupler import Decoupler
from decoupler.twin.identification import identify
from fem.array.response import ArrayResponse
from fem.array.sensitivities import ResponseSensitivities
from geometry.layout import AXES, FloatArray
from tripillar.pipeline.manufactured import PAIRS, PAIRS_SEED, READ, SPECIMEN, TEST_SEED, measured_on
from tripillar.pipeline.printed import MEAN_OVER_WIDTHS

PAPER_CAP = 0.3  #: largest strain of the paper's data that ours are compared with
TOUCHES_N = (0.1, 1.0, 5.0, 20.0)
REPEATS = 8  #: readings of every touch on each pad
AT_REST = 32  #: readings without a load whose mean is the zero

Forces = Callable[[FloatArray], FloatArray]  #: from resistances (n, rows, cols, 3) [Ω] to forces [N]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Errors of one decoupler on the test samples."""

    decoupler: str
    errors: ForceErrors  #: of exact readings
    as_read: ForceErrors  #: of the same samples with noise of 0.1 % and 12 bits
    at_rest_n: float | None  #: root mean square error without a load [N]; None except for networks
    as_made: ForceErrors | None  #: on the sensor as made; None except for networks
    identified: ForceErrors | None  #: the same of the decoder identified from a few pairs; None except for our network
    made_from: dict[str, Any]  #: training settings of a network; empty for the others


@dataclass(frozen=True, kw_only=True)
class TouchErrors:
    """Error of the force on the one pad that is touched, root mean square over pads and readings [N]."""

    decoupler: str
    exact_n: tuple[float, ...]  #: by `TOUCHES_N`, exact readings
    read_n: tuple[float, ...]  #: the same with the noise and the converter of `READ`


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All decouplers on the test samples of one protocol."""

    protocol: str
    component: str
    paper_rel_err: float  #: printed in the paper, as a fraction
    plain_floor: ForceErrors  #: least error of any projection of the test forces on `floor_hidden` directions
    floor_hidden: int
    full_scale_n: float  #: largest force on a pad
    entries: list[Entry]
    touches: list[TouchErrors]


def compare(
    protocol: str,
    training: Samples,
    test: Samples,
    models: dict[str, Decoupler],
    response: ArrayResponse,
    sensitivities: ResponseSensitivities,
    truth: ArrayResponse,
) -> Comparison:
    """Errors of networks and of the two baselines that they must beat: eq. 8, and least squares on √R.

    `response` is that of the sensor as designed, which made the data, with its derivatives; `truth` that of the sensor
    as made.
    """
    component = next(iter(models.values())).component
    paper = next(label for label, model in models.items() if model.network.net == "plain")
    ours = next(label for label, model in models.items() if model.inverse is not None)
    narrow = models[paper].network.hidden
    (name,) = component.forces
    least_squares = LeastSquares.fitted(Columns.of(training, component))
    decouplers: dict[str, Forces] = {}
    if test.design is not None:
        decouplers[HOOKE] = partial(hooke_forces, design=test.design, component=component)
    decouplers[LINEAR] = least_squares.forces
    decouplers |= {label: model.forces for label, model in models.items()}
    read_ohm = READ.apply(test.resistance_ohm, np.random.default_rng(0))
    errors, as_read = (
        {label: component_errors(forces(ohm), test, component)[name] for label, forces in decouplers.items()}
        for ohm in (test.resistance_ohm, read_ohm)
    )
    forward = SensorModel.of(response, component)
    at_rest = {
        label: light_touches(model, forward, ReadingError())[name].at_rest_rmse_n for label, model in models.items()
    }
    made, pairs = (
        measured_on(truth, response.design, protocol, samples, seed)
        for samples, seed in ((len(test), TEST_SEED), (PAIRS, PAIRS_SEED))
    )
    identified = identify(Pairs.of(pairs), response, sensitivities, component.name).decoder
    as_made = {label: evaluate(model, made)[name] for label, model in models.items()}
    return Comparison(
        protocol=protocol,
        component=name,
        paper_rel_err=MEAN_OVER_WIDTHS[PAPER_CAP][name] / 100,
        plain_floor=pca_floor(test.force_n, component, narrow).projection[name],
        floor_hidden=narrow,
        full_scale_n=float(np.abs(test.force_n).max()),
        entries=[
            Entry(
                decoupler=label,
                errors=errors[label],
                as_read=as_read[label],
                at_rest_n=at_rest.get(label),
                as_made=as_made.get(label),
                identified=evaluate(identified, made)[name] if label == ours else None,
                made_from=models[label].made_from if label in models else {},
            )
            for label in decouplers
        ],
        touches=touches(
            {LINEAR: least_squares.forces} | {label: models[label].forces for label in (paper, ours)},
            models[ours],
            identified,
            response,
            truth,
        ),
    )


def touches(
    decouplers: Mapping[str, Forces],
    ours: Decoupler,
    identified: Decoupler,
    response: ArrayResponse,
    truth: ArrayResponse,
) -> list[TouchErrors]:
    """Errors of single touches: decouplers by name on the sensor as designed, ours on the sensor as made.

    `ours` was trained on the sensor as designed, `identified` from a few pairs. The last row is the Cramér-Rao limit of
    the readings.
    """
    component = ours.component
    exact = replace(SPECIMEN, noise=0.0, bits=None)
    trials = [(name, forces, response, Imperfections(), READ, False) for name, forces in decouplers.items()]
    trials += [
        ("ours, as made, untuned", ours.forces, truth, exact, SPECIMEN, False),
        ("ours, as made, identified", identified.forces, truth, exact, SPECIMEN, False),
        ("ours, as made, identified, zeroed at rest", identified.forces, truth, exact, SPECIMEN, True),
    ]
    rows = [
        TouchErrors(
            decoupler=name,
            exact_n=_touch_errors(forces, sensor, exactly, component, zeroed, repeats=1),
            read_n=_touch_errors(forces, sensor, as_read, component, zeroed, REPEATS),
        )
        for name, forces, sensor, exactly, as_read, zeroed in trials
    ]
    forward, unit_loads = SensorModel.of(response, component), np.eye(response.design.n_units)
    bounds = (cramer_rao(forward, size_n * unit_loads, READ.noise, READ.bits) for size_n in TOUCHES_N)
    limit = tuple(float(np.sqrt(np.mean(bound.diagonal() ** 2))) for bound in bounds)
    return [*rows, TouchErrors(decoupler="limit of the readings", exact_n=(0.0,) * len(TOUCHES_N), read_n=limit)]


def _touch_errors(
    forces: Forces, sensor: ArrayResponse, specimen: Imperfections, component: Component, zeroed: bool, repeats: int
) -> tuple[float, ...]:
    """Errors [N] by `TOUCHES_N`; with `zeroed` the mean force at rest is subtracted."""
    design = sensor.design
    n_units = design.n_units
    forward, generator = SensorModel.of(sensor, COMPONENTS["all"]), np.random.default_rng(0)

    def predicted_n(force_n: FloatArray) -> FloatArray:
        ohms = forward.resistances(force_n.reshape(len(force_n), -1))
        ohms = ohms.reshape(-1, design.array.rows, design.array.cols, len(AXES))
        return forces(specimen.apply(ohms, generator)).reshape(len(force_n), n_units)

    zero_n = predicted_n(np.zeros((AT_REST, n_units, len(AXES)))).mean(axis=0) if zeroed else 0.0
    pads = np.tile(np.arange(n_units), repeats)
    readings = np.arange(len(pads))
    found = []
    for size_n in TOUCHES_N:
        force_n = np.zeros((len(pads), n_units, len(AXES)))
        force_n[readings, pads, AXES.index(component.axes[0])] = size_n
        missed = (predicted_n(force_n) - zero_n)[readings, pads] - size_n
        found.append(float(np.sqrt(np.mean(missed**2))))
    return tuple(found)
