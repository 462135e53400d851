"""A rubber as a file that people read: a design of it, and beside it in the table [rubber] how well it is known.

Commands take it for a design: the paper's sensor of that rubber. `design --extend` puts the rubber into another one.
"""

import json
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import DesignError
from common.storage.files import write_text
from common.storage.text_file import read_text, tables_of
from decoupler.rubber.law import NAMES, Elastic, Rubber
from geometry.design import SensorDesign
from geometry.design_file import STRICT, design_to_toml, row_text, table_lines, whole_design

MEND = "write one with 'tripillar rubber --data SERIES.csv --out RUBBER.toml'"
ROUNDED = 1e-3  #: by which correlations may be off
TABLES = ("elastic", "deviations", "correlations", "unknown")  #: in [rubber]


def extended(design: SensorDesign, rubber: Rubber) -> SensorDesign:
    """A design of a rubber, in its pillars: memory and relaxation, modulus and resistivity where they are known."""
    known = design.pillar_material
    young_mpa, ohm_mm = rubber.young_mpa or known.young_mpa, rubber.resistivity_ohm_mm or design.resistivity_ohm_mm
    memory, prony = _short(rubber.memory), _short(rubber.elastic.prony)
    pillar = replace(known, memory=memory, prony=prony, young_mpa=_short(young_mpa))
    return replace(design, pillar_material=pillar, resistivity_ohm_mm=_short(ohm_mm))


def write_rubber(rubber: Rubber, path: Path) -> None:
    """Write a rubber, whole or not at all."""
    deviation = np.sqrt(rubber.covariance.diagonal())
    correlations = rubber.covariance / np.outer(deviation, deviation)
    design = design_to_toml(extended(SensorDesign(), rubber)).removesuffix("\n")
    lines = [
        design.replace("sensor design.", "sensor of a rubber as a bench series showed it.", 1),
        *table_lines(_short(rubber), "rubber", "how well it is known, and what else its specimen showed"),
        "\n[rubber.deviations]  # standard deviations; of b and tau those of the logarithm",
        *(f"{name} = {value:.4g}" for name, value in zip(NAMES, deviation, strict=True)),
        "\n[rubber.correlations]  # with these numbers, in the order above",
        *(f"{name} = {row_text(row, '.4f')}" for name, row in zip(NAMES, correlations, strict=True)),
        "\n[rubber.unknown]  # what the series does not tell, and which test would",
        *(f"{json.dumps(name)} = {json.dumps(test, ensure_ascii=False)}" for name, test in rubber.unknown),
    ]
    write_text("\n".join([*lines, ""]), path)


def read_rubber(path: Path) -> Rubber:
    """Read a rubber; `DesignError` if the file is missing or no design file, or its table [rubber] makes no sense."""
    text = read_text(path, MEND, DesignError)
    material = whole_design(text, path).pillar_material
    table = tables_of(text, path, DesignError).get("rubber")
    if not table:
        raise DesignError(f"{path}: has no table [rubber]: {MEND}.")
    elastic, deviations, correlations, unknown = (STRICT.table(table, name) for name in TABLES)
    try:
        deviation = np.array([deviations[name] for name in NAMES], dtype=float)
        correlation = np.array([correlations[name] for name in NAMES], dtype=float).reshape(len(NAMES), len(NAMES))
        off = np.abs(correlation - correlation.T).max() + np.abs(correlation.diagonal() - 1).max()
        if not ((deviation > 0) & (deviation < np.inf)).all() or not off < ROUNDED:
            raise ValueError("deviations above 0, and correlations alike across the diagonal of 1")
        if np.linalg.eigvalsh(correlation)[0] < -ROUNDED:
            raise ValueError("correlations that do not contradict each other")
    except (KeyError, TypeError, ValueError) as error:
        raise DesignError(f"{path}: [rubber] lacks {error}, or it is no number: {MEND}.") from None

    if table.get("wires", 4) not in (2, 4):
        raise DesignError(f"{path}: [rubber] wires={table['wires']} must be 2 or 4.")
    covariance = correlation * np.outer(deviation, deviation)

    def filled(kind: Any, name: str, own: dict[str, Any], **beside: Any) -> Any:
        stated = {spec.name: spec for spec in fields(kind) if "meaning" in spec.metadata and spec.name not in beside}
        needed = [key for key, spec in stated.items() if spec.default is not None]
        return STRICT.filled(f"{path}: [{name}]", partial(kind, **beside), own, stated, needed)

    return filled(
        Rubber, "rubber", {key: value for key, value in table.items() if key not in TABLES},
        memory=material.memory, covariance=covariance, unknown=tuple(unknown.items()),
        elastic=filled(Elastic, "rubber.elastic", elastic, prony=material.prony),
    )  # fmt: skip


def _short(value: Any) -> Any:
    """A number to six digits, those in tuples and dataclasses, too; others as they are."""
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{spec.name: _short(getattr(value, spec.name)) for spec in fields(value)})
    if isinstance(value, tuple):
        return tuple(map(_short, value))
    return float(f"{value:.6g}") if isinstance(value, float) else value
