"""A trained network as one safetensors file whose header explains it: configuration, design, data hash."""

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dataset import Samples
from decoupler.data.columns import component_named
from decoupler.data.scaling import Calibration, Resting, Scaling
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.model_inverse import ModelInverse
from decoupler.model.baseline import LeastSquares
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.model.uncertainty import WITHIN, Uncertainty
from geometry.design import SensorDesign
from geometry.design_file import design_from_toml, design_to_toml
from geometry.errors import FileFormatError
from geometry.layout import PILLAR_TOP, PILLARS
from geometry.storage.files import digest, write_bytes
from geometry.storage.seal import BLANK, KEY, MARK, require_intact, sealed

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

FORMAT = "tripillar-model-2"  #: 1 stated no hash of its content
METHOD = 4  #: raise when the same settings train other weights, so that old models are not reused
HEADER = "tripillar"  #: the entry of the file's metadata that holds all of ours
_UNCERTAINTY = (
    "inverse_matrix",
    "misfit_n2",
    "unexplained_n2",
    "widths",
    "misfit_at_rest_n2",
    "widths_at_rest",
    "light_n2",
)
_NOT_BELOW_0 = {
    "input_half_range",
    "output_half_range",
    "ohm_per_mm2",
    "misfit_n2",
    "unexplained_n2",
    "widths",
    "misfit_at_rest_n2",
    "widths_at_rest",
    "light_n2",
}
_MEND = "give a file made by 'tripillar train'"


def model_recipe(
    data: Samples,
    component: str,
    network: NetworkConfig,
    training: TrainingConfig,
    response: "ArrayResponse | None" = None,
) -> str:
    """Hash of all that a network depends on; a file whose ``made_from["recipe"]`` equals it is current."""
    known = response.content_hash if response is not None and network.feature == "inverse" else ""
    dead = data.dead if data.dead is not None and data.dead.any() else None
    return digest(FORMAT, METHOD, data.content_hash, data.noise, data.bits, dead, component, network, training, known)


def write_model(decoupler: Decoupler, path: Path) -> None:
    """Write a model file with the hash of its content, whole or not at all."""
    header = {
        "format": FORMAT,
        KEY: BLANK.decode(),
        "component": decoupler.component.name,
        "rows": decoupler.rows,
        "cols": decoupler.cols,
        "network": asdict(decoupler.network),
        "design": None if decoupler.design is None else design_to_toml(decoupler.design),
        "design_hash": decoupler.design_hash,
        "made_from": decoupler.made_from,
    }
    if decoupler.uncertainty is not None:
        header |= {"noise": decoupler.uncertainty.noise, "bits": decoupler.uncertainty.bits}
    arrays = {name: np.ascontiguousarray(array) for name, array in _arrays(decoupler).items()}
    content = save(arrays, {HEADER: json.dumps(header)})  # one entry: safetensors shuffles several
    write_bytes(path, *sealed(content))


def read_model(path: Path) -> Decoupler:
    """Read a model file; it gives the same bits as the model that was written.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, foreign, of an earlier version, or holds what makes no sense.
    """
    path = Path(path)
    require_intact(path, _MEND)
    try:
        with safe_open(path, framework="np") as opened:
            metadata = opened.metadata() or {}
            if HEADER not in metadata:
                raise FileFormatError(f"{path}: a safetensors file, but no model of this program: {_MEND}.")
            arrays = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118, no mapping
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file: {_MEND}.") from None
    except (OSError, SafetensorError):
        reason = "a folder" if path.is_dir() else "truncated or no safetensors file"
        raise FileFormatError(f"{path}: {reason}: {_MEND}.") from None
    try:
        decoupler = _assembled(json.loads(metadata[HEADER]), arrays)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise FileFormatError(f"{path}: its header makes no sense ({error}): {_MEND}.") from None
    for name, shape in _shapes(decoupler).items():
        array = arrays[name]
        kind = "i" if name == "top" else "b" if name == "dead" else "f"
        if array.shape != shape or array.dtype.kind != kind or not np.isfinite(array).all():
            raise FileFormatError(
                f"{path}: {name} is {array.dtype} of shape {array.shape} or not finite, expected "
                f"finite numbers of shape {shape}: {_MEND}."
            )
    for name in _NOT_BELOW_0 & set(arrays):
        if arrays[name].min(initial=0.0) < 0:
            raise FileFormatError(f"{path}: {name} holds {arrays[name].min():g}, must not be below 0: {_MEND}.")
    if decoupler.inverse is not None and not _holds_pillars(decoupler.inverse.forward):
        raise FileFormatError(f"{path}: its pillars stand on electrodes that it does not hold: {_MEND}.")
    return decoupler


