"""Decouplers side by side on the same test samples, beside the errors that the paper prints.

Every decoupler reads exact samples, the same samples through noise and converter, and the sensor at rest. Networks also
read a sensor as made (`manufactured.py`), which is also identified from a few pairs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from dataset import Samples
from decoupler.data.columns import Columns
from decoupler.data.pairs import Pairs
from decoupler.evaluation.metrics import ForceErrors, component_errors, evaluate, pca_floor
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.baseline import HOOKE, LINEAR, LeastSquares, hooke_forces
from decoupler.model.decoupler import Decoupler
from decoupler.twin.identification import identify
from fem.array.response import ArrayResponse
from fem.array.sensitivities import ResponseSensitivities
from geometry.layout import FloatArray
from tripillar.pipeline.manufactured import PAIRS, PAIRS_SEED, READ, TEST_SEED, measured_on

#: mean over the widths 10 to 19 for strains up to 0.3, printed in the paper, section 3.2
PAPER_REL_ERR = {"fz": 0.0198, "fx": 0.0302}

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
class Comparison:
    """All decouplers on the test samples of one protocol."""

    protocol: str
    component: str
    paper_rel_err: float  #: printed in the paper, as a fraction
    plain_floor: ForceErrors  #: least error of any projection of the test forces on `floor_hidden` directions
    floor_hidden: int
    full_scale_n: float  #: largest force on a pad
    entries: list[Entry]


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
    paper = next(label for label, model in models.items() if model.form.net == "plain")
    ours = next(label for label, model in models.items() if model.inverse is not None)
    narrow = models[paper].form.hidden
    (name,) = component.forces
    least_squares = LeastSquares.fitted(Columns.of(training, component))
    decouplers: dict[str, Forces] = {}
    if test.design is not None:
        decouplers[HOOKE] = partial(hooke_forces, design=test.design, component=component)
    decouplers[LINEAR] = least_squares.forces
    decouplers |= {label: model.forces for label, model in models.items()}
    read_ohm = READ.apply(test.resistance_ohm, np.random.default_rng(0), layout=test.layout)
    errors, as_read = (
        {label: component_errors(forces(ohm), test, component)[name] for label, forces in decouplers.items()}
        for ohm in (test.resistance_ohm, read_ohm)
    )
    rest_ohm = SensorModel.of(response, component).at_rest_ohm()[None]
    at_rest = {label: float(np.sqrt(np.mean(model.outputs(rest_ohm) ** 2))) for label, model in models.items()}
    made, pairs = (
        measured_on(truth, response.design, protocol, samples, seed)
        for samples, seed in ((len(test), TEST_SEED), (PAIRS, PAIRS_SEED))
    )
    identified = identify(Pairs.of(pairs), response, sensitivities, component.name).decoder
    as_made = {label: evaluate(model, made)[name] for label, model in models.items()}
    return Comparison(
        protocol=protocol,
        component=name,
        paper_rel_err=PAPER_REL_ERR[name],
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
    )
