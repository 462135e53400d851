"""Parts of a decoupler in torch: the same computation on tensors, with derivatives. Loads torch."""

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from torch import Tensor

from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.decoupler import Decoupler
from geometry.design import SensorDesign
from geometry.errors import DesignError


def in_torch(part: Any, like: Tensor) -> Any:
    """A decoupler, its forward model or another part with tensors in the place of real arrays.

    Parameters
    ----------
    part : dataclass
        What it computes of tensors (n, ...) then are tensors; what it checks of arrays cannot be asked.
    like : Tensor
        Its type and device are those of all tensors.

    Raises
    ------
    DesignError
        If it is a model that learned from samples at finite strain.
    """
    if isinstance(part, SensorModel):
        part = part.with_own_influences()
    if isinstance(part, Decoupler):
        if part.posterior is not None:
            raise DesignError(
                "a model of finite strain is not known in torch yet: give one that was trained on linear samples."
            )
        part = replace(part, uncertainty=None, usual=None, ensemble=None, least_squares=None)
    changed: dict[str, Any] = {}
    for spec in fields(part):
        value = getattr(part, spec.name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            changed[spec.name] = like.new_tensor(value)
        elif is_dataclass(value) and not isinstance(value, SensorDesign | type):
            changed[spec.name] = in_torch(value, like)
    return replace(part, **changed)
