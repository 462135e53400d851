"""The parser of the command line, by cyclopts: flags, help, completion in a shell, mistakes.

A job's signature says what may be typed, what its docstring says of a parameter is its help.
"""

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from importlib import metadata
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import cyclopts
from cyclopts import App, Group, Parameter, Token
from docstring_parser import parse

from common.errors import DesignError
from tripillar.cli.commands import COMMANDS, job_of
from tripillar.cli.door import Job, command_of, parameters_of, typed_options
from tripillar.cli.help import Columns
from tripillar.cli.plain import without_none

ABOUT = """Simulate a three-axis tactile sensor, train the network that reads its forces, and read them from a board.

`tripillar COMMAND --help` explains a command. New here? Begin with `tripillar doctor`, then `tripillar design`."""


def app_of(*names: str) -> App:
    """The program with these commands; default: with all."""
    app = App(
        name="tripillar",
        help=ABOUT,
        help_format="plaintext",  # a unit in brackets, [s], is no markup
        help_formatter=Columns(),
        result_action="return_value",
        version=lambda: f"tripillar {metadata.version('tripillar')}",
        version_flags="--version",
        group_parameters=Group("Options", sort_key=1),
        group_arguments=Group("Arguments", sort_key=0),
        exit_on_error=False,
        print_error=False,
    )
    app.register_install_completion_command(help="Let the shell complete commands, options and choices.")
    for number, (heading, commands) in enumerate(COMMANDS.items()):
        group = Group(heading, sort_key=number)
        for place, name in enumerate(commands):
            if not names or name in names:
                app.command(parsed(job_of(name)), name=name, group=group, sort_key=place)
    return app


def run_app(app: App, words: Sequence[str]) -> int:
    """The exit code of what was typed; a `DesignError` if it cannot be parsed."""
    try:
        return int(app(words) or 0)
    except cyclopts.CycloptsError as error:
        raise DesignError(_in_one_line(error)) from None


def parsed(job: Job) -> Callable[..., int]:
    """The command of a job, with the signature and docstring that the parser reads."""
    command, told, parameters = command_of(job), meanings(job), []
    for given, hint, flag in parameters_of(job):
        several = without_none(hint)
        has_default = not (given.default in (None, (), math.inf) or isinstance(given.default, bool))
        mark = Parameter(
            name=flag.name or None, negative=flag.negative, required=flag.required or None, help=told.get(given.name),
            show_default=has_default, consume_multiple=get_origin(several) is list or ... in get_args(several),
            converter=whole if hint in WHOLE else None,
        )  # fmt: skip
        kind = given.POSITIONAL_ONLY if given.kind is given.POSITIONAL_ONLY else given.KEYWORD_ONLY
        parameters.append(given.replace(kind=kind, annotation=Annotated[hint, mark]))
    docstring = parse(inspect.getdoc(job) or "")
    paragraphs = [docstring.short_description or "", *(docstring.long_description or "").split("\n\n")]
    command.__doc__ = "\n\n".join(" ".join(each.split()) for each in paragraphs).replace("``", "'")
    command.__name__ = job.__name__
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command


def meanings(job: Job) -> dict[str, str]:
    """Help of each parameter by the docstrings of the job and of whatever has its options."""
    found: dict[str, str] = {}
    for options in typed_options(job):
        theirs = options.meanings() if is_dataclass(options.source) else meanings(options.source)
        found |= {name: theirs[name] for name in options.names}
    for each in parse(inspect.getdoc(job) or "").params:
        found[each.arg_name] = " ".join((each.description or "").split()).replace("``", "'").replace("`", "'")
    return found


def whole(hint: Any, tokens: Sequence[Token]) -> int | tuple[int, ...]:
    """Whole numbers that were typed; 1.5 is none."""
    numbers = tuple(int(token.value) for token in tokens)
    return numbers if get_origin(hint) is not None and get_origin(hint) not in (Union, UnionType) else numbers[0]


WHOLE = (int, int | None, Sequence[int])


def _in_one_line(error: Any) -> str:
    """What is wrong with what was typed, and where its help is."""
    message = " ".join(str(error).split()).partition(" Available commands")[0]
    argument, token = error.argument, getattr(error, "token", None)
    if isinstance(error, cyclopts.MissingArgumentError) and argument is not None:
        typed = argument.name if error.keyword is None else error.keyword
        choices = ", ".join(argument.get_choices(force=True) or ())
        meaning = (argument.parameter.help or "").rstrip(".")
        message = (
            f"{typed} is missing: {f'one of {choices}' if choices else meaning}."
            if error.keyword is None
            else f"{typed} needs {'a value' if (count := argument.token_count()[0]) == 1 else f'{count} values'}."
        )
    elif isinstance(error, cyclopts.CoercionError) and argument is not None and token is not None:
        kinds = {error.target_type, *get_args(error.target_type)}
        choices = argument.get_choices(force=True)
        must = "a whole number" if int in kinds else "a number" if float in kinds else "of another kind"
        must = f"one of {', '.join(choices)}" if choices else must
        message = f"{token.keyword or argument.name} {token.value} must be {must}."
    elif isinstance(error, cyclopts.UnusedCliTokensError):
        message = f"unexpected extra argument: {' '.join(error.unused_tokens or ())}."
    command = " ".join(("tripillar", *(error.command_chain or ())))
    return f"{message.replace(chr(34), chr(39))} See '{command} --help'."
