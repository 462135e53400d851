"""Inputs of jobs: an object or the file that holds it; the command line sees files alone.

`job` makes a job of a function: mistakes of names are refused there, before a stage is loaded, which takes seconds.
"""

import functools
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, TypeVar, get_args

from common.bounded import require_regular
from common.errors import ArgumentError, DesignError, FileFormatError
from common.quantity import quantity
from common.storage.files import require_file, require_folder
from geometry.design import SensorDesign
from geometry.design_file import read_design
from tripillar.face import stages
from tripillar.face.caller import current

if TYPE_CHECKING:
    File = Path | str
    DesignLike = SensorDesign | File
    SamplesLike = stages.AnySamples | File
    PairsLike = stages.AnySamples | stages.Pairs | File
    ModelLike = stages.Decoder | File
    SceneLike = stages.Scene | File
    BodyLike = SensorDesign | stages.Scene | File
else:
    File = DesignLike = SamplesLike = PairsLike = ModelLike = SceneLike = BodyLike = Path

Protocol = Literal[
    "independent-fz", "independent-fx", "contact-fz", "contact-fx", "contact", "three-axis",
    "light-fz", "light-fx", "light",
]  # fmt: skip
Circuit = Literal["zero-potential", "grounded", "divider", "four-wire"]  #: that reads an array
TIMES = {"seconds": math.inf, "timeout": 3600.0}  #: arguments that must be above 0, and the most that they may be [s]
COUNTS = ("workers", "trials", "best", "pairs")  #: arguments that must be at least 1
P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class Flag:
    """Mark of a job's parameter that is typed otherwise than its name and type say; one of type None is not typed."""

    name: tuple[str, ...] = ()  #: how it is typed; default: by its name
    negative: tuple[str, ...] = ()  #: how the opposite of a bool is typed; default: --no-NAME of what is else true
    required: bool = False  #: on the command line, where a default would be written to a file unasked


