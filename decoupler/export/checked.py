"""A trained network as an ONNX file or a C header, by the file's suffix, in a precision that is enough."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from common.errors import DesignError, needing
from common.storage.files import write_bytes
from decoupler.export.c_header import header_text
from decoupler.export.portable import ExportError
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoupler import Decoupler
from decoupler.model.tensors import converted
from geometry.layout import FloatArray

Precision = Literal["float", "double"]
USUAL: dict[str, Precision] = {".onnx": "double", ".h": "float"}  #: precision by suffix
SAMPLES = 64  #: number of scans that are decoded in the precision of the file
MAX_DEVIATION = 1e-4  #: largest difference that rounding may make, over full scale; 5.1e-6 on the paper's array
_TYPES: dict[str, type[np.floating]] = {"float": np.float32, "double": np.float64}


@dataclass(frozen=True, kw_only=True)
class Exported:
    """An exported file's precision, and what rounding to it does to the forces."""

    precision: Precision
    deviation: float  #: largest, relative to the largest force


def export_model(decoupler: Decoupler, path: Path, precision: Precision | None = None) -> Exported:
    """Write a model as ``.onnx`` or ``.h``, whole or not at all; by default in double or in float.

    Raises
    ------
    DesignError
        If the suffix or the precision is another.
    ExportError
        If the model learned finite strain, or if rounding to float moves a force by more than `MAX_DEVIATION`: a
        response of a bad condition makes the feature `inverse` lose much.
    MissingPackageError
        If ONNX is not installed.
    """
    if path.suffix not in USUAL:
        raise DesignError(f"{path} must end in {' or '.join(USUAL)}.")
    precision = USUAL[path.suffix] if precision is None else precision
    if precision not in get_args(Precision):
        raise DesignError(f"precision={precision!r} is unknown; choose one of {', '.join(get_args(Precision))}.")
    if isinstance(decoupler, DecouplerAtStrain):
        raise ExportError(
            "models of finite strain are not exported: each scan solves for all forces at once. Decode in Python or "
            "torch, or train on linear samples alone."
        )
    dtype = _TYPES[precision]
    columns = decoupler.columns(likely_resistances(decoupler, SAMPLES))
    expected = decoupler.first_answers(columns)
    rounded = converted(decoupler, lambda values: values.astype(dtype)).first_answers(columns.astype(dtype))
    deviation = float(np.abs(rounded - expected).max() / np.abs(expected).max())
    if not deviation <= MAX_DEVIATION:
        raise ExportError(
            f"{path} is not written: rounding to {precision} moves its forces by {deviation:.1e} of full scale, more "
            f"than {MAX_DEVIATION:g}: use the precision double."
        )
    if path.suffix == ".h":
        content = header_text(decoupler, dtype).encode()
    else:
        with needing("ONNX", "export"):
            from decoupler.export.onnx_file import onnx_model
        content = onnx_model(decoupler, dtype).SerializeToString()
    write_bytes(path, content)
    return Exported(precision=precision, deviation=deviation)


def likely_resistances(decoupler: Decoupler, n_samples: int) -> FloatArray:
    """Resistances within the training set's ranges, (n_samples, rows, cols, n_pillars) [Ω]; NaN: not looked at."""
    front = decoupler.front
    inputs = np.random.default_rng(0).uniform(-1.0, 1.0, (n_samples, len(front.scaling.centre)))
    columns = front.feature.resistances(front.scaling.unscale(inputs)).copy()
    columns[:, ~decoupler.readable] = np.nan
    resistance_ohm = np.full((n_samples, decoupler.rows, decoupler.cols, len(decoupler.layout.pillars)), np.nan)
    resistance_ohm.reshape(n_samples, -1)[:, decoupler.places] = columns
    return resistance_ohm
