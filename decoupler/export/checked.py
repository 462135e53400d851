"""A trained network for other programs: an ONNX file or a C header by the file's suffix, checked before it is kept."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from decoupler.export.c_header import compiled_forces, header_text
from decoupler.export.portable import ExportError, dead_inputs, places
from decoupler.model.decoupler import Decoupler
from geometry.errors import DesignError
from geometry.layout import PILLARS, FloatArray
from geometry.storage.files import replacing

Precision = Literal["float", "double"]
USUAL: dict[str, Precision] = {".onnx": "double", ".h": "float"}  #: precision by suffix
SAMPLES = 64  #: number of samples that the check computes both ways
MAX_DEVIATION: dict[str, float] = {
    "double": 1e-6,
    "float": 1e-4,
}  #: largest difference allowed, over full scale; see `export_model`
_TYPES: dict[str, type[np.floating]] = {"float": np.float32, "double": np.float64}


@dataclass(frozen=True, kw_only=True)
class Exported:
    """An exported file's precision, and how near its forces come to the model's."""

    precision: Precision
    deviation: float | None  #: largest, relative to the largest force; None if it was not checked
    unchecked: str = ""  #: why not


def export_model(decoupler: Decoupler, path: Path, precision: Precision | None = None) -> Exported:
    """Write a model as ``.onnx`` or ``.h``, whole or not at all, and compare its forces with the model's own.

    Parameters
    ----------
    decoupler : Decoupler
    path : Path
        Its suffix chooses the form.
    precision : str, optional
        float or double; as `USUAL` has it by default.

    Raises
    ------
    DesignError
        If the suffix or the precision is another.
    ExportError
        If ONNX is not installed, a C compiler refuses the header, or a force deviates by more than `MAX_DEVIATION`;
        nothing is written then.

    Notes
    -----
    Double differs by the order of sums, some 1e-15. Float rounds resistances and lengths to a relative 6e-8, and the
    range of a length is a small share of it: up to 5.1e-6 was measured on the paper's array. A response of worse
    condition makes the feature `inverse` lose more; past 1e-4 float is refused.
    """
    if path.suffix not in USUAL:
        raise DesignError(f"{path} must end in {' or '.join(USUAL)}.")
    precision = USUAL[path.suffix] if precision is None else precision
    if precision not in get_args(Precision):
        raise DesignError(f"precision={precision!r} is unknown; choose one of {', '.join(get_args(Precision))}.")
    if decoupler.posterior is not None:
        raise ExportError("models that learned finite strain are not exported yet: train one on linear samples alone.")
    dtype = _TYPES[precision]
    resistance_ohm = likely_resistances(decoupler, SAMPLES)
    expected = decoupler.forces(resistance_ohm)
    with replacing(path) as temporary:
        if path.suffix == ".h":
            header = header_text(decoupler, dtype)
            temporary.write_text(header, encoding="utf-8", newline="\n")
            compiler = shutil.which("cc")
            if compiler is None:
                return Exported(precision=precision, deviation=None, unchecked="no C compiler 'cc' is installed")
            found = compiled_forces(header, resistance_ohm, expected.shape[1:], dtype, compiler)
        else:
            try:
                from decoupler.export.onnx_file import onnx_model
            except ImportError:
                raise ExportError("ONNX is not installed: pip install 'tripillar[export]'.") from None
            content = onnx_model(decoupler, dtype).SerializeToString()
            temporary.write_bytes(content)
            try:
                found = run_onnx(content, resistance_ohm, dtype)
            except ImportError:
                return Exported(precision=precision, deviation=None, unchecked="onnxruntime is not installed")
        deviation = float(np.abs(found - expected).max() / np.abs(expected).max())
        if not deviation <= MAX_DEVIATION[precision]:
            raise ExportError(
                f"{path} is not written: its forces deviate from the model's by {deviation:.1e} of full scale, "
                f"more than {MAX_DEVIATION[precision]:g}: use the precision double, or report it."
            )
    return Exported(precision=precision, deviation=deviation)


def run_onnx(content: bytes, resistance_ohm: FloatArray, dtype: type[np.floating]) -> FloatArray:
    """Forces by onnxruntime, (n, rows, cols, 3) [Ω] -> (n, rows, cols, n_axes) [N]."""
    import onnxruntime

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return session.run(["force_n"], {"resistance_ohm": resistance_ohm.astype(dtype)})[0].astype(np.float64)


def likely_resistances(decoupler: Decoupler, n_samples: int, seed: int = 0) -> FloatArray:
    """Resistances within the training set's ranges, (n_samples, rows, cols, 3) [Ω]; NaN where none is looked at."""
    generator = np.random.default_rng(seed)
    scaling = decoupler.input_scaling  # of forces with the feature inverse
    columns = scaling.unscale(generator.uniform(-1.0, 1.0, (n_samples, len(scaling.centre))))
    if decoupler.inverse is not None:
        columns = decoupler.inverse.forward.resistances(columns)
    elif decoupler.network.feature == "root":
        columns = columns**2
    columns[:, dead_inputs(decoupler)] = np.nan
    resistance_ohm = np.full((n_samples, decoupler.rows * decoupler.cols * len(PILLARS)), np.nan)
    resistance_ohm[:, places(decoupler)] = columns
    return resistance_ohm.reshape(n_samples, decoupler.rows, decoupler.cols, len(PILLARS))
