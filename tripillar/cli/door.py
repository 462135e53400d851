"""From a job, a public function with a typed signature, to a command.

Positional-only parameters are arguments, all others flags: `depth_mm` is --depth, its unit is in the help. Refusals
name parameters as Python has them, `hidden=0`, and are spelled as typed here, `--hidden 0`. With --json, -v or -q it
says how the answer and progress are printed.
"""

import inspect
import json
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, get_args, get_origin

from common.errors import DesignError, TriPillarError
from common.quantity import quantity
from tripillar.face.caller import Caller, called_by
from tripillar.face.inputs import Flag, Options, options_of, require_numbers
from tripillar.terminal.entry import say, wrote
from tripillar.terminal.progress import Bars

Job = Callable[..., Any]
UNIT = re.compile(r"_(mm|mpa|s|hz|deg|n)$")  #: at the end of a parameter's name


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options that every command has."""

    json: bool = quantity(False, "print the result as one JSON object on stdout; of live one a line")
    verbosity: bool | None = quantity(None, "print a line for each step and its time, or no progress at all")


@dataclass(frozen=True, kw_only=True)
class Ending:
    """Options of a job that lasts until it is ended."""

    seconds: float = quantity(math.inf, "seconds after which to stop; default: on Ctrl-C")


TALK = Flag(name=("--verbose", "-v"), negative=("--quiet", "-q"))
COMMON, ENDING = Options(Common, verbosity=Annotated[bool | None, TALK]), Options(Ending)


def show(caller: Caller, indent: int | None = 2) -> None:
    """Print the answers of a job, in JSON as one object; without an indent it is one line."""
    if caller.as_json and caller.answers:
        together = {name: each for result, *_ in caller.answers for name, each in result().items()}
        print(json.dumps(together, indent=indent), flush=True)
    for _, text, _, _ in () if caller.as_json else caller.answers:
        if callable(text):
            from tripillar.terminal.tables import show as show_table

            for table in text():
                show_table(table)
        elif text:
            print(text, flush=True)


def typed_options(job: Job) -> list[Options]:
    """Options of a job that are those of something else, and those of its command."""
    found = [each for given in inspect.signature(job).parameters.values() for each in options_of(given)]
    return [*found, ENDING, COMMON] if lasts(job) else [*found, COMMON]


def lasts(job: Job) -> bool:
    """The job is a with block, which its command holds open until it is ended."""
    return inspect.isgeneratorfunction(inspect.unwrap(job))


def parameters_of(job: Job) -> Iterator[tuple[inspect.Parameter, Any, Flag]]:
    """Parameters of a job that can be typed, each with its type and how it is typed; an argument has no name."""
    own = [given for given in inspect.signature(job).parameters.values() if given.kind is not given.VAR_KEYWORD]
    for given in (*own, *(each for options in typed_options(job) for each in options.parameters())):
        is_marked = get_origin(given.annotation) is Annotated
        hint, *marks = get_args(given.annotation) if is_marked else (given.annotation,)
        flag = next((mark for mark in marks if isinstance(mark, Flag)), Flag())
        if not (given.kind is given.POSITIONAL_ONLY or flag.name):
            name = flag_of(given.name)
            negative = ("--no-" + name.removeprefix("--"),) if given.default is True else ()
            flag = replace(flag, name=("--out", "-o") if name == "--out" else (name,), negative=negative)
        if hint is not None:
            yield given, hint, flag


def command_of(job: Job) -> Callable[..., int]:
    """The command of a job, which takes what was typed and gives the exit code."""
    flags = {given.name: next(iter(flag.name), given.name) for given, _, flag in parameters_of(job)}

    def command(*arguments: Any, json: bool = False, verbosity: bool | None = None, **options: Any) -> int:
        signalled, bars = 0, Bars(quiet=verbosity is False, verbose=verbosity is True)
        typed = Caller(say=lambda note: say(spelled(note, flags)), bars=bars, as_json=json, is_typed=True)
        try:
            with called_by(typed):
                if lasts(job):
                    seconds = options.pop("seconds", math.inf)
                    require_numbers({"seconds": seconds})
                    from hardware.session import ended_by_signal

                    with job(*arguments, **options), ended_by_signal() as ending:  # before anybody knows that it runs
                        with bars:  # they end: what is waited for now has none
                            show(typed, indent=None)
                        wait(seconds, ending)
                        signalled = ending()
                else:
                    with bars:
                        job(*arguments, **options)
                    show(typed)
        except TriPillarError as error:
            if isinstance(error, OSError):
                raise  # of a file, which it names
            raise DesignError(spelled(str(error), flags)) from error
        for _, _, files, _ in typed.answers:  # last of all, on stderr
            wrote(files)
        return 128 + signalled if signalled else max((code for *_, code in typed.answers), default=0)

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
        text = re.sub(rf"\b{name}=(?!\.?([\s,;:)]|$))", f"{flag} ", text)
        text = re.sub(rf"\b{name}=", flag, text)
    return text


def wait(seconds: float, is_ended: Callable[[], int]) -> None:
    """Wait for the end of the time, Ctrl-C or a termination."""
    end_s = time.monotonic() + seconds
    while not is_ended() and time.monotonic() < end_s:
        time.sleep(0.1)
