"""From labelled data to a trained `Decoupler`."""

from dataclasses import replace
from typing import TYPE_CHECKING

from common.threads import one_blas_thread
from dataset.samples import AnySamples
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig, Progress, TrainingConfig
from decoupler.model_file import model_cache_key
from decoupler.training.finite_strain import trained_at_strain
from decoupler.training.fitting import fitted_network
from decoupler.training.suited import suited

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse


@one_blas_thread()  # on matrices this small two are slower
def train(
    data: AnySamples,
    component: str | None = None,
    network: NetworkConfig | None = None,
    training: TrainingConfig | None = None,
    progress: Progress = lambda *_: None,
    response: "ArrayResponse | None" = None,
    judged: bool = True,
) -> Decoupler:
    """Train one network on all samples of `data`; leave test samples out beforehand.

    Parameters
    ----------
    data : Samples or StoredSamples
        At least two samples that differ; one that is given twice counts once.
    component : str, optional
        fz, fx, fy or all; default: the forces that act.
    network : NetworkConfig, optional
        Default: a skip net of 17 hidden nodes; its feature `auto` starts from a response that explains the data.
    training : TrainingConfig, optional
    progress : callable
        Called as progress(iteration, mse) once an iteration; mse is of the outputs scaled to [-1, 1].
    response : ArrayResponse, optional
        Of the sensor; the feature `inverse` needs it, `auto` takes it if it explains the data.
    judged : bool
        Find the uncertainty of its forces, too, which takes a third of the time.

    Raises
    ------
    ArgumentError, DesignError
        If an argument is of another type, or the component is unknown.
    SampleError
        If there are too few samples, a resistance or force is no number, or the response that the feature needs is
        missing or does not explain the samples.
    TrainingError
        If the momentum rule's learning rate makes the error grow without bound.

    Notes
    -----
    Readings are given the drifts that the design states, where they have less. Of more than `ENOUGH` samples a random
    draw is learned from: more would change the errors by half a percent.
    """
    known = suited(data, component, network, training, response)
    few, name = known.samples, known.columns.component.name
    assert few is not None
    if few.is_finite.any() and name == "all" and response is not None:
        few = few[few.is_finite]
        trained: Decoupler = trained_at_strain(few, response, known.training, progress)
    else:
        trained = fitted_network(known, progress, judged)
    story = {
        "recipe": model_cache_key(data, name, network or NetworkConfig(), known.training, response),
        "data_hash": data.content_hash,
        "n_samples": len(few),
    }
    of_data = {name: few.made_from[name] for name in ("twin", "protocol") if name in few.made_from}
    return replace(trained, made_from=of_data | trained.made_from | story)
