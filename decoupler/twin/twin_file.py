"""A twin as a file that people read: its design at the most probable values, and how sure these are.

The file is a design file with a table [twin] beside the design, and states the hash of its content. The response of
this very sensor, and draws of it, are in its decoder's model file, which the table names.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from decoupler.model.decoupler import Decoupler
from decoupler.model.model_file import read_model
from decoupler.twin.identification import Twin
from geometry.design import SensorDesign
from geometry.design_file import STRICT, design_to_toml, whole_design
from geometry.errors import DesignError
from geometry.layout import PILLARS, FloatArray
from geometry.storage.files import digest, write_bytes
from geometry.storage.seal import BLANK, require_intact, sealed
from geometry.storage.text_file import read_text, tables_of
from geometry.tolerances import RESISTIVITY, nearest, usual_deviations

MEND = "write one with 'tripillar identify --twin'"
NUMBERS = {
    "gain": "of each pillar, row by row: R = gain · ρ l²/V + offset",
    "gain_deviation": "standard deviations of the gains",
    "offset_ohm": "of each pillar, row by row [Ω]",
    "offset_deviation_ohm": "standard deviations of the offsets [Ω]",
}
KEYS = ("pairs", "misfit", "decoder", "decoder_hash", "parameters", "correlations", *NUMBERS)


@dataclass(frozen=True, kw_only=True, eq=False)
class TwinFile:
    """One sensor as its pairs showed it; pillars are those that its decoder reads."""

    design: SensorDesign  #: at the most probable values, as far as there can be such a sensor
    pairs: int  #: measured
    misfit: float  #: χ² of the readings over their number, each predicted from the others; 1 if all is as modelled
    parameters: dict[str, tuple[float, float]]  #: most probable value and standard deviation, by key of the design
    correlations: FloatArray  #: of the k parameters, (k, k)
    gain: dict[str, FloatArray]  #: by pillar, (rows, cols)
    gain_deviation: dict[str, FloatArray]
    offset_ohm: dict[str, FloatArray]
    offset_deviation_ohm: dict[str, FloatArray]
    decoder: Path
    decoder_hash: str  #: of the decoder's file

    @property
    def covariance(self) -> FloatArray:
        """Of the parameters, (k, k), in the units of their keys."""
        deviation = np.array([deviation for _, deviation in self.parameters.values()])
        return self.correlations * np.outer(deviation, deviation)

    def read_decoder(self) -> Decoupler:
        """The decoder; `DesignError` if the file is another one than the twin was written with."""
        decoder = read_model(self.decoder)
        if file_hash(self.decoder) != self.decoder_hash:
            raise DesignError(f"{self.decoder} is not the decoder that the twin was written with: identify it again.")
        return decoder


def file_hash(path: Path) -> str:
    """Hash of a file's content."""
    return digest(Path(path).read_bytes())


def most_probable(twin: Twin) -> SensorDesign:
    """The design of a twin at its most probable values, resistivity included; `DesignError` if it has no design."""
    if twin.design is None:
        raise DesignError("the twin has no design: identify it with the design that was meant (--design).")
    values = {name: value for name, (value, _) in twin.parameters.items()}
    return nearest(twin.design, {**values, RESISTIVITY: twin.design.resistivity_ohm_mm * twin.resistivity})


def write_twin(twin: Twin, path: Path, decoder: Path) -> None:
    """Write a twin file, whole or not at all.

    Parameters
    ----------
    twin : Twin
    path : Path
    decoder : Path
        The model file of the twin's decoder, already written.
    """
    design, path = most_probable(twin), Path(path)
    deviation = np.sqrt(twin.covariance.diagonal())
    correlations = twin.covariance / np.outer(deviation, deviation)
    shape = (twin.decoder.rows, twin.decoder.cols, -1)
    numbers = {
        "gain": twin.gain,
        "gain_deviation": twin.gain_deviation,
        "offset_ohm": twin.offset_ohm,
        "offset_deviation_ohm": twin.offset_deviation_ohm,
    }
    lines = [
        f"# {BLANK.decode()}",
        design_to_toml(design).replace("sensor design.", "sensor as it was measured: a design and its twin.", 1),
        "[twin]  # the design above is at the most probable values of what its maker left unknown",
        f"pairs = {twin.n_pairs}  # measured",
        f"misfit = {twin.excess:.4g}  # χ² of the readings over their number: 1 if all is as modelled",
        f"decoder = {_text(_seen_from(path.parent, decoder))}  # its response and draws of it, seen from here",
        f"decoder_hash = {_text(file_hash(decoder))}",
        "\n[twin.parameters]  # most probable value and standard deviation, in the key's unit",
        *(f"{_text(name)} = [{value:.7g}, {sd:.3g}]" for name, (value, sd) in twin.parameters.items()),
        "\n[twin.correlations]  # with the parameters, in the order above",
        *(f"{_text(name)} = {_row(row, '.4f')}" for name, row in zip(twin.parameters, correlations, strict=True)),
    ]
    for name, values in numbers.items():
        lines.append(f"\n[twin.{name}]  # {NUMBERS[name]}")
        by_pillar = np.moveaxis(values.reshape(shape), -1, 0)
        for pillar, rows in zip(twin.decoder.component.pillars, by_pillar, strict=True):
            lines.append(f"{pillar} = [\n" + "".join(f"  {_row(row, '.6g')},\n" for row in rows) + "]")
    write_bytes(path, *sealed("\n".join([*lines, ""]).encode()))


