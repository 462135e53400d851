"""Inputs of jobs: an object or the file that holds it; the command line sees files alone.

Mistakes of names are refused here, before a stage is loaded, which takes seconds.
"""

import math
from collections.abc import Callable
from dataclasses import fields
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from geometry.design import SensorDesign
from geometry.design_file import read_design
from geometry.errors import DesignError, FileFormatError
from geometry.storage.files import require_file, require_folder

if TYPE_CHECKING:
    from dataset.samples import AnySamples
    from decoupler.data.pairs import Pairs
    from decoupler.model.decoupler import Decoupler
    from decoupler.touch.touch_file import AnyDecoder
    from fem.array.response import ArrayResponse
    from fem.scene.scene import Scene

    File = Path | str
    DesignLike = SensorDesign | File
    SamplesLike = AnySamples | File
    PairsLike = AnySamples | Pairs | File
    ModelLike = AnyDecoder | File
    SceneLike = Scene | File
    BodyLike = SensorDesign | Scene | File
else:
    File = DesignLike = SamplesLike = PairsLike = ModelLike = SceneLike = BodyLike = Path

Protocol = Literal[
    "independent-fz", "independent-fx", "contact-fz", "contact-fx", "contact", "three-axis",
    "light-fz", "light-fx", "light",
]  # fmt: skip
MAX_HEADER = 2**16  #: bytes of a table that are looked at for its separators
MAX_S = 3600.0  #: of any time that must end


class Options:
    """Mark of a job's ``**options``: they are those of a dataclass or of another job, and flags of the command line.

    `names` are those meant, all of a dataclass if there are none; `shown` has the types of those that are typed
    otherwise than Python takes them.
    """

    def __init__(self, source: Callable[..., Any], *names: str, **shown: Any) -> None:
        self.source, self.shown = source, shown
        self.names = names or tuple(signature(source).parameters)

    def meanings(self) -> dict[str, str]:
        """Help of each field of the dataclass, where no docstring of a job says it."""
        told = {each.name: each.metadata.get("meaning", "") for each in fields(self.source)}  # type: ignore[arg-type]
        return {name: f"{text[:1].upper()}{text[1:]}." for name, text in told.items()}


def given(**values: Any) -> dict[str, Any]:
    """Those that are not None."""
    return {name: value for name, value in values.items() if value is not None}


def design_of(source: "DesignLike | None") -> SensorDesign:
    """A design, or that of a file; the paper's sensor where none is given."""
    if source is None or isinstance(source, SensorDesign):
        return source or SensorDesign()
    return read_design(Path(source))


def samples_of(source: "SamplesLike", labels_only: bool = True) -> "AnySamples":
    """Samples, or those of a file."""
    if not isinstance(source, Path | str):
        return source
    from dataset import read_samples

    return read_samples(Path(source), labels_only=labels_only)


def model_of(source: "ModelLike") -> "AnyDecoder":
    """A model, or that of a file."""
    if not isinstance(source, Path | str):
        return source
    from decoupler.touch.touch_file import read_model

    return read_model(Path(source))


def pads_model_of(source: "ModelLike", what: str) -> "Decoupler":
    """A model of loads on pads; one of touch is refused."""
    from decoupler.model.decoupler import Decoupler

    model = model_of(source)
    if not isinstance(model, Decoupler):
        raise DesignError(f"{name_of(source, 'model')} is a decoder of touch: {what} takes a model of loads on pads.")
    return model


def response_of(design: SensorDesign, response: "ArrayResponse | None" = None) -> "ArrayResponse":
    """The response that is given, else that of the design, from the cache or solved."""
    if response is not None:
        return response
    from fem.array.solving import array_response

    return array_response(design)[0]


def name_of(source: object, otherwise: str) -> str:
    """Name of what a job was given, for messages: its file, if it is one."""
    return str(source) if isinstance(source, Path | str) else otherwise


def require_there(*sources: object, what: str) -> None:
    """Refuse a file to read that is not there, and a table whose columns are separated by semicolons."""
    for path in (Path(source) for source in sources if isinstance(source, Path | str)):
        if not path.exists():
            raise FileFormatError(f"{path}: no such file: give {what}.")
        if path.suffix == ".csv" and path.is_file():
            with path.open("rb") as file:
                header = file.readline(MAX_HEADER)
            if b";" in header and b"," not in header:
                raise FileFormatError(
                    f"{path}: its columns are separated by semicolons: separate them by commas, decimals by points."
                )


def to_write(name: str, path: "File | None", *endings: str, read: tuple[object, ...] = ()) -> Path | None:
    """The file that a job is to write; refused if it cannot be, if it ends otherwise, or if the job reads it."""
    if path is None:
        return None
    path = Path(path)
    if endings and path.suffix not in endings:
        *others, last = endings
        kinds = f"{', '.join(others)} or {last}" if others else last
        raise DesignError(f"{name}={path} must be a file that ends in {kinds}.")
    require_file(path)
    for source in read:
        if isinstance(source, Path | str) and path.exists() and Path(source).exists() and path.samefile(source):
            raise FileFormatError(f"{path} is read by this command: give another name for what it writes.")
    return path


def to_fill(path: "File") -> Path:
    """The folder that a job is to write to; refused if it cannot be."""
    require_folder(Path(path))
    return Path(path)


def require_above_0(**values: float) -> None:
    """Refuse times that are not above 0; only `seconds` may have no end."""
    for name, value in values.items():
        most = math.inf if name == "seconds" else MAX_S
        if not 0 < value <= most:
            raise DesignError(
                f"{name}={value:g} must be above 0{f' and at most {most:g}' if most < math.inf else ''} s."
            )


def require_counts(**counts: int | None) -> None:
    """Refuse numbers that must be at least 1."""
    for name, count in counts.items():
        if count is not None and count < 1:
            raise DesignError(f"{name}={count} must be at least 1.")


def require_packages(*names: str) -> None:
    """Refuse to begin without the packages of the extra `sweep`."""
    absent = [name for name in names if find_spec(name) is None]
    if absent:
        raise DesignError(f"{', '.join(absent)} not installed: pip install 'tripillar[sweep]'.")


def require_pool(workers: int | None, scheduler: str | None) -> None:
    """Refuse workers here and a scheduler at once, and a scheduler without the package that reaches it."""
    if scheduler is not None:
        require_packages("dask", "distributed")
        if workers is not None:
            raise DesignError("workers= are begun on this machine, scheduler= has its own: give one of them.")
