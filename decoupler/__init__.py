"""From resistances to forces: networks, what they are held against, and the model file.

In: labelled samples. Out: a `Decoupler` (ohms in, newtons out), its errors, and one safetensors file. `readings` is how
pillars read, of every sensor. In the order of the data: `data` takes columns of resistances and forces from samples,
`rubber` finds what a rubber remembers, `inverse` turns the array's response around, `model` is the trained network and
its file, `training` trains it, `twin` identifies one sensor from pairs, `evaluation` says how large errors are,
`export` writes a model for other programs. `train` loads torch when it is asked for; nothing else does.
"""

from typing import TYPE_CHECKING

from common.lazy import lazily

if TYPE_CHECKING:
    from dataset.samples import SampleError
    from decoupler.data.columns import component_named
    from decoupler.evaluation.assessment import Assessment, assess
    from decoupler.evaluation.crossval import cross_validate
    from decoupler.evaluation.metrics import component_errors, evaluate, force_errors, pca_floor
    from decoupler.model.baseline import LeastSquares, hooke_forces
    from decoupler.model.decoupler import Decoupler
    from decoupler.model.settings import NetworkConfig, TrainingConfig, TrainingError
    from decoupler.model_file import model_cache_key, read_model, require_same_sensor, write_model
    from decoupler.training.trainer import train

__all__ = [
    "Assessment",
    "Decoupler",
    "LeastSquares",
    "NetworkConfig",
    "SampleError",
    "TrainingConfig",
    "TrainingError",
    "assess",
    "component_errors",
    "component_named",
    "cross_validate",
    "evaluate",
    "force_errors",
    "hooke_forces",
    "model_cache_key",
    "pca_floor",
    "read_model",
    "require_same_sensor",
    "train",
    "write_model",
]

__getattr__ = lazily(__name__)
