"""A touch decoder as one safetensors file; and whatever decoder a file holds."""

from dataclasses import fields
from pathlib import Path

from common.errors import FileFormatError
from common.storage.files import stated
from dataset.measurement import ReadingError
from decoupler.model import model_file
from decoupler.model.decoupler import Decoupler
from decoupler.model.model_file import built_of, opened_file, save_file
from decoupler.touch.bare import BareDecoder
from decoupler.touch.decoder import TouchDecoder
from decoupler.touch.plates import PlateDecoder
from geometry.design_file import design_from_toml, design_to_toml

AnyDecoder = Decoupler | TouchDecoder  #: of loads on pads, or of whatever presses
FORMAT = "tripillar-touch-2"
_MEND = "make it anew with 'tripillar train --touch'"


def write_touch(decoder: TouchDecoder, path: Path) -> None:
    """Write a touch decoder with the hash of its content, whole or not at all."""
    header = {
        "format": FORMAT,
        "design": design_to_toml(decoder.design),
        "design_hash": decoder.design_hash,
        "library": decoder.library.cache_key,
        "made_from": decoder.made_from,
    }
    save_file(header | stated(decoder.errors), decoder, path)


def read_model(path: Path) -> AnyDecoder:
    """Read a model file of `train`, of pads or of touch.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged, foreign, of an earlier version, or holds what makes no sense.
    """
    header, arrays = opened_file(path)
    if not str(header.get("format")).startswith(FORMAT[:-1]):
        return model_file.read_model(path)
    try:
        if header["format"] != FORMAT:
            raise ValueError(f"format is {header['format']}, not {FORMAT}")
        design = design_from_toml(header["design"])
        said = {
            "design": design,
            "errors": ReadingError(
                **{each.name: header[each.name] for each in fields(ReadingError) if each.name in header}
            ),
            "made_from": dict(header["made_from"]),
            "library.cache_key": str(header["library"]),
        }
        kind = PlateDecoder if design.pad.kind == "stiff" else BareDecoder
        found: TouchDecoder = built_of(kind, arrays, said)
        found.touches(0.99 * found.rest_resistances()[None])  # no decoder is given out that cannot
        return found
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise FileFormatError(f"{path}: its parts do not belong together ({error}): {_MEND}.") from None
