"""A rubber as a file that people read: a design of it, and beside it in the table [rubber] how well it is known.

Commands take it for a design: the paper's sensor of that rubber. `design --extend` puts the rubber into another one.
"""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import DesignError
from common.storage.files import write_text
from common.storage.text_file import read_text, tables_of
from decoupler.rubber.law import NAMES, Elastic, Rubber
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml, key_line, row_text, whole_design

MEND = "write one with 'tripillar rubber --data SERIES.csv --out RUBBER.toml'"
#: numbers of [rubber] and what they mean; those that may be missing last
STATED = {
    "noise": "standard deviation of ln R about the law",
    "correlation_s": "time over which these errors are alike [s]",
    "force_noise_n": "standard deviation of the force about its law [N]",
    "min_strain": "least and largest strain of the series",
    "max_strain": "beyond, nothing was measured",
    "rest_ohm": "resistance of the specimen at rest [Ω]",
    "wires": "that it was read by: with 2 contacts are in it",
    "section_mm2": "of the specimen [mm²]",
    "electrodes_mm": "distance of the electrodes that read [mm]",
    "contact_ohm": "of one of the specimen's contacts, median of the series [Ω]",
    "contact_spread": "standard deviation of its changes, relative",
}
ELASTIC = {
    "stiffness_n": "shear modulus times section [N]",
    "stiffening": "c₂/c₁ of Yeoh's law",
    "second": "share of the second invariant of Mooney's and Rivlin's law",
}
MAY_LACK = ("section_mm2", "electrodes_mm", "contact_ohm", "contact_spread")


def extended(design: SensorDesign, rubber: Rubber) -> SensorDesign:
    """A design of a rubber, in its pillars: memory and relaxation, modulus and resistivity where they are known."""
    known = design.pillar_material
    young_mpa, ohm_mm = rubber.young_mpa or known.young_mpa, rubber.resistivity_ohm_mm or design.resistivity_ohm_mm
    memory, prony = _rounded(rubber.memory), _rounded(rubber.elastic.prony)
    pillar = replace(known, memory=memory, prony=prony, young_mpa=_short(young_mpa))
    return replace(design, pillar_material=pillar, resistivity_ohm_mm=_short(ohm_mm))


def write_rubber(rubber: Rubber, path: Path) -> None:
    """Write a rubber, whole or not at all."""
    deviation = np.sqrt(rubber.covariance.diagonal())
    correlations = rubber.covariance / np.outer(deviation, deviation)
    design = design_to_toml(extended(SensorDesign(), rubber))
    lines = [
        design.replace("sensor design.", "sensor of a rubber as a bench series showed it.", 1),
        "[rubber]  # how well it is known, and what else its specimen showed",
        *_lines(rubber, STATED),
        "\n[rubber.elastic]  # law of the force, which relaxes as [pillar_material.prony] says",
        f"model = {json.dumps(rubber.elastic.model)}",
        *_lines(rubber.elastic, ELASTIC),
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
    told = tables_of(text, path, DesignError).get("rubber")
    if not isinstance(told, dict):
        raise DesignError(f"{path}: has no table [rubber]: {MEND}.")
    try:
        deviation = np.array([float(told["deviations"][name]) for name in NAMES])
        correlations = np.array([told["correlations"][name] for name in NAMES], dtype=float)
        elastic = Elastic(
            model=str(told["elastic"]["model"]), prony=material.prony,
            **{key: float(told["elastic"][key]) for key in ELASTIC},
        )  # fmt: skip
        stated = {key: float(told[key]) for key in STATED if key in told or key not in MAY_LACK}
        unknown = tuple((str(name), str(test)) for name, test in told.get("unknown", {}).items())
        covariance = correlations * np.outer(deviation, deviation)
        if covariance.shape != (len(NAMES),) * 2 or not np.isfinite(covariance).all():
            raise ValueError("correlations")
    except (KeyError, TypeError, ValueError) as error:
        raise DesignError(f"{path}: [rubber] lacks {error}, or it is no number: {MEND}.") from None
    wires = int(stated.pop("wires"))
    return Rubber(
        memory=material.memory, covariance=covariance, elastic=elastic, unknown=unknown, wires=wires, **stated
    )


def _lines(values: Any, meanings: dict[str, str]) -> list[str]:
    """Keys that are known with their meanings."""
    known = {key: value for key in meanings if (value := getattr(values, key)) is not None}
    return [key_line(key, _short(value), meanings[key]) for key, value in known.items()]


def _short(value: Any) -> Any:
    """A number to six digits; others as they are."""
    return value if not isinstance(value, float) else float(f"{value:.6g}")


def _rounded(values: Any) -> Any:
    """A `Memory` or `Prony` to six digits."""
    own = {spec.name: getattr(values, spec.name) for spec in fields(values)}
    return replace(values, **{k: tuple(map(_short, v)) if isinstance(v, tuple) else _short(v) for k, v in own.items()})
