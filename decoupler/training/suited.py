"""The component, the network and the training that suit samples, where none are given. Loads no torch."""

from typing import TYPE_CHECKING

from dataset.samples import SampleError, Samples, require_samples
from decoupler.data.columns import Component, component_named, force_columns, pillar_columns, readable_columns
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.sample_checks import explaining, without_stuck
from decoupler.model.settings import Feature, Net, NetworkConfig, TrainingConfig
from geometry.errors import require_type
from geometry.layout import AXES

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse


def suited_component(data: Samples) -> str:
    """The name of the component for the forces that act: fz, fx or fy if they are along one axis alone, else all.

    >>> import numpy as np
    >>> pressed = np.zeros((2, 1, 1, 3)) + [0.0, 0.0, 5.0]
    >>> suited_component(Samples(force_n=pressed, resistance_ohm=1e4 + 0 * pressed))
    'fz'
    """
    acting = [axis for number, axis in enumerate(AXES) if data.force_n[..., number].any()]
    return f"f{acting[0]}" if len(acting) == 1 else "all"


def suited_feature(data: Samples, component: Component, net: Net, response: "ArrayResponse | None") -> Feature:
    """`inverse` for a skip net if the response explains the samples, else `root`."""
    if net != "skip" or response is None or data.is_finite.any():
        return "root"
    data = without_stuck(data, component, ForwardModel.of(response, component))
    columns_ohm = pillar_columns(data.resistance_ohm, component, data.dead)
    force_n = force_columns(data.force_n, component)
    try:
        explaining(
            response, component, columns_ohm, force_n, readable_columns(component, data.dead, columns_ohm.shape[1])
        )
    except SampleError:
        return "root"
    return "inverse"


def suited_training(
    data: Samples,
    component: str | None,
    network: NetworkConfig | None,
    training: TrainingConfig | None,
    response: "ArrayResponse | None",
) -> tuple[Component, NetworkConfig, TrainingConfig]:
    """Complete what a training is asked for with what suits the samples where None is given.

    Raises
    ------
    ArgumentError
        If an argument is of another type.
    """
    require_samples("data", data)
    if network is not None:
        require_type("network", network, NetworkConfig, "give its form, or None for one that suits the samples")
    if training is not None:
        require_type("training", training, TrainingConfig, "say how to train, or give None")
    parts = component_named(suited_component(data) if component is None else component)
    if network is None:
        network = NetworkConfig(feature=suited_feature(data, parts, "skip", response))
    return parts, network, TrainingConfig() if training is None else training
