"""A trained network as one safetensors file whose header explains it: configuration, design, data hash."""

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dataset.measurement import ReadingError
from decoupler.data.columns import Resting, Scaling, component_named
from decoupler.data.enough import AnySamples
from decoupler.inverse.forward_model import ForwardModel, ModelInverse
from decoupler.inverse.posterior import Posterior
from decoupler.inverse.specimen import Specimen
from decoupler.inverse.strain_maps import FEW, N_AXES, N_FEATURES, OWN, StrainMaps
from decoupler.model.baseline import LeastSquares
from decoupler.model.decoupler import Decoupler
from decoupler.model.ensemble import Ensemble
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.model.uncertainty import WITHIN, Uncertainty
from decoupler.model.usual import UsualLoads
from geometry.design import Drifts, SensorDesign
from geometry.design_file import design_from_toml, design_to_toml
from geometry.errors import FileFormatError
from geometry.layout import PILLAR_TOP, PILLARS
from geometry.storage.files import digest, stated, write_bytes
from geometry.storage.seal import BLANK, KEY, MARK, require_intact, sealed
from geometry.tolerances import uncertain_keys

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

FORMAT = "tripillar-model-2"  #: 1 stated no hash of its content
METHOD = 8  #: raise when the same settings train another file, so that old models are not reused
HEADER = "tripillar"  #: the entry of the file's metadata that holds all of ours
#: place of each array of a file in a model, and its shape by the names of `_sizes`
_ARRAYS: dict[str, tuple[str, tuple[str, ...]]] = {
    "hidden_weights": ("hidden_weights", ("hidden", "seen + 1")),
    "output_weights": ("output_weights", ("out", "features")),
    "input_centre": ("input_scaling.centre", ("seen",)),
    "input_half_range": ("input_scaling.half_range", ("seen",)),
    "output_centre": ("output_scaling.centre", ("out",)),
    "output_half_range": ("output_scaling.half_range", ("out",)),
    **{
        f"{prefix}{name}": (f"{owner}.forward.{name}", shape)
        for prefix, owner in (("", "inverse"), ("finite_", "posterior"))
        for name, shape in (
            ("influence", ("out", "components electrodes")),
            ("top", ("in",)),
            ("rest_mm", ("components", "in")),
            ("sign", ("components", "in")),
            ("ohm_per_mm2", ("in",)),
            ("offset_ohm", ("in",)),
        )
    },
    "maps_influence": ("posterior.forward.maps.influence", ("out", "electrodes along 3")),
    "maps_near": ("posterior.forward.maps.near", ("units", "neighbours")),
    "maps_sizes": ("posterior.forward.maps.sizes", ("own",)),
    "maps_weights": ("posterior.forward.maps.weights", ("finite features", "forces and pillars")),
    "maps_misfit": ("posterior.forward.maps.misfit", ("forces and pillars",)),
    "maps_growth": ("posterior.forward.maps.growth", ("2",)),
    "to_state": ("posterior.to_state", ("out + 1", "out")),
    "precision": ("posterior.precision", ("out", "out")),
    "loads_n": ("posterior.loads_n", ("loads", "out")),
    "specimen_changes": ("posterior.specimen.changes", ("parameters", "few", "forces and pillars")),
    "specimen_shift": ("posterior.specimen.shift", ("few", "forces and pillars")),
    "specimen_unknowns": ("posterior.specimen.unknowns", ("unknowns",)),
    "specimen_factor": ("posterior.specimen.factor", ("unknowns", "unknowns")),
    "centre_n": ("inverse.centre_n", ("out",)),
    "centre_mm": ("inverse.centre_mm", ("in",)),
    "correctors": ("inverse.correctors", ("steps", "in", "out")),
    "rest_ohm": ("resting.rest_ohm", ("in",)),
    "full_counts": ("resting.full_counts", ("1",)),
    "inverse_matrix": ("uncertainty.inverse_matrix", ("features", "features")),
    "misfit_n2": ("uncertainty.misfit_n2", ("out",)),
    "unexplained_n2": ("uncertainty.unexplained_n2", ("out",)),
    "widths": ("uncertainty.widths", ("shares", "axes")),
    "misfit_at_rest_n2": ("uncertainty.misfit_at_rest_n2", ("out",)),
    "widths_at_rest": ("uncertainty.widths_at_rest", ("shares", "axes")),
    "light_n2": ("uncertainty.light_n2", ("1",)),
    "drift_factor": ("uncertainty.drift_factor", ("drifts", "drifts")),
    "usual_low_n": ("usual.low_n", ("axes",)),
    "usual_high_n": ("usual.high_n", ("axes",)),
    "friction": ("usual.friction", ("1",)),
    "usual_log_ohm": ("usual.log_ohm", ("in",)),
    "usual_log_ohm_covariance": ("usual.log_ohm_covariance", ("in", "in")),
    "drawn_resistance": ("ensemble.resistance", ("draws", "in")),
    "drawn_offset_ohm": ("ensemble.offset_ohm", ("draws", "in")),
    "drawn_rest_mm": ("ensemble.rest_mm", ("draws", "in", "3")),
    "drawn_influence": ("ensemble.influence", ("draws", "in", "3", "out")),
    "least_squares": ("least_squares.coefficients", ("in + 1", "out")),
    "dead": ("dead", ("rows", "cols", "3")),
}
_NOT_BELOW_0 = {name for name in _ARRAYS if name.endswith(("_half_range", "_n2")) or name.startswith("widths")} | {
    "ohm_per_mm2",
    "friction",
}
_MEND = "give a file made by 'tripillar train'"


