"""What one pad that is lightly touched reads as, and the rest of the array with it: the table for 0.1 to 20 N."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dataset import Imperfections
from decoupler.data.components import COMPONENTS, Component
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.limits import cramer_rao
from decoupler.model.decoupler import Decoupler
from fem.array.response import ArrayResponse
from geometry.layout import AXES, FloatArray
from tripillar.pipeline.manufactured import READ, SPECIMEN

TOUCHES_N = (0.1, 1.0, 5.0, 20.0)
REPEATS = 8  #: readings of every touch, each pad in turn
AT_REST = 32  #: readings with nothing on the sensor whose mean is taken for zero

Forces = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, kw_only=True)
class Touched:
    """Errors of the force on the one pad that is touched, root mean square over pads and readings [N]."""

    decoupler: str
    exact_n: tuple[float, ...]  #: by `TOUCHES_N`, exact readings
    read_n: tuple[float, ...]  #: the same with the noise and the converter of `READ`


def touches(
    decouplers: Mapping[str, Forces],
    ours: Decoupler,
    tuned: Decoupler,
    response: ArrayResponse,
    truth: ArrayResponse,
) -> list[Touched]:
    """Errors of decouplers by name on the sensor as designed, of ours on the sensor as made, and the readings' limit.

    `tuned` is ours after a few pairs of the specimen.
    """
    component = ours.component
    rows = [_touched(label, forces, response, Imperfections(), READ, component) for label, forces in decouplers.items()]
    exact = replace(SPECIMEN, noise=0.0, bits=None)
    for label, forces, zeroed in (
        ("ours, as made, untuned", ours.forces, False),
        ("ours, as made, tuned", tuned.forces, False),
        ("ours, as made, tuned, zeroed at rest", tuned.forces, True),
    ):
        rows.append(_touched(label, forces, truth, exact, SPECIMEN, component, zeroed))
    forward, n_units = ForwardModel.of(response, component), response.design.n_units
    limit = [
        float(np.sqrt(np.mean(cramer_rao(forward, size_n * np.eye(n_units), READ.noise, READ.bits).diagonal() ** 2)))
        for size_n in TOUCHES_N
    ]
    nothing = tuple(0.0 for _ in TOUCHES_N)
    return [*rows, Touched(decoupler="limit of the readings", exact_n=nothing, read_n=tuple(limit))]


def _touched(
    label: str,
    forces: Forces,
    sensor: ArrayResponse,
    exact: Imperfections,
    read: Imperfections,
    component: Component,
    zeroed: bool = False,
) -> Touched:
    """One row; `zeroed` takes the mean of readings at rest off all forces."""
    exactly, as_read = (
        _errors(forces, sensor, specimen, component, zeroed, repeats)
        for specimen, repeats in ((exact, 1), (read, REPEATS))
    )
    return Touched(decoupler=label, exact_n=exactly, read_n=as_read)


def _errors(
    forces: Forces, sensor: ArrayResponse, specimen: Imperfections, component: Component, zeroed: bool, repeats: int
) -> tuple[float, ...]:
    design = sensor.design
    rows, cols, n_units = design.array.rows, design.array.cols, design.n_units
    forward, generator = ForwardModel.of(sensor, COMPONENTS["all"]), np.random.default_rng(0)

    def predicted_n(force_n: FloatArray) -> FloatArray:
        ohms = forward.resistances(force_n.reshape(len(force_n), -1)).reshape(-1, rows, cols, len(AXES))
        return forces(specimen.apply(ohms, generator)).reshape(len(force_n), n_units)

    zero_n = predicted_n(np.zeros((AT_REST, n_units, len(AXES)))).mean(axis=0) if zeroed else 0.0
    pads = np.tile(np.arange(n_units), repeats)
    found = []
    for size_n in TOUCHES_N:
        force_n = np.zeros((len(pads), n_units, len(AXES)))
        force_n[np.arange(len(pads)), pads, AXES.index(component.axes[0])] = size_n
        missed = (predicted_n(force_n) - zero_n)[np.arange(len(pads)), pads] - size_n
        found.append(float(np.sqrt(np.mean(missed**2))))
    return tuple(found)
