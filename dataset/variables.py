"""Variables of a dataset: their dims, units and limits, the same in memory, NetCDF, zarr and tables."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dataset.imperfections import OPEN_OHM, PAPERS
from geometry.layout import AXES, LAYOUTS, Layout

#: limits that no sensor exceeds: a hundred tonnes on a pad, a superconductor, an insulator; none overflows when squared
MAX_N, MIN_OHM, MAX_OHM = 1e6, 1e-9, 1e15
_UNIT = ("sample", "row", "col")
TIMED = ("series", "time")  #: in the place of the samples, of series over time
TIME = {"units": "s", "note": "since the series began"}  #: attributes of the coordinate `time`


class Variable(NamedTuple):
    """A variable of a dataset."""

    dims: tuple[str, ...]
    notes: dict[str, Any]  #: its attributes
    limits: tuple[float, float] | None = None  #: beyond which no sensor gives a number; None: any finite one will do

    def shape(self, rows: int, cols: int, layout: Layout, moments: int | None = None) -> tuple[int, ...]:
        """Shape of one sample of an array, or of a series of so many moments."""
        sizes = {"row": rows, "col": cols} | {dim: len(labels) for dim, labels in labels_of(layout).items()}
        return (*([] if moments is None else [moments]), *(sizes[dim] for dim in self.dims[1:]))

    def dims_in(self, is_timed: bool) -> tuple[str, ...]:
        """Dims of samples, or of series over time."""
        return (*TIMED, *self.dims[1:]) if is_timed else self.dims


VARIABLES = {
    "traction_mpa": Variable(
        (*_UNIT, "axis"), {"units": "MPa", "note": "force over the pad's area, as applied: z < 0 pushes down"}
    ),
    "force_n": Variable((*_UNIT, "axis"), {"units": "N", "note": "z > 0 is compression"}, (-MAX_N, MAX_N)),
    "displacement_mm": Variable((*_UNIT, "electrode", "axis"), {"units": "mm", "note": "upper electrodes"}),
    "length_mm": Variable((*_UNIT, "pillar"), {"units": "mm", "note": "between electrode centroids"}),
    "resistance_ohm": Variable(
        (*_UNIT, "pillar"),
        {"units": "ohm", "note": f"as measured, noise included; {OPEN_OHM:g} where a pillar cannot be read"},
        (MIN_OHM, MAX_OHM),
    ),
    "effective_length_mm": Variable(  # of conduction alone
        (*_UNIT, "pillar"),
        {"units": "mm", "note": "that eq. 1 would need for the pillar's exact resistance, of conduction"},
    ),
    "moment_nmm": Variable(  # of contacts alone
        (*_UNIT, "place"),
        {"units": "N mm", "note": "of the pressure about the unit's middle, over its share of the top"},
    ),
    # of samples at finite strain alone
    "strain_model": Variable(
        ("sample",),
        {"flag_values": [0.0, 1.0], "flag_meanings": "linear finite_strain", "note": "how it was solved"},
    ),
    "error_estimate": Variable(("sample",), {"units": "1", "note": "of the displacements, relative"}),
    "iterations": Variable(("sample",), {"units": "1", "note": "solves of the sample, one factor for all"}),
}
LABELS = ("force_n", "resistance_ohm")  #: variables that every dataset holds
#: those with a place on the array
ARRAYS = tuple(name for name, variable in VARIABLES.items() if "row" in variable.dims)


def senseless(name: str, values: np.ndarray, labels: Mapping[str, Sequence[str]], first: int = 0) -> str | None:
    """The first number of a variable (n, ...) that no sensor gives, and what is allowed; None if there is none.

    Series over time have one more dim. `labels` are of `labels_of`, or of the last dim where it holds some of the
    pillars or axes alone; `first` is the number of sample 0.
    """
    _, notes, limits = VARIABLES[name]
    dims = VARIABLES[name].dims_in(values.ndim > len(VARIABLES[name].dims))
    low, high = limits or (-np.finfo(float).max, np.finfo(float).max)
    if not values.size or low <= values.min() <= values.max() <= high:  # NaN is neither
        return None
    index = np.argwhere(~((values >= low) & (values <= high)))[0]
    place = ", ".join(
        f"{dim} {labels[dim][at] if dim in labels else at}"
        for dim, at in zip(dims, (first + index[0], *index[1:]), strict=True)
    )
    allowed = "finite" if limits is None else f"finite, {low:g} to {high:g} {notes['units']}"
    return f"{name} is {values[tuple(index)]} at {place}; it must be {allowed}"


def labels_of(layout: Layout) -> dict[str, list[str]]:
    """Labels of all dims that have some.

    >>> labels_of(PAPERS)["pillar"]
    ['z', 'x', 'y']
    """
    pillars, electrodes = list(layout.pillar_names), list(layout.upper_names)
    return {"axis": list(AXES), "pillar": pillars, "electrode": electrodes, "place": list(AXES[:2])}


def layout_of(pillars: Iterable[str]) -> Layout:
    """The layout, of those that are ready, whose pillars have these names in any order; the paper's if none has."""
    names = sorted(pillars)
    return next((layout for layout in LAYOUTS.values() if sorted(layout.pillar_names) == names), PAPERS)


def coordinates(names: Iterable[str], layout: Layout) -> dict[str, list[str]]:
    """Labels of the dims of some variables."""
    dims = {dim for name in names for dim in VARIABLES[name].dims}
    return {dim: labels for dim, labels in labels_of(layout).items() if dim in dims}
