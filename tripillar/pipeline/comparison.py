"""Decouplers side by side on one set of test samples, beside what the paper reports."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from dataset.samples import LabelledData
from decoupler.evaluation.floor import pca_floor
from decoupler.evaluation.light_touch import light_touch
from decoupler.evaluation.metrics import ForceErrors, component_errors
from decoupler.inverse.forward_model import ForwardModel
from decoupler.model.baseline import HOOKE, LINEAR, LeastSquares, hooke_forces
from decoupler.model.decoupler import Decoupler
from fem.array.response import ArrayResponse
from tripillar.pipeline.manufactured import READ, errors_as_made
from tripillar.pipeline.printed import MEAN_OVER_WIDTHS
from tripillar.pipeline.touches import Forces, Touched, touches

PAPER_CAP = 0.3  #: strain of the paper's data beside which ours are set


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One decoupler's errors on the test samples."""

    decoupler: str
    errors: ForceErrors  #: of exact readings
    as_read: ForceErrors  #: of the same samples with noise of 0.1 % and 12 bits
    at_rest_n: float | None  #: root mean square with nothing on the sensor [N]; None of what is no network
    as_made: ForceErrors | None  #: on the sensor as manufacturing would make it
    as_made_tuned: ForceErrors | None  #: the same after a few measured pairs
    made_from: dict[str, Any]  #: how a network was trained; empty for the others


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All decouplers on one protocol's test samples."""

    protocol: str
    component: str
    paper_rel_err: float  #: what the paper prints, mean over its widths, as a fraction
    plain_floor: ForceErrors  #: what the best projection of the test forces on 17 directions leaves
    floor_hidden: int
    full_scale_n: float  #: largest force on a pad
    entries: list[Entry]
    touches: list[Touched]  #: what 0.1 to 20 N on one pad read as


def compare(
    protocol: str,
    training: LabelledData,
    test: LabelledData,
    models: dict[str, Decoupler],
    response: ArrayResponse,
    truth: ArrayResponse,
) -> Comparison:
    """Errors of networks and of the two marks they must beat: eq. 8, and least squares on √R.

    `response` is of the sensor as designed, which made the data; `truth` of the sensor as made (`manufactured`).
    """
    component = next(iter(models.values())).component
    paper = next(label for label, model in models.items() if model.network.net == "plain")
    ours = next(label for label, model in models.items() if model.inverse is not None)
    narrow = models[paper].network.hidden
    (name,) = component.forces
    least_squares = LeastSquares.fitted(training, component)
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
    forward = ForwardModel.of(response, component)
    at_rest = {label: light_touch(model, forward, 0.0, None)[name].at_rest_rmse_n for label, model in models.items()}
    made = errors_as_made(models, truth, response, protocol, len(test.force_n))
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
                as_made=made[label].untuned[name] if label in made else None,
                as_made_tuned=made[label].tuned[name] if label in made else None,
                made_from=models[label].made_from if label in models else {},
            )
            for label in decouplers
        ],
        touches=touches(
            {LINEAR: least_squares.forces} | {label: models[label].forces for label in (paper, ours)},
            models[ours],
            made[ours].tuned_model,
            response,
            truth,
        ),
    )
