"""Parts of a decoupler in torch: the same computation on tensors, with derivatives. Loads torch."""

from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from torch import Tensor

from decoupler.inverse.forward_model import ForwardModel
from decoupler.model.decoupler import Decoupler
from geometry.design import SensorDesign
from geometry.errors import DesignError

Part = TypeVar("Part")


def in_torch(part: Part, like: Tensor) -> Part:
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
    given: Any = part
    if isinstance(given, ForwardModel):
        given = given.with_own_influences()
    if isinstance(given, Decoupler):
        if given.posterior is not None:
            raise DesignError(
                "a model of finite strain is not known in torch yet: give one that was trained on linear samples."
            )
        given = replace(given, uncertainty=None, usual=None, ensemble=None, least_squares=None)
    changed: dict[str, Any] = {}
    for spec in fields(given):
        value = getattr(given, spec.name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            changed[spec.name] = like.new_tensor(value)
        elif is_dataclass(value) and not isinstance(value, SensorDesign | type):
            changed[spec.name] = in_torch(value, like)
    found: Part = replace(given, **changed)
    return found
