"""A trained network as one safetensors file whose header explains it: configuration, design, data hash."""

import json
from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from common.errors import FileFormatError
from common.storage.files import digest, stated, write_bytes
from common.storage.seal import BLANK, KEY, MARK, require_intact, sealed
from dataset.imperfections import PAPERS
from dataset.measurement import ReadingError
from dataset.samples import AnySamples
from decoupler.data.columns import component_named
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoder import Decoder
from decoupler.model.decoupler import Decoupler
from decoupler.model.front import POWERS
from decoupler.model.network import form_named
from decoupler.model.settings import NetworkConfig, TrainingConfig
from geometry.design import Drifts, SensorDesign
from geometry.design_file import design_from_toml, design_to_toml
from geometry.layout_file import layout_from_text, layout_text
from geometry.tolerances import uncertain_keys

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

FORMAT = "tripillar-model-3"  #: of a network; 2 had parts that may be missing
TOUCH = "tripillar-touch-3"  #: of a decoder of touch
METHOD = 9  #: raise when the same settings train another file, so that old models are not reused
HEADER = "tripillar"  #: the entry of the file's metadata that holds all of ours
_MEND = "give a file made by 'tripillar train'"


def model_cache_key(
    data: AnySamples,
    component: str,
    network: NetworkConfig,
    training: TrainingConfig,
    response: "ArrayResponse | None" = None,
) -> str:
    """Hash of all that a network depends on; a file whose ``made_from["recipe"]`` equals it is current."""
    known = response.content_hash if response is not None and network.feature in ("inverse", "auto") else ""
    dead = data.dead if data.dead is not None and data.dead.any() else None
    parts = (FORMAT, METHOD, data.content_hash, data.noise, data.bits, dead, component, network, training, known)
    later = [data.is_finite] if data.is_finite.any() else []
    return digest(*parts, *later, *([data.errors] if data.errors.has_drift else []))


def write_model(decoder: Decoder, path: Path) -> None:
    """Write a decoder's file with the hash of its content, whole or not at all."""
    header: dict[str, Any] = {
        "design": None if decoder.design is None else design_to_toml(decoder.design),
        "design_hash": decoder.design_hash,
        "made_from": decoder.made_from,
    }
    header |= stated(decoder.errors)
    if not isinstance(decoder, Decoupler):
        save_file(header | {"format": TOUCH}, decoder, path)
        return
    header |= {"format": FORMAT, "component": decoder.component.name, "network": asdict(decoder.form)}
    if decoder.design is None and decoder.layout != PAPERS:
        header["layout"] = layout_text(decoder.layout)
    if isinstance(decoder, DecouplerAtStrain):
        header["misfit"] = decoder.posterior.misfit
    save_file(header, decoder, path)


def read_network(path: Path) -> Decoupler:
    """Read the file of a network; that of a decoder of touch is a `FileFormatError`, too."""
    decoder = read_model(path)
    if not isinstance(decoder, Decoupler):
        raise FileFormatError(f"{path} holds a decoder of touch, no network: give a file made by 'tripillar train'.")
    return decoder


def read_model(path: Path) -> Decoder:
    """Read the file of any decoder; it gives the same bits as the one that was written.

    One that is missing, damaged, foreign, of an earlier version, or holds what makes no sense is a `FileFormatError`.
    """
    header, arrays = opened_file(path)
    try:
        decoder = _decoder_of(header, arrays)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise FileFormatError(f"{path}: its header makes no sense ({error}): {_MEND}.") from None
    try:
        with np.errstate(all="ignore"):  # what comes of it is looked at
            _try_out(decoder)
    except (ValueError, IndexError, TypeError, AttributeError, AssertionError) as error:
        said = " ".join(str(error).split())
        raise FileFormatError(f"{path}: its arrays do not belong together ({said}): {_MEND}.") from None
    return decoder


