"""Decouplers side by side on one set of test samples, beside what the paper reports."""

from dataclasses import dataclass
from typing import Any

from dataset.labelled import LabelledData
from decoupler.baseline import HOOKE, LINEAR, LeastSquares, hooke_forces
from decoupler.decoupler import Decoupler
from decoupler.floor import pca_floor
from decoupler.forward_model import ForwardModel
from decoupler.light_touch import light_touch
from decoupler.metrics import ForceErrors, component_errors
from fem.response import ArrayResponse
from studies.manufactured import errors_as_made
from studies.paper.printed import MEAN_OVER_WIDTHS

PAPER_CAP = 0.3  #: strain of the paper's data beside which ours are set


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One decoupler's errors on the test samples."""

    decoupler: str
    errors: ForceErrors
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
    entries: list[Entry]


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
    narrow = min(model.network.hidden for model in models.values() if model.network.net == "plain")
    (name,) = component.forces
    predictions = {}
    if test.design is not None:
        predictions[HOOKE] = hooke_forces(test.resistance_ohm, test.design, component)
    predictions[LINEAR] = LeastSquares.fitted(training, component).forces(test.resistance_ohm)
    predictions |= {label: model.forces(test.resistance_ohm) for label, model in models.items()}
    forward = ForwardModel.of(response, component)
    at_rest = {label: light_touch(model, forward, 0.0, None)[name].at_rest_rmse_n for label, model in models.items()}
    made = errors_as_made(models, truth, response, protocol, len(test.force_n))
    return Comparison(
        protocol=protocol,
        component=name,
        paper_rel_err=MEAN_OVER_WIDTHS[PAPER_CAP][name] / 100,
        plain_floor=pca_floor(test.force_n, component, narrow).projection[name],
        floor_hidden=narrow,
        entries=[
            Entry(
                decoupler=label,
                errors=component_errors(forces, test, component)[name],
                at_rest_n=at_rest.get(label),
                as_made=made[label].untuned[name] if label in made else None,
                as_made_tuned=made[label].tuned[name] if label in made else None,
                made_from=models[label].made_from if label in models else {},
            )
            for label, forces in predictions.items()
        ],
    )