def require_same_sensor(decoupler: Decoupler, data: Samples, model: Path, dataset: Path) -> None:
    """Refuse data of another sensor than the model's; `model` and `dataset` are the names for the message.

    Raises
    ------
    FileFormatError
        If the array's size differs, or, where both sides state their design, any value of it.
    """
    rows, cols = data.resistance_ohm.shape[1:3]
    differences = [
        f"{name}: model {ours}, data {theirs}"
        for name, ours, theirs in (("rows", decoupler.rows, rows), ("cols", decoupler.cols, cols))
        if ours != theirs
    ]
    if not differences and decoupler.design is not None and data.design is not None:
        differences = _design_differences(decoupler.design, data.design)
    if differences:
        raise FileFormatError(
            f"{model} was trained for another sensor than that of {dataset} ({'; '.join(differences)}): "
            "train a model on data of this design."
        )


def _design_differences(model: SensorDesign, data: SensorDesign) -> list[str]:
    ours, theirs = _flat(asdict(model)), _flat(asdict(data))
    return [f"{name}: model {ours[name]:.10g}, data {theirs[name]:.10g}" for name in ours if ours[name] != theirs[name]]


def _flat(table: dict[str, Any], group: str = "") -> dict[str, float]:
    """{"array": {"pitch_mm": 15}} -> {"array.pitch_mm": 15}."""
    flat: dict[str, float] = {}
    for name, value in table.items():
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {f"{group}{name}": value}
    return flat


def _arrays(decoupler: Decoupler) -> dict[str, np.ndarray]:
    arrays = {
        "hidden_weights": decoupler.hidden_weights,
        "output_weights": decoupler.output_weights,
        "input_centre": decoupler.input_scaling.centre,
        "input_half_range": decoupler.input_scaling.half_range,
        "output_centre": decoupler.output_scaling.centre,
        "output_half_range": decoupler.output_scaling.half_range,
    }
    if decoupler.inverse is not None:
        forward = decoupler.inverse.forward
        arrays |= {name: getattr(forward, name) for name in ("influence", "top", "rest_mm", "ohm_per_mm2")}
        arrays |= {name: getattr(decoupler.inverse, name) for name in ("centre_n", "centre_mm", "correctors")}
    if decoupler.calibration is not None:
        arrays |= {"gain": decoupler.calibration.gain, "offset_ohm": decoupler.calibration.offset_ohm}
    if decoupler.resting is not None:
        arrays |= {"rest_ohm": decoupler.resting.rest_ohm, "full_counts": decoupler.resting.full_counts}
    if decoupler.uncertainty is not None:
        arrays |= {name: getattr(decoupler.uncertainty, name) for name in _UNCERTAINTY}
    if decoupler.least_squares is not None:
        arrays["least_squares"] = decoupler.least_squares.coefficients
    if decoupler.dead is not None:
        arrays["dead"] = decoupler.dead
    return arrays


