"""Parts of a decoupler with tensors of torch: the same computation, with derivatives."""

from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoupler import Decoupler
from decoupler.model.left_out import first_filled
from geometry.design import SensorDesign
from geometry.layout import Layout

if TYPE_CHECKING:
    from torch import Tensor


def in_torch(part: Any, like: "Tensor") -> Any:
    """A decoupler, its forward model or another part with tensors of the type and device of `like`.

    What it computes of tensors (n, ...) then are tensors; what it checks of arrays cannot be asked.
    """
    if isinstance(part, SensorModel):
        part = part.with_own_influences()
    changed: dict[str, Any] = {}
    for spec in fields(part):
        value = getattr(part, spec.name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            changed[spec.name] = like.new_tensor(value)
        elif is_dataclass(value) and not isinstance(value, SensorDesign | Layout | type):
            changed[spec.name] = in_torch(value, like)
    return replace(part, **changed)


def decoded_by(decoder: Decoupler, tensors: Any, columns_ohm: "Tensor") -> Any:
    """Forces (n, Q) [N] of readings (n, P) [Ω] by a decoder that does without some, and the whole one of `in_torch`.

    What stands in the places of those has derivatives by the others as they foretell it, what the response adds none.
    """
    plain = columns_ohm.detach().cpu().double().numpy()
    if decoder.filling is not None:
        first = first_filled(in_torch(decoder.filling.foretold, columns_ohm), columns_ohm)
        columns_ohm = first * (first.new_tensor(decoder.filling.filled(plain)) / first.detach())
    if not isinstance(decoder, DecouplerAtStrain):
        return tensors.first_answers(columns_ohm)
    read, unsure_n = decoder.doubts(columns_ohm.detach().cpu().double().numpy())
    unsure = None if unsure_n is None else columns_ohm.new_tensor(unsure_n)
    return tensors.refined(columns_ohm, doubts=(read, unsure))[0]
