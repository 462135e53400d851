"""A trained network as an ONNX file or a C header, by the file's suffix, in a precision that is enough."""

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from common.errors import DesignError, needing
from common.storage.files import write_bytes
from decoupler.data.columns import DEAD_OHM
from decoupler.export.c_header import header_text
from decoupler.export.traced import ExportError, Traced
from decoupler.model.decoupler import Decoupler
from geometry.layout import FloatArray

Precision = Literal["float", "double"]
USUAL: dict[str, Precision] = {".onnx": "double", ".h": "float"}  #: precision by suffix
N_SCANS = 64  #: scans that are decoded in the precision of the file
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
        If the model needs an operation that no file has, or if rounding to float moves a force by more than
        `MAX_DEVIATION`: a response of a bad condition makes the feature `inverse` lose much.
    MissingPackageError
        If ONNX is not installed.
    """
    if path.suffix not in USUAL:
        raise DesignError(f"{path} must end in {' or '.join(USUAL)}.")
    precision = USUAL[path.suffix] if precision is None else precision
    if precision not in get_args(Precision):
        raise DesignError(f"precision={precision!r} is unknown; choose one of {', '.join(get_args(Precision))}.")
    scans = likely_resistances(decoupler, N_SCANS)
    graph = traced(decoupler, scans.astype(_TYPES[precision]))
    expected = decoupler.outputs(decoupler.columns(scans)).reshape(graph.shape)
    deviation = float(np.abs(graph.values - expected).max() / np.abs(expected).max())
    if not deviation <= MAX_DEVIATION:
        raise ExportError(
            f"{path} is not written: rounding to {precision} moves its forces by {deviation:.1e} of full scale, more "
            f"than {MAX_DEVIATION:g}: use the precision double."
        )
    if path.suffix == ".h":
        content = header_text(graph, facts_of(decoupler)).encode()
    else:
        with needing("ONNX", "export"):
            from decoupler.export.onnx_file import onnx_model
        content = onnx_model(graph, facts_of(decoupler)).SerializeToString()
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


def traced(decoupler: Decoupler, scans_ohm: FloatArray) -> Traced:
    """Forces of scans (n, rows, cols, n_pillars) [Ω] as `Decoupler.forces` computes them, without its refusals."""
    columns_ohm = Traced(scans_ohm, scans_ohm.dtype).reshape(len(scans_ohm), -1)[:, decoupler.places]
    if not decoupler.readable.all():
        columns_ohm = np.where(decoupler.readable, columns_ohm, DEAD_OHM)
    outputs: Any = decoupler.outputs(columns_ohm)
    return outputs.reshape(len(scans_ohm), decoupler.rows, decoupler.cols, -1)


def facts_of(decoupler: Decoupler) -> dict[str, str]:
    """Facts about the model for a reader of the exported file, by name."""
    made_from, network, pillars = decoupler.made_from, decoupler.form, ", ".join(decoupler.layout.pillar_names)
    try:
        program = version("tripillar")
    except PackageNotFoundError:
        program = "unknown"
    return {
        "component": decoupler.component.name,
        "axes": " ".join(decoupler.component.forces),
        "net": f"{network.net}, {network.hidden} hidden nodes",
        "feature": network.feature,
        "units": f"resistance_ohm in ohm (pillars {pillars}), force_n in newton (fz positive in compression)",
        "design_hash": decoupler.design_hash or "unknown",
        "data_hash": str(made_from.get("data_hash", "unknown")),
        "model_hash": str(made_from.get("recipe", "unknown")),
        "version": program,
    }