def _shapes(decoupler: Decoupler) -> dict[str, tuple[int, ...]]:
    """Shapes that the arrays must have by the header and by which of them there are."""
    hidden, n_units = decoupler.network.hidden, decoupler.rows * decoupler.cols
    n_in, n_out = n_units * len(decoupler.component.pillars), n_units * len(decoupler.component.axes)
    seen = n_out if decoupler.inverse is not None else n_in
    n_features = hidden + (seen + 1 if decoupler.network.net == "skip" else 1)
    shapes: dict[str, tuple[int, ...]] = {
        "hidden_weights": (hidden, seen + 1),
        "output_weights": (n_out, n_features),
        "input_centre": (seen,),
        "input_half_range": (seen,),
        "output_centre": (n_out,),
        "output_half_range": (n_out,),
    }
    if decoupler.inverse is not None:
        n_electrodes = n_units * len({PILLAR_TOP[PILLARS.index(pillar)] for pillar in decoupler.component.pillars})
        shapes |= {"influence": (n_out, 3 * n_electrodes), "top": (n_in,), "rest_mm": (3, n_in), "ohm_per_mm2": (n_in,)}
        shapes |= {
            "centre_n": (n_out,),
            "centre_mm": (n_in,),
            "correctors": (len(decoupler.inverse.correctors), n_in, n_out),
        }
    if decoupler.calibration is not None:
        shapes |= {"gain": (n_in,), "offset_ohm": (n_in,)}
    if decoupler.resting is not None:
        shapes |= {"rest_ohm": (n_in,), "full_counts": (1,)}
    if decoupler.uncertainty is not None:
        n_axes = len(decoupler.component.axes)
        shapes |= {"inverse_matrix": (n_features, n_features), "misfit_n2": (n_out,), "unexplained_n2": (n_out,)}
        shapes |= {"widths": (len(WITHIN), n_axes), "widths_at_rest": (len(WITHIN), n_axes)}
        shapes |= {"misfit_at_rest_n2": (n_out,), "light_n2": (1,)}
    if decoupler.least_squares is not None:
        shapes["least_squares"] = (n_in + 1, n_out)
    if decoupler.dead is not None:
        shapes["dead"] = (decoupler.rows, decoupler.cols, len(PILLARS))
    return shapes


def _holds_pillars(forward: ForwardModel) -> bool:
    n_electrodes = forward.influence.shape[1] // 3
    return bool(((forward.top >= 0) & (forward.top < n_electrodes)).all())


def _assembled(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Decoupler:
    if header["format"] != FORMAT:
        raise ValueError(f"format is {header['format']}, not {FORMAT}: of another version, train it again")
    if not str(header[KEY]).startswith(MARK.decode()):
        raise ValueError(f"{KEY} is {header[KEY]!r}, no hash")
    for name in ("rows", "cols"):
        if type(header[name]) is not int or header[name] < 1:
            raise ValueError(f"{name} is {header[name]!r}, must be a whole number from 1 on")
    known = {spec.name for spec in fields(NetworkConfig)}
    if set(header["network"]) != known:
        raise ValueError(f"network has the keys {sorted(header['network'])}, not {sorted(known)}")
    network = NetworkConfig(**header["network"])
    inverse = uncertainty = None
    if network.feature == "inverse":
        forward = ForwardModel(**{name: arrays[name] for name in ("influence", "top", "rest_mm", "ohm_per_mm2")})
        inverse = ModelInverse(forward=forward, **{n: arrays[n] for n in ("centre_n", "centre_mm", "correctors")})
    if _UNCERTAINTY[0] in arrays:
        given = {name: arrays[name] for name in _UNCERTAINTY}
        uncertainty = Uncertainty(**given, noise=header["noise"], bits=header["bits"])
    resting = None
    if "rest_ohm" in arrays:
        resting = Resting(rest_ohm=arrays["rest_ohm"], full_counts=arrays["full_counts"])
    component, dead = component_named(header["component"]), arrays.get("dead")
    least_squares = None
    if "least_squares" in arrays:
        least_squares = LeastSquares(component=component, coefficients=arrays["least_squares"], dead=dead)
    return Decoupler(
        component=component,
        rows=header["rows"],
        cols=header["cols"],
        network=network,
        input_scaling=Scaling(arrays["input_centre"], arrays["input_half_range"]),
        output_scaling=Scaling(arrays["output_centre"], arrays["output_half_range"]),
        hidden_weights=arrays["hidden_weights"],
        output_weights=arrays["output_weights"],
        design=None if header["design"] is None else design_from_toml(header["design"]),
        inverse=inverse,
        calibration=Calibration(arrays["gain"], arrays["offset_ohm"]) if "gain" in arrays else None,
        resting=resting,
        dead=dead,
        uncertainty=uncertainty,
        least_squares=least_squares,
        made_from=dict(header["made_from"]),
    )
