"""From resistances to forces: networks, what they are measured against, and the model file.

In: labelled data. Out: a `Decoupler` (ohms in, newtons out), its errors, and one safetensors file. Open
`decoupler.py` first, then `settings.py`; training is `decoupler.training.train`, whose algebra is in
`gauss_newton.py`. The names below load no torch; import `decoupler.training` where a network is trained.
"""

from decoupler.baseline import LeastSquares, hooke_forces
from decoupler.components import COMPONENTS, Component, component_named
from decoupler.decoupler import Decoupler
from decoupler.errors import SampleError, TrainingError
from decoupler.floor import PcaFloor, pca_floor
from decoupler.metrics import ForceErrors, component_errors, evaluate, force_errors
from decoupler.model_file import model_recipe, read_model, require_same_sensor, write_model
from decoupler.settings import NetworkConfig, TrainingConfig

__all__ = [
    "COMPONENTS",
    "Component",
    "Decoupler",
    "ForceErrors",
    "LeastSquares",
    "NetworkConfig",
    "PcaFloor",
    "SampleError",
    "TrainingConfig",
    "TrainingError",
    "component_errors",
    "component_named",
    "evaluate",
    "force_errors",
    "hooke_forces",
    "model_recipe",
    "pca_floor",
    "read_model",
    "require_same_sensor",
    "write_model",
]