def model_cache_key(
    data: AnySamples,
    component: str,
    network: NetworkConfig,
    training: TrainingConfig,
    response: "ArrayResponse | None" = None,
) -> str:
    """Hash of all that a network depends on; a file whose ``made_from["recipe"]`` equals it is current."""
    known = response.content_hash if response is not None and network.feature == "inverse" else ""
    dead = data.dead if data.dead is not None and data.dead.any() else None
    parts = (FORMAT, METHOD, data.content_hash, data.noise, data.bits, dead, component, network, training, known)
    later = [data.is_finite] if data.is_finite.any() else []
    return digest(*parts, *later, *([data.errors] if data.errors.has_drift else []))


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
    if decoupler.posterior is not None:
        header["misfit"] = decoupler.posterior.misfit
    if decoupler.uncertainty is not None:
        header |= stated(decoupler.uncertainty.errors)
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
    sizes = _sizes(decoupler)
    for name, array in _arrays(decoupler).items():
        shape = tuple(sizes[size] for size in _ARRAYS[name][1])
        kind = "i" if name.endswith(("top", "_near")) else "b" if name == "dead" else "f"
        if array.shape != shape or array.dtype.kind != kind or not np.isfinite(array).all():
            raise FileFormatError(
                f"{path}: {name} is {array.dtype} of shape {array.shape} or not finite, expected "
                f"finite numbers of shape {shape}: {_MEND}."
            )
    for name in arrays.keys() & _NOT_BELOW_0:
        if arrays[name].min(initial=0.0) < 0:
            raise FileFormatError(f"{path}: {name} holds {arrays[name].min():g}, must not be below 0: {_MEND}.")
    if not all(_holds_pillars(part.forward) for part in (decoupler.inverse, decoupler.posterior) if part is not None):
        raise FileFormatError(f"{path}: its pillars stand on electrodes that it does not hold: {_MEND}.")
    return decoupler


def require_same_sensor(decoupler: Decoupler, data: AnySamples, model: Path, dataset: Path) -> None:
    """Refuse data of another sensor than the model's; `model` and `dataset` are the names for the message.

    Raises
    ------
    FileFormatError
        If the array's size differs, or, where both sides state their design, any value of it but drifts; of a twin any
        that it does not find out.
    """
    rows, cols = data.shape
    differences = [
        f"{name}: model {ours}, data {theirs}"
        for name, ours, theirs in (("rows", decoupler.rows, rows), ("cols", decoupler.cols, cols))
        if ours != theirs
    ]
    if not differences and decoupler.design is not None and data.design is not None:
        of_specimen = decoupler.posterior is not None and decoupler.posterior.specimen is not None
        of_twin = of_specimen or decoupler.ensemble is not None or "twin" in {**decoupler.made_from, **data.made_from}
        differences = _design_differences(decoupler.design, data.design, of_twin)
    if differences:
        raise FileFormatError(
            f"{model} was trained for another sensor than that of {dataset} ({'; '.join(differences)}): "
            "train a model on data of this design."
        )


def _design_differences(model: SensorDesign, data: SensorDesign, of_twin: bool = False) -> list[str]:
    ours, theirs = _flat(asdict(model)), _flat(asdict(data))
    free = uncertain_keys(model) | uncertain_keys(data) if of_twin else set()  # as it was meant, as it was measured
    free |= {f"electrics.{spec.name}" for spec in fields(Drifts)}  # how far readings drift makes no other sensor
    return [
        f"{name}: model {_shown(ours[name])}, data {_shown(theirs[name])}"
        for name in ours
        if ours[name] != theirs[name] and name not in free
    ]


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"


def _flat(table: dict[str, Any], group: str = "") -> dict[str, float | str]:
    """{"array": {"pitch_mm": 15}} -> {"array.pitch_mm": 15}."""
    flat: dict[str, float | str] = {}
    for name, value in table.items():
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {f"{group}{name}": value}
    return flat


def _arrays(decoupler: Decoupler) -> dict[str, np.ndarray]:
    """The arrays that a model has, by their names in a file."""
    found: dict[str, np.ndarray] = {}
    for name, (place, _) in _ARRAYS.items():
        value: Any = decoupler
        for part in place.split("."):
            value = None if value is None else getattr(value, part)
        if value is not None:
            found[name] = value
    return found