class Options:
    """Mark of a job's ``**options``: they are those of a dataclass or of another job, and flags of the command line.

    `names` are those meant, all if there are none; `shown` has the types of those that are typed otherwise than Python
    takes them, None of those that are not typed.
    """

    def __init__(self, source: Callable[..., Any], *names: str, **shown: Any) -> None:
        self.source, self.shown = source, shown
        self.names = names or tuple(inspect.signature(source).parameters)

    def meanings(self) -> dict[str, str]:
        """Help of each field of the dataclass, where no docstring of a job says it."""
        told = {each.name: each.metadata.get("meaning", "") for each in fields(self.source)}  # type: ignore[arg-type]
        return {name: f"{text[:1].upper()}{text[1:]}." for name, text in told.items()}

    def parameters(self) -> list[inspect.Parameter]:
        """The options as keywords, with the types that are typed."""
        theirs = inspect.signature(self.source).parameters
        hints = {name: self.shown.get(name, theirs[name].annotation) for name in self.names}
        return [theirs[name].replace(kind=theirs[name].KEYWORD_ONLY, annotation=hints[name]) for name in self.names]

    def of(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Those of them that are given."""
        return {name: given[name] for name in self.names if given.get(name) is not None}


@dataclass(frozen=True, kw_only=True)
class Board:
    """Reach of a board, as `hardware.Scanner` takes it, and what is known of its sensor."""

    calibration: File | None = quantity(None, "calibration file of this sensor; default: as designed, switches of 25 Ω")
    baud: int = quantity(1_000_000, "speed of the serial port [bit/s]")
    timeout: float = quantity(4.0, "time to wait for the board's answer [s]")
    rows: int | None = quantity(None, "rows of a board or log of plain numbers, one a unit")
    cols: int | None = quantity(None, "columns of a board or log of plain numbers")
    bits: int | None = quantity(None, "bits of the converter, if plain numbers are its counts; default: readings")
    circuit: Circuit | None = quantity(None, "circuit before the converter of such counts; default: divider")
    sense_ohm: float | None = quantity(None, "sense or feedback resistor of that circuit [Ω]; default: 10000")


@dataclass(frozen=True, kw_only=True)
class Wires:
    """Resistances of a crossbar's electronics [Ω]; None: as designed."""

    switch_ohm: float | None = quantity(None, "resistance of a closed switch [Ω]; default: 25")
    line_ohm: float | None = quantity(None, "resistance of a wire to the pillars [Ω]; default: 0")


#: of `dataset.Imperfections`: what is broken, as the command line takes it
BROKEN = {
    "dead_pillars": Annotated[Sequence[str], Flag(name=("--dead-pillar",))],
    "dead_rows": Annotated[Sequence[int], Flag(name=("--dead-row",))],
    "dead_cols": Annotated[Sequence[int], Flag(name=("--dead-col",))],
}


def imperfections(given: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of `dataset.Imperfections`, with those of what is broken as it takes them."""
    from dataset.imperfections import place_of  # of a job that needs no samples nothing of them is loaded

    found = {name: tuple(value) if name in BROKEN else value for name, value in given.items()}
    places = tuple(place_of(at) if isinstance(at, str) else at for at in found.get("dead_pillars", ()))
    return found | ({"dead_pillars": places} if places else {})


BOARD, WIRES = Options(Board), Options(Wires)
LINES = Options(Board, "rows", "cols", "bits", "circuit", "sense_ohm")  #: of a log of plain numbers
BARE_BOARD = Options(Board, "baud", "timeout", *LINES.names)  #: of a board whose calibration is yet to be found


def options_of(parameter: inspect.Parameter) -> list[Options]:
    """The options of other functions or dataclasses that a parameter holds."""
    return [each for each in get_args(parameter.annotation) if isinstance(each, Options)]


def job(**writes: str | None) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make a job of a function: its files, times and counts are checked before it begins.

    `writes` has, by the parameters that name what is written, the endings that files may have, "/" of folders, None of
    what the job checks itself. All other files are read: they must be there, and are not written over.
    """

    def made(function: Callable[P, R]) -> Callable[P, R]:
        parameters = inspect.signature(function).parameters
        rest = next((name for name, each in parameters.items() if each.kind is each.VAR_KEYWORD), "")
        options = options_of(parameters[rest]) if rest else []
        known = {each.name: each for source in options for each in source.parameters()}
        takes = {**parameters, **known}
        read = [name for name, each in takes.items() if _takes_path(each.annotation) and name not in writes]

        @functools.wraps(function)
        def checked(*arguments: P.args, **options: P.kwargs) -> R:
            bound = inspect.signature(function).bind(*arguments, **options)
            bound.apply_defaults()
            more = bound.arguments.pop(rest, {})
            if known and (unknown := set(more) - set(known)):
                raise ArgumentError(f"{unknown.pop()}= is no argument; there are {', '.join(sorted(known))}.")
            given = {**bound.arguments, **more}
            require_numbers(given)
            sources = [given.get(name) for name in read]
            for source in sources:
                require_there(source)
            for name, endings in writes.items():
                if endings is not None:
                    to_write(name, given.get(name), endings, sources)
            return function(*arguments, **options)

        return checked

    return made


def _takes_path(hint: Any) -> bool:
    return hint is Path or any(map(_takes_path, get_args(hint)))


def require_numbers(given: Mapping[str, Any]) -> None:
    """Refuse times that are not above 0, and counts below 1."""
    for name, most in TIMES.items():
        if (value := given.get(name)) is not None and not 0 < value <= most:
            raise DesignError(
                f"{name}={value:g} must be above 0{'' if name == 'seconds' else f' and at most {most:g}'} s."
            )
    for name in COUNTS:
        if (value := given.get(name)) is not None and value < 1:
            raise DesignError(f"{name}={value} must be at least 1.")


def require_there(source: Any) -> None:
    """Refuse a file to read, or several, that are not there."""
    for path in source if isinstance(source, list | tuple) else [source]:
        if not isinstance(path, Path | str):
            continue
        if not Path(path).exists():
            raise FileFormatError(f"{path}: no such file.")
        require_regular(Path(path), "give a file")


def to_write(name: str, path: "File | None", endings: str = "", read: Sequence[Any] = ()) -> None:
    """Refuse a file or folder that cannot be written, ends otherwise, or is read by the job."""
    if path is None:
        return
    path = Path(path)
    if endings == "/":
        require_folder(path)
        return
    if endings and path.suffix not in endings.split():
        raise DesignError(f"{name}={path} must be a file that ends in {' or '.join(endings.split())}.")
    if path.suffix != ".zarr":
        require_file(path)
    for source in read:
        for each in source if isinstance(source, list | tuple) else [source]:
            if isinstance(each, Path | str) and path.exists() and Path(each).exists() and path.samefile(each):
                raise FileFormatError(f"{path} is read by this command: give another name for what it writes.")


def design_of(source: "DesignLike | None") -> SensorDesign:
    """A design, or that of a file; the paper's sensor where none is given."""
    if source is None or isinstance(source, SensorDesign):
        return source or SensorDesign()
    return read_design(Path(source))


def samples_of(source: "SamplesLike", labels_only: bool = True) -> "stages.AnySamples":
    """Samples, or those of a file; of series their moments."""
    found = stages.read_samples(Path(source), labels_only=labels_only) if isinstance(source, Path | str) else source
    if getattr(found, "time_s", None) is None:
        return found
    if found.design is not None and found.design.pillar_material != found.design.pillar_material.settled:
        current().say("series are taken moment by moment, as if the rubber remembered nothing")
    return stages.in_memory(found).at_moments()


def model_of(source: "ModelLike") -> "stages.Decoder":
    """A model, or that of a file."""
    return stages.read_model(Path(source)) if isinstance(source, Path | str) else source


def name_of(source: object, otherwise: str) -> str:
    """Name of what a job was given, for messages: its file, if it is one."""
    return str(source) if isinstance(source, Path | str) else otherwise


def require_packages(extra: str = "", *names: str) -> None:
    """Refuse to begin without packages of an extra."""
    absent = [name for name in names if find_spec(name) is None]
    if absent:
        raise DesignError(f"{', '.join(absent)} not installed: pip install 'tripillar[{extra}]'.")
