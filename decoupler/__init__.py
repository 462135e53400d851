"""From resistances to forces: networks, what they are measured against, and the model file.

In: labelled data. Out: a `Decoupler` (ohms in, newtons out), its errors, and one safetensors file. Open
`decoupler.py` first, then `settings.py`; training is `decoupler.training.trainer.train`, whose algebra is in
`gauss_newton.py`. The names below load no torch; import `decoupler.training.trainer` where a network is trained.
"""

from decoupler.data.components import COMPONENTS, Component, component_named
from decoupler.data.errors import SampleError, TrainingError
from decoupler.evaluation.assessment import Assessment, Limits, assess
from decoupler.evaluation.crossval import Fold, cross_validate
from decoupler.evaluation.floor import PcaFloor, pca_floor
from decoupler.evaluation.metrics import ForceErrors, component_errors, evaluate, force_errors
from decoupler.model.baseline import LeastSquares, hooke_forces
from decoupler.model.decoupler import Decoupler
from decoupler.model.model_file import model_recipe, read_model, require_same_sensor, write_model
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.training.fine_tuning import fine_tune

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
