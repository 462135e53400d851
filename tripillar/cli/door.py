"""From a job, a public function with a typed signature, to a command.

Positional-only parameters are arguments, all others flags: `depth_mm` is --depth, its unit is in the help. Refusals
name parameters as Python has them, `hidden=0`, and are spelled as typed here, `--hidden 0`. With --json, -v or -q it
says how the answer and progress are printed.
"""

import inspect
import json
import math
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from common.errors import DesignError, TriPillarError
from tripillar.face.caller import Caller, Shown, called_by
from tripillar.face.inputs import Flag, options_of, require_numbers
from tripillar.terminal.entry import say, wrote
from tripillar.terminal.progress import Bars

Job = Callable[..., Any]
#: options that every command has
COMMON: dict[str, Any] = {
    "json": Annotated[bool, Flag(help="Print the result as one JSON object on stdout; of live one a line.")],
    "verbosity": Annotated[
        bool | None,
        Flag(
            name=("--verbose", "-v"),
            negative=("--quiet", "-q"),
            help="Print a line for each step and its time, or no progress at all.",
        ),
    ],
}
SECONDS = Annotated[float, Flag(help="Seconds after which to stop; default: on Ctrl-C.")]
UNIT = re.compile(r"_(mm|mpa|s|hz|deg|n)$")  #: at the end of a parameter's name


@dataclass(frozen=True, kw_only=True)
class Typed(Caller):
    """Somebody who typed a command: notes go to stderr, the answer to stdout once the job is done."""

    answers: list[tuple[Callable[[], dict[str, Any]], Shown, Sequence[Path], int]] = field(default_factory=list)

    def answer(
        self, result: Callable[[], dict[str, Any]], text: Shown, *files: Path | str | None, code: int = 0
    ) -> None:
        """Keep the answer for `show`."""
        self.answers.append((result, text, [Path(path) for path in files if path is not None], code))

    def tell(self, *lines: str) -> None:
        """Print lines on how the job is done, where they are in nobody's way."""
        print(*lines, sep="\n", file=sys.stderr if self.as_json else sys.stdout)

    def show(self, indent: int | None = 2) -> None:
        """Print the answer, of several jobs as one; without an indent JSON is one line."""
        if self.as_json and self.answers:
            together = {name: each for result, *_ in self.answers for name, each in result().items()}
            print(json.dumps(together, indent=indent), flush=True)
        for _, text, _, _ in () if self.as_json else self.answers:
            if callable(text):
                from tripillar.terminal.tables import show

                for table in text():
                    show(table)
            elif text:
                print(text, flush=True)

    def end(self) -> int:
        """Name every file written, last of all, on stderr; gives the exit code."""
        for _, _, files, _ in self.answers:
            wrote(files)
        return max((code for *_, code in self.answers), default=0)


def parameters_of(job: Job) -> Iterator[inspect.Parameter]:
    """Parameters of a job that can be typed, those of its `Options` in place of what holds them."""
    for given in _parameters_of(job):
        if typed_as(given)[1].parse:
            yield given


def _parameters_of(job: Job) -> Iterator[inspect.Parameter]:
    for given in inspect.signature(job).parameters.values():
        if given.kind is not given.VAR_KEYWORD:
            yield given
        for options in options_of(given):
            theirs = inspect.signature(options.source).parameters
            for name in options.names:
                hint = options.shown.get(name, theirs[name].annotation)
                yield theirs[name].replace(kind=given.KEYWORD_ONLY, annotation=hint)
    if inspect.isgeneratorfunction(inspect.unwrap(job)):
        yield inspect.Parameter("seconds", inspect.Parameter.KEYWORD_ONLY, default=math.inf, annotation=SECONDS)
    for name, hint in COMMON.items():
        default = False if name == "json" else None
        yield inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def typed_as(given: inspect.Parameter) -> tuple[Any, Flag]:
    """The type of a parameter and how it is typed; an argument has no name."""
    is_marked = get_origin(given.annotation) is Annotated
    hint, *marks = get_args(given.annotation) if is_marked else (given.annotation,)
    flag = next((mark for mark in marks if isinstance(mark, Flag)), Flag())
    if given.kind is given.POSITIONAL_ONLY or flag.name:
        return hint, flag
    name = flag_of(given.name)
    return hint, replace(flag, name=("--out", "-o") if name == "--out" else (name,))


def command_of(job: Job) -> Callable[..., int]:
    """The command of a job, which takes what was typed and gives the exit code."""
    flags = {given.name: next(iter(typed_as(given)[1].name), given.name) for given in parameters_of(job)}

    def command(*arguments: Any, json: bool = False, verbosity: bool | None = None, **options: Any) -> int:
        signalled, bars = 0, Bars(quiet=verbosity is False, verbose=verbosity is True)
        typed = Typed(say=lambda note: say(spelled(note, flags)), bars=bars, as_json=json, is_typed=True)
        with refusals(flags), called_by(typed):
            if inspect.isgeneratorfunction(inspect.unwrap(job)):
                seconds = options.pop("seconds", math.inf)
                require_numbers({"seconds": seconds})
                from hardware.session import ended_by_signal

                with job(*arguments, **options), ended_by_signal() as ending:  # before anybody knows that it runs
                    with bars:  # they end: what is waited for now has none
                        typed.show(indent=None)
                    wait(seconds, ending)
                    signalled = ending()
            else:
                with bars:
                    job(*arguments, **options)
                typed.show()
        code = typed.end()
        return 128 + signalled if signalled else code

    return command


def flag_of(name: str) -> str:
    """The flag of a parameter: its unit is left to the help.

    >>> flag_of("depth_mm"), flag_of("sense_ohm")
    ('--depth', '--sense-ohm')
    """
    return "--" + UNIT.sub("", name).replace("_", "-")


def spelled(text: str, flags: Mapping[str, str]) -> str:
    """A text with parameters as they are typed on the command line.

    >>> spelled("hidden=0 must be at least 1", {"hidden": "--hidden"})
    '--hidden 0 must be at least 1'
    >>> spelled("leave goal= and force=True out", {"goal": "--goal", "force": "--force"})
    'leave --goal and --force out'
    """
    for name, flag in flags.items():
        no = "--no-" + flag.removeprefix("--")
        text = re.sub(rf"\b{name}=True\b", flag, text)
        text = re.sub(rf"\b{name}=False\b", no, text)
        text = re.sub(rf"\b{name}=['\"]([^'\"]*)['\"]", rf"{flag} \1", text)
        text = re.sub(rf"\b{name}=(?=[^\s,;:)])", f"{flag} ", text)
        text = re.sub(rf"\b{name}=", flag, text)
    return text


@contextmanager
def refusals(flags: Mapping[str, str]) -> Iterator[None]:
    """Spell refusals that name parameters as they are typed."""
    try:
        yield
    except OSError:
        raise  # of a file, which it names
    except TriPillarError as error:
        raise DesignError(spelled(str(error), flags)) from error


def wait(seconds: float, is_ended: Callable[[], int]) -> None:
    """Wait for the end of the time, Ctrl-C or a termination."""
    end_s = time.monotonic() + seconds
    while not is_ended() and time.monotonic() < end_s:
        time.sleep(0.1)