def opened_file(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file of `save_file`; one that is missing, damaged or foreign is a `FileFormatError`."""
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
        return dict(json.loads(metadata[HEADER])), arrays
    except (TypeError, ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: its header makes no sense ({error}): {_MEND}.") from None


def save_file(header: dict[str, Any], part: Any, path: Path) -> None:
    """Write a header and the arrays of a dataclass with the hash of their content, whole or not at all."""
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays_of(part)}
    content = save(arrays, {HEADER: json.dumps({KEY: BLANK.decode()} | header)})  # safetensors shuffles several
    write_bytes(path, *sealed(content))


def require_same_sensor(decoupler: Any, data: AnySamples, model: Path, dataset: Path) -> None:
    """Refuse data of another sensor than the model's by a `FileFormatError`; `model` and `dataset` are named in it.

    Of another size, or, where both sides state their design, of another value of it but drifts and what rubber
    remembers, which training leaves out; of a twin of one that it does not find out.
    """
    rows, cols = data.shape
    differences = [
        f"{name}: model {ours}, data {theirs}"
        for name, ours, theirs in (
            ("rows", decoupler.rows, rows),
            ("cols", decoupler.cols, cols),
            ("layout", layout_text(decoupler.layout), layout_text(data.layout)),
        )
        if ours != theirs
    ]
    if not differences and decoupler.design is not None and data.design is not None:
        made_from = {**decoupler.made_from, **data.made_from}
        of_twin = "twin" in made_from or len(getattr(decoupler, "ensemble", ())) > 0
        differences = _design_differences(decoupler.design, data.design, of_twin)
    if differences:
        raise FileFormatError(
            f"{model} was trained for another sensor than that of {dataset} ({'; '.join(differences)}): "
            "train a model on data of this design."
        )


def _design_differences(model: SensorDesign, data: SensorDesign, of_twin: bool = False) -> list[str]:
    ours, theirs = _flat(asdict(model)), _flat(asdict(data))
    free = uncertain_keys(model) | uncertain_keys(data) if of_twin else set()  # as it was meant, as it was measured
    # how far readings drift, and what rubber remembers, makes no other sensor
    free |= {f"electrics.{spec.name}" for spec in fields(Drifts)}
    free |= {name for name in ours if name.startswith(("pillar_material.memory.", "pillar_material.prony."))}
    return [
        f"{name}: model {_shown(ours[name])}, data {_shown(theirs[name])}"
        for name in ours
        if ours[name] != theirs[name] and name not in free and not name.startswith("unit.layout.")  # told before
    ]


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"


def _flat(table: dict[str, Any], group: str = "") -> dict[str, float | str]:
    """{"array": {"pitch_mm": 15}} -> {"array.pitch_mm": 15}."""
    flat: dict[str, float | str] = {}
    for name, value in table.items():
        flat |= _flat(value, f"{group}{name}.") if isinstance(value, dict) else {f"{group}{name}": value}
    return flat


def arrays_of(part: Any, path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of a model, or of a part, with their paths; the dead pillars once, as the model's own."""
    for spec in fields(part):
        value, name = getattr(part, spec.name), f"{path}{spec.name}"
        if isinstance(value, np.ndarray) and name != "least_squares.dead":
            yield name, value
        elif is_dataclass(value) and not isinstance(value, SensorDesign | type):
            yield from arrays_of(value, f"{name}.")


def _try_out(decoder: Decoder) -> None:
    """Decode two scans, so that no decoder is given out that cannot."""
    for name, array in arrays_of(decoder):
        if array.dtype.kind not in "fib" or not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
    rest_ohm = decoder.rest_resistances()
    if rest_ohm is None:
        rest_ohm = np.full((decoder.rows, decoder.cols, len(decoder.layout.pillars)), 1e4)
    scans = np.stack([rest_ohm, 0.9 * rest_ohm])
    answers: dict[str, Any] = {"force": decoder.forces(scans), "half-width": decoder.half_widths(scans)[1]}
    answers["test of loads"] = decoder.consistency(scans) or 0.0
    for name, values in answers.items():
        if not np.isfinite(values).all():
            raise ValueError(f"the {name} of a scan is not finite")


def _decoder_of(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Decoder:
    is_touch = str(header["format"]).startswith(TOUCH[:-1])
    if header["format"] != (wanted := TOUCH if is_touch else FORMAT):
        raise ValueError(f"format is {header['format']}, not {wanted}: of another version, train it again")
    if not str(header[KEY]).startswith(MARK.decode()):
        raise ValueError(f"{KEY} is {header[KEY]!r}, no hash")
    design: Any = None if header["design"] is None else design_from_toml(header["design"])
    # a drift that is not stated is none
    errors = ReadingError(**{each.name: header[each.name] for each in fields(ReadingError) if each.name in header})
    said: dict[str, Any] = {"design": design, "errors": errors, "made_from": dict(header["made_from"])}
    if is_touch:
        from decoupler.touch.bare import BareDecoder  # of few files
        from decoupler.touch.plates import PlateDecoder

        found: Decoder = built_of(PlateDecoder if design.pad.kind == "stiff" else BareDecoder, arrays, said)
        return found
    if set(header["network"]) != (known := {spec.name for spec in fields(NetworkConfig)}):
        raise ValueError(f"network has the keys {sorted(header['network'])}, not {sorted(known)}")
    form, component = NetworkConfig(**header["network"]), component_named(header["component"])
    layout = layout_from_text(header.get("layout", "")) if design is None else design.unit.layout
    said |= {
        "component": component,
        "form": form,
        "layout": layout,
        "posterior.misfit": header.get("misfit", 0.0),
        "least_squares.component": component,
        "least_squares.dead": arrays.get("dead"),
        "least_squares.layout": layout,
    }
    if form.feature in POWERS:
        said["front.feature"] = POWERS[form.feature]
    kind = DecouplerAtStrain if "misfit" in header else Decoupler
    found = built_of(kind, arrays, said, {"network": form_named(form.net)})
    return found


def built_of(
    kind: Any, arrays: dict[str, np.ndarray], said: dict[str, Any], kinds: dict[str, Any] | None = None, path: str = ""
) -> Any:
    """A part of a model from the arrays below its path and what the header says; parts without arrays are left out.

    `kinds` are classes of parts, by their paths, whose hint names but what they have in common.
    """
    values, kinds = {}, kinds or {}
    for name, hint in get_type_hints(kind).items():
        whole, (inner, *_) = f"{path}{name}", get_args(hint) or (hint,)
        inner = kinds.get(whole, inner)
        if whole in arrays or whole in said:
            values[name] = said[whole] if whole in said else arrays[whole]
        elif is_dataclass(inner) and any(one.startswith(f"{whole}.") for one in arrays):
            values[name] = built_of(inner, arrays, said, kinds, f"{whole}.")
    return kind(**values)
