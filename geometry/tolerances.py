"""Uncertain parameters of a design, named by their keys, with the deviations that manufacturing leaves.

A parameter is named as in the design file, table and key: "unit.height_mm". "rubber" stands for both rubbers at once:
where pillars and matrix are of one rubber they stay so.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from common.errors import DesignError
from geometry.design import SensorDesign

RUBBER = "rubber"  #: table of parameters that both rubbers share
RUBBERS = ("pillar_material", "matrix_material")
RESISTIVITY = "resistivity_ohm_mm"  #: scales every resistance and moves nothing

# Standard deviations that a careful maker leaves. Lengths are those of a printed mould and of silicone poured into it;
# what shrinks the whole sensor alike needs no parameter of its own, since it acts as E and ρ do. Nor does the size of
# the electrodes: 0.1 mm moves their mean displacement by less than 0.1 %.
YOUNG = 0.1  #: of E: mixing ratio and cure
POISSON = 0.4  #: of 0.5 − ν: a rubber's bulk modulus E/(3(1 − 2ν)) is known no better; 0.004 at ν = 0.49 ...
MAX_POISSON = 0.02  #: ... and no more than this
HEIGHT = 0.02  #: of the height: the slab is filled by hand
PAD_MM = 0.3  #: of a pad's side, and of its place along x and y: pads are glued on by eye
MIN_ROOM_MM = 0.01  #: in which a pad may be off its place
SPAN = 0.01  #: of the span: print of the mould
WIDTH = 0.02  #: of the pillars' width
LOG_RESISTIVITY = 0.2  #: of ρ: it changes from batch to batch with the carbon's dispersion


def usual_deviations(design: SensorDesign) -> dict[str, float]:
    """Standard deviation of every uncertain parameter of a design before anything is measured, in the key's unit.

    With one rubber the pillars' width bends nothing and scales all resistances alike, as the resistivity does: it is no
    parameter then. Nor are offsets of pads that have no room beside their neighbours.

    >>> usual_deviations(SensorDesign())["unit.height_mm"]
    0.2
    """
    found = {}
    for table in (RUBBER,) if design.is_homogeneous else RUBBERS:
        rubber = design.matrix_material if table == RUBBER else getattr(design, table)
        found[f"{table}.young_mpa"] = YOUNG * rubber.young_mpa
        found[f"{table}.poisson"] = min(POISSON * (0.5 - rubber.poisson), MAX_POISSON)
    found["unit.height_mm"] = HEIGHT * design.unit.height_mm
    found["unit.span_mm"] = SPAN * design.unit.span_mm
    if not design.is_homogeneous:
        found["unit.pillar_width_mm"] = WIDTH * design.unit.pillar_width_mm
    found["pad.size_mm"] = PAD_MM
    for key in ("offset_x_mm", "offset_y_mm"):
        room_mm = design.pad_room_mm - design.pad.size_mm / 2 - abs(getattr(design.pad, key))
        if room_mm > MIN_ROOM_MM:
            found[f"pad.{key}"] = min(PAD_MM, 0.999 * room_mm)
    found[RESISTIVITY] = LOG_RESISTIVITY * design.resistivity_ohm_mm
    return found


def uncertain_keys(design: SensorDesign) -> set[str]:
    """Dotted keys of a design that its uncertain parameters change."""
    names = (name.rpartition(".") for name in usual_deviations(design))
    return {f"{part}{dot}{key}" for table, dot, key in names for part in (RUBBERS if table == RUBBER else (table,))}


def value_of(design: SensorDesign, name: str) -> float:
    """Value of a parameter, in its key's unit."""
    table, _, key = name.rpartition(".")
    holder = getattr(design, RUBBERS[-1] if table == RUBBER else table) if table else design
    return float(getattr(holder, key))


def with_values(design: SensorDesign, values: Mapping[str, float]) -> SensorDesign:
    """The design with other values of parameters; `DesignError` if there can be no such sensor.

    >>> with_values(SensorDesign(), {"rubber.young_mpa": 5.0}).is_homogeneous
    True
    """
    changes: dict[str, Any] = {}
    for name, value in values.items():
        table, _, key = name.rpartition(".")
        if not table:
            changes[key] = value
        for part in RUBBERS if table == RUBBER else (table,) if table else ():
            changes[part] = replace(changes.get(part, getattr(design, part)), **{key: value})
    return replace(design, **changes)


def nearest(design: SensorDesign, values: Mapping[str, float]) -> SensorDesign:
    """The same, leaving out one by one the values that no sensor can have, such as pads that would overlap."""
    for name, value in values.items():
        with suppress(DesignError):
            design = with_values(design, {name: value})
    return design


def changed(design: SensorDesign, name: str, by: float) -> SensorDesign:
    """The design with one parameter changed by an amount, in its key's unit; errors as of `with_values`."""
    return with_values(design, {name: value_of(design, name) + by})
