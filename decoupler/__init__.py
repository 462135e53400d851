"""From resistances to forces: networks, what they are measured against, and the model file.

In: labelled data. Out: a `Decoupler` (ohms in, newtons out), its errors, and one safetensors file. Open
`decoupler.py` first, then `settings.py`; training is `decoupler.training.train`, whose algebra is in
`gauss_newton.py`. The names below load no torch; import `decoupler.training` where a network is trained.
"""

from decoupler.assessment import Assessment, Limits, assess
from decoupler.baseline import LeastSquares, hooke_forces
from decoupler.components import COMPONENTS, Component, component_named
from decoupler.crossval import Fold, cross_validate
from decoupler.decoupler import Decoupler
from decoupler.errors import SampleError, TrainingError
from decoupler.fine_tuning import fine_tune
from decoupler.floor import PcaFloor, pca_floor
from decoupler.metrics import ForceErrors, component_errors, evaluate, force_errors
from decoupler.model_file import model_recipe, read_model, require_same_sensor, write_model
from decoupler.settings import NetworkConfig, TrainingConfig

__all__ = [
    "COMPONENTS",
    "Assessment",
    "Component",
    "Decoupler",
    "Fold",
    "ForceErrors",
    "LeastSquares",
    "Limits",
    "NetworkConfig",
    "PcaFloor",
    "SampleError",
    "TrainingConfig",
    "TrainingError",
    "assess",
    "component_errors",
    "component_named",
    "cross_validate",
    "evaluate",
    "fine_tune",
    "force_errors",
    "hooke_forces",
    "model_recipe",
    "pca_floor",
    "read_model",
    "require_same_sensor",
    "write_model",
]