def _sizes(decoupler: Decoupler) -> dict[str, int]:
    """Lengths of the arrays' dimensions, by the header and by the parts that there are."""
    component, rows, cols, hidden = decoupler.component, decoupler.rows, decoupler.cols, decoupler.network.hidden
    n_in, n_out = rows * cols * len(component.pillars), rows * cols * len(component.axes)
    seen = n_out if decoupler.inverse is not None else n_in
    model = decoupler.inverse or decoupler.posterior
    specimen = None if decoupler.posterior is None else decoupler.posterior.specimen
    forward = None if model is None else model.forward
    electrodes = rows * cols * len({PILLAR_TOP[PILLARS.index(pillar)] for pillar in component.pillars})
    if decoupler.ensemble is not None:
        electrodes = n_in  # an identified sensor has an influence for each pillar
    return {
        "1": 1,
        "3": len(PILLARS),
        "rows": rows,
        "cols": cols,
        "axes": len(component.axes),
        "shares": len(WITHIN),
        "in": n_in,
        "in + 1": n_in + 1,
        "out": n_out,
        "out + 1": n_out + 1,
        "2": 2,
        "few": len(FEW),
        "loads": 0 if decoupler.posterior is None else len(decoupler.posterior.loads_n),
        "parameters": 0 if specimen is None else len(specimen.changes),
        "unknowns": 0 if specimen is None else specimen.n_unknowns(n_in),
        "forces and pillars": N_AXES + len(component.pillars),
        "hidden": hidden,
        "seen": seen,
        "seen + 1": seen + 1,
        "features": hidden + (seen + 1 if decoupler.network.net == "skip" else 1),
        "components": 3 if forward is None else len(forward.rest_mm),
        "electrodes along 3": 6 * rows * cols,
        "units": rows * cols,
        "neighbours": 8,
        "own": OWN,
        "finite features": N_FEATURES,
        "components electrodes": 3 * electrodes if forward is None or forward.sign is None else forward.rest_mm.size,
        "draws": 0 if decoupler.ensemble is None else len(decoupler.ensemble),
        "drifts": 0 if decoupler.uncertainty is None else _n_drifts(decoupler.uncertainty.errors, rows, cols),
        "steps": 0 if decoupler.inverse is None else len(decoupler.inverse.correctors),
    }


def _n_drifts(errors: ReadingError, rows: int, cols: int) -> int:
    return errors.shared(np.ones((1, rows * cols)), rows, cols).shape[2]


def _holds_pillars(forward: ForwardModel) -> bool:
    n_electrodes = forward.influence.shape[1] // len(forward.rest_mm)
    near = np.zeros(1) if forward.maps is None else forward.maps.near
    stands = (forward.top >= 0) & (forward.top < n_electrodes)
    return bool(stands.all() and near.min() >= 0 and near.max() <= len(near))


def _errors(header: dict[str, Any]) -> ReadingError:
    """Errors of the readings; a drift that the header does not state is none."""
    return ReadingError(**{spec.name: header[spec.name] for spec in fields(ReadingError) if spec.name in header})


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

    def held(part: str) -> dict[str, Any]:
        """Fields of a part of the model, from the file's arrays."""
        places = {name: place.rpartition(".") for name, (place, _) in _ARRAYS.items()}
        mine = {field: name for name, (owner, _, field) in places.items() if owner == part}
        optional = ("sign", "drift_factor", "log_ohm", "log_ohm_covariance")
        return {field: arrays[name] for field, name in mine.items() if name in arrays or field not in optional}

    inverse = posterior = uncertainty = least_squares = None
    if network.feature == "inverse":
        inverse = ModelInverse(forward=ForwardModel(**held("inverse.forward")), **held("inverse"))
    if "maps_weights" in arrays:
        maps = StrainMaps(**held("posterior.forward.maps"))
        specimen = Specimen(**held("posterior.specimen")) if "specimen_factor" in arrays else None
        forward = ForwardModel(**held("posterior.forward"), maps=maps)
        posterior = Posterior(forward=forward, specimen=specimen, misfit=float(header["misfit"]), **held("posterior"))
    if "inverse_matrix" in arrays:
        uncertainty = Uncertainty(**held("uncertainty"), errors=_errors(header))
    component, dead = component_named(header["component"]), arrays.get("dead")
    if "least_squares" in arrays:
        least_squares = LeastSquares(component=component, **held("least_squares"), dead=dead)
    return Decoupler(
        component=component,
        rows=header["rows"],
        cols=header["cols"],
        network=network,
        input_scaling=Scaling(**held("input_scaling")),
        output_scaling=Scaling(**held("output_scaling")),
        hidden_weights=arrays["hidden_weights"],
        output_weights=arrays["output_weights"],
        design=None if header["design"] is None else design_from_toml(header["design"]),
        inverse=inverse,
        posterior=posterior,
        resting=Resting(**held("resting")) if "rest_ohm" in arrays else None,
        dead=dead,
        uncertainty=uncertainty,
        usual=UsualLoads(**held("usual")) if "friction" in arrays else None,
        ensemble=Ensemble(**held("ensemble")) if "drawn_resistance" in arrays else None,
        least_squares=least_squares,
        made_from=dict(header["made_from"]),
    )