def _seen_from(folder: Path, decoder: Path) -> str:
    """The path of a file from a folder, with / on every system; the whole path where it is on another drive."""
    try:
        return Path(os.path.relpath(decoder, folder)).as_posix()
    except ValueError:
        return Path(decoder).absolute().as_posix()


def read_twin(path: Path) -> TwinFile | None:
    """Read the twin of a design file; None if the file holds a design alone.

    Raises
    ------
    DesignError
        If the file is missing, no design file, or its table [twin] lacks something or makes no sense.
    FileFormatError
        If it was changed since it was written.
    """
    path = Path(path)
    text = read_text(path, MEND, DesignError)
    require_intact(path, MEND, required="\n[twin]" in text)
    tables = tables_of(text, path, DesignError)
    if "twin" not in tables:
        return None
    design = whole_design(text, path)
    table = STRICT.made(str(path), STRICT.table, table=tables, key="twin")
    STRICT.made(str(path), STRICT.require_keys, table=table, known=KEYS, where=" in [twin]", required=KEYS)
    parameters = _rows(path, "parameters", table["parameters"])
    unknown = [name for name in parameters if name not in usual_deviations(design)]
    if unknown:
        raise DesignError(f"{path}: the design has no parameter {unknown[0]!r} of [twin.parameters]: {MEND}.")
    k, shape = len(parameters), (design.array.rows, design.array.cols)
    correlations = _rows(path, "correlations", table["correlations"])
    if list(correlations) != list(parameters):
        raise DesignError(f"{path}: [twin.correlations] has other keys than [twin.parameters]: {MEND}.")
    for name, row in parameters.items():
        _require(path, "parameters", row.shape == (2,) and row[1] >= 0, f"{name}: a value and its deviation")
    for name, row in correlations.items():
        _require(path, "correlations", row.shape == (k,) and bool((np.abs(row) < 1.001).all()), f"{name}: {k} of them")
    numbers = {}
    for kind in NUMBERS:
        numbers[kind] = _rows(path, kind, table[kind])
        for pillar, values in numbers[kind].items():
            _require(path, kind, pillar in PILLARS and values.shape == shape, f"{shape[0]} rows of {shape[1]} a pillar")
    for key, wanted in (("pairs", int), ("misfit", float), ("decoder", str), ("decoder_hash", str)):
        _require(path, key, isinstance(table[key], wanted), f"a value of type {wanted.__name__}")
    return TwinFile(
        design=design,
        pairs=table["pairs"],
        misfit=table["misfit"],
        parameters={name: (float(row[0]), float(row[1])) for name, row in parameters.items()},
        correlations=np.array(list(correlations.values())).reshape(k, k),
        decoder=path.parent / table["decoder"],
        decoder_hash=table["decoder_hash"],
        **numbers,
    )


def _rows(path: Path, kind: str, table: Any) -> dict[str, FloatArray]:
    """The entries of a table of [twin] as arrays of finite numbers."""
    found = {}
    _require(path, kind, isinstance(table, dict), "a table")
    for name, values in table.items():
        try:
            found[name] = np.array(values, dtype=np.float64)
        except (ValueError, TypeError):
            found[name] = np.array(np.nan)
        _require(path, kind, bool(np.isfinite(found[name]).all()), f"{name}: finite numbers in rows alike")
    return found


def _require(path: Path, kind: str, is_sound: bool, wanted: str) -> None:
    if not is_sound:
        raise DesignError(f"{path}: [twin] {kind} must be {wanted}: {MEND}.")


def _text(value: str) -> str:
    """A TOML string."""
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _row(values: FloatArray, form: str) -> str:
    return "[" + ", ".join(f"{value:{form}}" for value in values) + "]"
