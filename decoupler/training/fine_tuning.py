"""From a model of the sensor as designed to one of the sensor on the table, by a few measured pairs."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dataset import Samples
from dataset.samples import SampleError, require_samples
from decoupler.data.columns import Calibration, Resting, force_columns
from decoupler.data.repeats import distinct, load_numbers
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.sample_checks import without_stuck
from decoupler.model.decoupler import Decoupler
from decoupler.training.error_bars import best_ridge, widened
from geometry.errors import require_type
from geometry.layout import PILLARS
from geometry.storage.files import digest

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

MIN_PAIRS = 10  #: below which the output layer stays as it is: its errors could not be judged


def fine_tune(decoupler: Decoupler, pairs: Samples, response: "ArrayResponse | None" = None) -> Decoupler:
    """Fit a model to the sensor that the pairs were measured on.

    Parameters
    ----------
    decoupler : Decoupler
        Trained on simulated data.
    pairs : Samples
        Measured resistances and the forces that caused them; one is enough to begin with; one given twice counts once.
    response : ArrayResponse, optional
        Of the sensor as designed; not needed if the model holds one.

    Raises
    ------
    SampleError
        If the response is unknown, of another array, a resistance or force is no number, or a pillar that the model
        leans on does not follow its loads.

    Notes
    -----
    First gain and offset of every pillar (`calibration`). Then, from `MIN_PAIRS` on, the output layer: its deviation
    from the simulated one by ridge regression, kept only where the errors of pairs left out fall.
    """
    require_type("decoupler", decoupler, Decoupler, "train one, or read a model file")
    require_samples("pairs", pairs)
    component = decoupler.component
    if decoupler.inverse is not None:
        forward = decoupler.inverse.forward
    elif response is not None:
        forward = ForwardModel.of(response, component)
    else:
        raise SampleError("fine-tuning needs the array's response, and none is known: state the design in the data.")
    given, pairs = pairs, distinct(pairs, component)
    columns, forces = decoupler.columns(pairs.resistance_ohm), force_columns(pairs.force_n, component)
    if forces.shape[1] != forward.n_forces:
        raise SampleError(f"the pairs hold {forces.shape[1]} forces, the model {forward.n_forces}: measure this array.")
    _require_alive(pairs, decoupler, forward)
    calibration = Calibration.fitted(columns, forward.resistances(forces), pairs.noise)
    resting = Resting.read_with(calibration.shown(forward.at_rest_ohm()), pairs.bits)
    tuned = replace(decoupler, calibration=calibration, resting=resting)
    load = load_numbers(pairs.force_n)
    if len(forces) >= MIN_PAIRS and load.any():  # readings of one load alone cannot judge each other
        tuned = _nearer(tuned, columns, forces, load)
    noise = pairs.noise * np.sqrt(1.0 + 2.0 / len(forces))  # gain and offset are only as good as the pairs
    tuned = widened(tuned, columns, forces, noise, pairs.bits)
    story = {"fine_tuned_on": given.content_hash, "pairs": len(given.force_n)}
    recipe = digest(decoupler.made_from.get("recipe"), given.content_hash, pairs.noise)
    return replace(tuned, made_from=decoupler.made_from | story | {"recipe": recipe})


def _require_alive(pairs: Samples, decoupler: Decoupler, forward: ForwardModel) -> None:
    """Refuse pairs of a sensor with a stuck pillar: no gain and offset make it tell its load."""
    known = np.zeros(pairs.resistance_ohm.shape[1:], dtype=bool) if decoupler.dead is None else decoupler.dead
    found = without_stuck(replace(pairs, dead=known), decoupler.component, forward).dead
    for row, col, pillar in np.argwhere(found & ~known)[:1]:
        raise SampleError(
            f"pillar {row},{col},{PILLARS[pillar]} does not follow the loads of the pairs, and the model leans on it: "
            f"mend it, or train a model on data that name {row},{col},{PILLARS[pillar]} among their dead_pillars."
        )


def _nearer(decoupler: Decoupler, columns_ohm: np.ndarray, force_n: np.ndarray, load: np.ndarray) -> Decoupler:
    """The model with another output layer if that lowers the errors of pairs left out, else itself."""
    A = decoupler.activations(columns_ohm)
    missing = decoupler.output_scaling.scale(force_n) - A @ decoupler.output_weights.T
    M = A.T @ A
    M.flat[:: len(M) + 1] += best_ridge(A, missing, len(load) / (load.max() + 1))
    solved = np.linalg.solve(M, A.T)  # (n_features, n_pairs)
    errors = missing - A @ (solved @ missing)
    left_out = np.empty_like(errors)
    for one in np.split(np.argsort(load, kind="stable"), np.cumsum(np.bincount(load))[:-1]):
        # exact for a given ridge, however near 1 the leverage is; pairs of one load are left out together
        left_out[one] = np.linalg.solve(np.eye(len(one)) - A[one] @ solved[:, one], errors[one])
    if np.sum(left_out**2) >= np.sum(missing**2):
        return decoupler
    return replace(decoupler, output_weights=decoupler.output_weights + (solved @ missing).T)
