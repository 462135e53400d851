"""From displaced electrodes to pillar lengths and resistances, geometrically exact."""

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from geometry.design import SensorDesign, Unit
from geometry.layout import FloatArray, pillar_areas, pillar_vectors, pillar_volumes, rest_lengths

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse, ConductedPillars


def pillar_lengths(displacement_mm: FloatArray, unit: Unit) -> FloatArray:
    """Length of the pillars (..., n_pillars) [mm] when electrodes have moved by (..., n_upper, 3) [mm] along x, y, z.

    The distance between the electrode centroids, not linearised; lower electrodes are clamped, references keep theirs.

    Examples
    --------
    >>> pillar_lengths(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]), Unit())[0]
    np.float64(9.0)
    """
    along = pillar_vectors(unit) + _tops(displacement_mm, unit)
    return np.sqrt(np.einsum("...k,...k->...", along, along))


def _tops(displacement_mm: FloatArray, unit: Unit) -> FloatArray:
    """How far the upper end of each pillar has moved, (..., n_pillars, 3) [mm]; that of a reference stays."""
    layout = unit.layout
    moved = displacement_mm[..., layout.pillar_top, :]
    if layout.body is not layout:
        moved *= np.array([[not one.reference] for one in layout.pillars])
    return moved


def pillar_strains(displacement_mm: FloatArray, length_mm: FloatArray, unit: Unit) -> FloatArray:
    """Size of every pillar's strain |l − l₀|/l₀, shape (..., n_pillars); infinite where a pillar has turned over.

    Takes displacements (..., n_upper, 3) [mm] and the lengths that `pillar_lengths` gives for them. A length is a
    distance: an electrode pushed through the base and out below it would pass for a small strain.
    """
    rest, rest_mm = pillar_vectors(unit), rest_lengths(unit)
    strain = np.abs(length_mm / rest_mm - 1.0)
    farthest_mm = max(displacement_mm.max(initial=0.0), -displacement_mm.min(initial=0.0))
    if farthest_mm * np.sqrt(3.0) < rest_mm.min():
        return strain  # no electrode has moved as far as a pillar is long, so none has turned over
    along_rest = np.einsum("...k,...k->...", rest + _tops(displacement_mm, unit), rest)
    return np.where(along_rest > 0, strain, np.inf)


def largest_strains(displacement_mm: FloatArray, unit: Unit) -> FloatArray:
    """Largest strain of a pillar of each sample, (n, n_units, n_upper, 3) [mm] -> (n,)."""
    return pillar_strains(displacement_mm, pillar_lengths(displacement_mm, unit), unit).max(axis=(1, 2))


def largest_factors(displacement_mm: FloatArray, unit: Unit, cap: float) -> FloatArray:
    """Factors (n,) that scale displacements (n, n_units, n_upper, 3) up until some pillar's strain reaches the cap.

    |d + t u|² = (1 ± cap)² d² is quadratic in t for a pillar d whose top moves by u: the least positive root of either
    sign is the first crossing. A pillar that turns over, d·(d + t u) = 0, ends the range as well.
    """
    rest, u = pillar_vectors(unit), _tops(displacement_mm, unit)
    uu, ud = np.einsum("...k,...k->...", u, u), np.einsum("...k,...k->...", u, rest)
    dd = rest_lengths(unit) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = [-dd / ud]
        for limit in (1 - cap, 1 + cap):
            root = np.sqrt(ud**2 - uu * dd * (1 - limit**2))
            crossings += [(-ud - root) / uu, (-ud + root) / uu]
    positive = np.where(np.array(crossings) > 0, crossings, np.inf)  # NaN, of a strain never reached, is not
    return positive.min(axis=0).reshape(len(u), -1).min(axis=1)


