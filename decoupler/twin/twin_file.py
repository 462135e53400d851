"""A twin as a file that people read: its design at the most probable values, and how sure these are.

The file is a design file with a table [twin] beside the design, and states the hash of its content. The response of
this very sensor, and draws of it, are in its decoder's model file, which the table names.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import DesignError
from common.storage.files import digest, write_bytes
from common.storage.seal import BLANK, require_intact, sealed
from common.storage.text_file import read_text, tables_of
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoupler import Decoupler
from decoupler.model_file import read_network
from decoupler.twin.identification import Twin
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml, row_text, whole_design
from geometry.tolerances import RESISTIVITY, nearest

MEND = "write one with 'tripillar identify --twin'"


@dataclass(frozen=True, kw_only=True, eq=False)
class TwinFile:
    """One sensor as its pairs showed it."""

    design: SensorDesign  #: at the most probable values, as far as there can be such a sensor
    decoder: Path
    decoder_hash: str  #: of the decoder's file
    told: dict[str, Any]  #: the table [twin] as it stands in the file

    def read_decoder(self) -> Decoupler:
        """The decoder; `DesignError` if the file is another one than the twin was written with."""
        decoder = read_network(self.decoder)
        if digest(self.decoder.read_bytes()) != self.decoder_hash:
            raise DesignError(f"{self.decoder} is not the decoder that the twin was written with: identify it again.")
        return decoder

    @property
    def is_at_strain(self) -> bool:
        """It is of a sensor at finite strain."""
        return isinstance(self.read_decoder(), DecouplerAtStrain)


def write_twin(twin: Twin, path: Path, decoder: Path) -> None:
    """Write a twin file, whole or not at all; `decoder` is the model file of its decoder, already written."""
    path, found = Path(path), twin.posterior
    probable = {name: value for name, (value, _) in twin.parameters.items()}
    design = nearest(twin.design, {**probable, RESISTIVITY: twin.design.resistivity_ohm_mm * found.resistivity})
    pillars = [design.unit.layout.pillar_names[pillar] for pillar in twin.decoder.pillars]
    deviation = np.sqrt(found.covariance.diagonal())
    correlations = found.covariance / np.outer(deviation, deviation)
    lines = [
        f"# {BLANK.decode()}",
        design_to_toml(design).replace("sensor design.", "sensor as it was measured: a design and its twin.", 1),
        "[twin]  # the design above is at the most probable values of what its maker left unknown",
        f"pairs = {twin.n_pairs}  # measured",
        f"misfit = {found.excess:.4g}  # χ² of the readings over their number: 1 if all is as modelled",
        f"decoder = {_text(_seen_from(path.parent, decoder))}  # its response and draws of it, seen from here",
        f"decoder_hash = {_text(digest(Path(decoder).read_bytes()))}",
        "\n[twin.parameters]  # most probable value and standard deviation, in the key's unit",
        *(f"{_text(name)} = [{value:.7g}, {sd:.3g}]" for name, (value, sd) in twin.parameters.items()),
        "\n[twin.correlations]  # with the parameters, in the order above",
        *(f"{_text(name)} = {row_text(row, '.4f')}" for name, row in zip(twin.parameters, correlations, strict=True)),
    ]
    for name, values, meaning in (
        ("gain", found.gain, "of each pillar, row by row: R = gain · ρ l²/V + offset"),
        ("gain_deviation", found.gain_deviation, "standard deviations of the gains"),
        ("offset_ohm", found.offset_ohm, "of each pillar, row by row [Ω]"),
        ("offset_deviation_ohm", found.offset_deviation_ohm, "standard deviations of the offsets [Ω]"),
    ):
        lines.append(f"\n[twin.{name}]  # {meaning}")
        by_pillar = np.moveaxis(values.reshape(twin.decoder.rows, twin.decoder.cols, -1), -1, 0)
        for pillar, rows in zip(pillars, by_pillar, strict=True):
            lines.append(f"{pillar} = [\n" + "".join(f"  {row_text(row, '.6g')},\n" for row in rows) + "]")
    write_bytes(path, *sealed("\n".join([*lines, ""]).encode()))


def _seen_from(folder: Path, decoder: Path) -> str:
    """The path of a file from a folder, with / on every system; the whole path where it is on another drive."""
    try:
        return Path(os.path.relpath(decoder, folder)).as_posix()
    except ValueError:
        return Path(decoder).absolute().as_posix()


def _text(value: str) -> str:
    """A TOML string: those of JSON are."""
    return json.dumps(value, ensure_ascii=False)


def read_twin(path: Path) -> TwinFile | None:
    """Read the twin of a design file; None if the file holds a design alone.

    Raises
    ------
    DesignError
        If the file is missing, or no design file, or its table [twin] names no decoder.
    FileFormatError
        If it was changed since it was written.
    """
    path = Path(path)
    text = read_text(path, MEND, DesignError)
    require_intact(path, MEND, required="\n[twin]" in text)
    told = tables_of(text, path, DesignError).get("twin")
    if told is None:
        return None
    try:
        decoder, decoder_hash = path.parent / told["decoder"], str(told["decoder_hash"])
    except (KeyError, TypeError):
        raise DesignError(f"{path}: [twin] names no decoder and its hash: {MEND}.") from None
    return TwinFile(design=whole_design(text, path), decoder=decoder, decoder_hash=decoder_hash, told=told)
