"""The same loads at finite strain on designs of which one parameter is a deviation off, as a specimen's may be."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dataset.finite_strain import METHOD, require_finite
from dataset.resistance import pillar_lengths
from fem.array.response import ArrayResponse
from fem.finite.samples import SampleSolver
from geometry.design import Electrics, SensorDesign
from geometry.layout import FloatArray, pillar_volumes
from geometry.storage.cache import kept, read_arrays, write_arrays
from geometry.storage.files import digest
from geometry.tolerances import RESISTIVITY, changed, usual_deviations

YOUNG = ("rubber.young_mpa", "matrix_material.young_mpa")  #: the modulus that loads are in proportion to
VERSION = 1  #: raise when the same designs give other answers


def parameters_that_bend(response: ArrayResponse) -> dict[str, float]:
    """Uncertain parameters of a design and their deviations but for those that scale all loads or all resistances."""
    deviations = usual_deviations(response.design)
    return {name: value for name, value in deviations.items() if name not in (*YOUNG, RESISTIVITY)}


def on_changed_designs(
    response: ArrayResponse, force_n: FloatArray, progress: Callable[[str, float], None] = lambda name, share: None
) -> dict[str, tuple[FloatArray, FloatArray, NDArray[np.bool_]]]:
    """Answers of designs with one parameter a deviation off, from the cache if they are there.

    Parameters
    ----------
    response : ArrayResponse
        Of the design as meant, stiff pads on one rubber.
    force_n : array, shape (m, k, 3)
        Along x, y, z; z negative pushes down [N].
    progress : callable
        Takes each parameter that is done, and its share of the work.

    Returns
    -------
    dict
        By parameter, and "" for the design as meant: displacements of the electrodes (m, k, 2, 3) [mm]; squares of the
        lengths that eq. 1 of the design as meant needs for the resistances, (m, k, 3) [mm²]; which are answers, (m,).
    """
    require_finite(response.design)
    found = {}
    grids = None
    designs = {"": 0.0, **parameters_that_bend(response)}
    for name, deviation in designs.items():

        def solved(name: str = name, deviation: float = deviation) -> dict[str, FloatArray]:
            nonlocal grids
            grids = _grid_influence(response.design) if grids is None else grids
            return _solved(response, name, deviation, force_n, grids)

        key = digest(
            "changed designs", VERSION, METHOD, response.content_hash, response.design, name, deviation, force_n
        )
        arrays, _, _ = kept("changed.npz", key, solved, read_arrays, write_arrays)
        progress(name or "the design", 1.0 / len(designs))
        found[name] = arrays["displacement_mm"], arrays["squares_mm2"], arrays["settled"].astype(bool)
    return found


def _solved(
    response: ArrayResponse, name: str, deviation: float, force_n: FloatArray, grids: FloatArray
) -> dict[str, FloatArray]:
    """The accurate response of the design, and what the grids of samples say of the change, make the other design's."""
    design = response.design
    other = changed(design, name, deviation) if name else design
    influence = response.influence_mm_per_n.reshape(grids.shape) + _grid_influence(other) - grids
    with threadpool_limits(1, "blas"):
        answers = SampleSolver(other, influence).displacements(force_n)
    lengths = pillar_lengths(answers.displacement_mm, other.unit)
    volumes = pillar_volumes(design.unit) / pillar_volumes(other.unit)
    return {
        "displacement_mm": answers.displacement_mm,
        "squares_mm2": lengths**2 * answers.resistance_ratio * volumes,
        "settled": answers.settled.astype(float),
    }


def _grid_influence(design: SensorDesign) -> FloatArray:
    """Influence matrix of an array by the finer grid of samples, (k, 2, 3, k, 3) [mm/N]."""
    k = design.n_units
    return SampleSolver(replace(design, electrics=Electrics())).fine.influence.reshape(k, 2, 3, k, 3)