def pillar_resistances(length_mm: FloatArray, volume_mm3: FloatArray, resistivity_ohm_mm: float) -> FloatArray:
    """Resistance (..., n_pillars) [Ω] of conductive pillars of these lengths, which keep their volumes (n_pillars,).

    R = ρ l / S = ρ l² / V, eq. 1 of Song et al., Micromachines 2018, 9(5), 236; it falls in compression. A length that
    is not above 0, of a collapsed pillar, is a `ValueError`.

    Examples
    --------
    >>> pillar_resistances(np.array([[10.0, 20.0, 20.0]]), np.array([40.0, 80.0, 80.0]), 4000.0)
    array([[10000., 20000., 20000.]])
    """
    if not np.all(length_mm > 0):
        raise ValueError(f"length_mm has a value of {np.min(length_mm):g}, must be above 0: lower the load.")
    return resistivity_ohm_mm / volume_mm3 * length_mm**2


def exact_resistances(effective_mm: FloatArray, design: SensorDesign, rise: FloatArray | float = 0.0) -> FloatArray:
    """Resistances (..., n_pillars) [Ω] of a design's pillars and their contacts, by `effective_lengths` [mm].

    `rise` is that of ln R by memory, as of `dataset.memory.remembered`.
    """
    bulk_ohm = pillar_resistances(effective_mm, pillar_volumes(design.unit), design.resistivity_ohm_mm)
    if not (np.ndim(rise) == 0 and rise == 0.0):
        bulk_ohm = bulk_ohm * np.exp(rise)
    return bulk_ohm + design.electrics.contacts_ohm


def conducted_lengths(conducted: "ConductedPillars", newtons: FloatArray) -> FloatArray:
    """Lengths that eq. 1 would need for the resistances of conduction, √(R V/ρ), (n, n_units, n_pillars) [mm].

    Takes forces (n, ...) [N] along x, y and z, z negative pushing down: on the pads (n_units, 3), or on what else the
    influence is of. Loads beyond the second order in strain, by which a resistance would not be above 0, are a
    `ValueError`.
    """
    n, (rows, cols, n_pillars, n_components) = len(newtons), conducted.rest_mm.shape
    n_units = rows * cols
    influence = conducted.influence_mm_per_n.reshape(n_units * n_pillars * n_components, -1)
    parts = (newtons.reshape(n, -1) @ influence.T).astype(np.float64, copy=False)
    parts += conducted.rest_mm.reshape(-1)
    parts *= parts
    parts = parts.reshape(n, n_units * n_pillars, n_components)
    squares = np.einsum("npk,pk->np", parts, conducted.sign.reshape(-1, n_components))
    if not squares.min(initial=np.inf) > 0:
        raise ValueError(
            "a resistance of conduction is not above 0: the load is too large for linear strain, lower it."
        )
    return np.sqrt(squares).reshape(n, n_units, n_pillars)


def effective_lengths(response: "ArrayResponse", displacement_mm: FloatArray, newtons: FloatArray) -> FloatArray:
    """Lengths by which eq. 1 gives the pillars' resistances: their own, or those of `conducted_lengths`."""
    if response.conducted is not None:
        return conducted_lengths(response.conducted, newtons)
    return pillar_lengths(displacement_mm, response.design.unit)


def rest_resistances(design: SensorDesign) -> FloatArray:
    """Resistance of the pillars of any unit with nothing on the sensor, shape (n_pillars,) [Ω].

    >>> rest_resistances(SensorDesign()).round(1).tolist()
    [10000.0, 14142.1, 14142.1]
    """
    if design.electrics.is_conduction:
        return _conducted_at_rest(design.unit) * design.resistivity_ohm_mm + design.electrics.contacts_ohm
    return exact_resistances(rest_lengths(design.unit), design)


@cache
def _conducted_at_rest(unit: Unit) -> FloatArray:
    """Resistances at rest by conduction over the resistivity, (n_pillars,) [1/mm]; solved when first asked for."""
    from fem.conduction.potentials import unit_conductances

    found = rest_lengths(unit) / pillar_areas(unit)  # of references
    found[[*unit.layout.loaded]] = unit_conductances(unit).pillars_per_mm
    return found
