"""Messages for mistyped commands: one line with what was given, what is allowed, and where to read more."""

from typing import Any

#: kinds of pydantic's errors, in which typer says what a value is not
KINDS = {
    "float_parsing": "must be a number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
}


def in_one_line(error: Any) -> str:
    """The message of one of typer's exceptions; empty for a bare command, which has printed its help."""
    message = " ".join(error.format_message().split())
    faults: list[dict[str, Any]] = getattr(error.__cause__, "errors", list)()
    if faults and faults[0]["type"] in KINDS:
        message = f"{_spelled(error.param)} {faults[0]['input']} {KINDS[faults[0]['type']]}."
    elif faults and " is not one of " in message:
        allowed = message.partition(" is not one of ")[2].replace("'", "")
        message = f"{_spelled(error.param)} {faults[0]['input']} must be one of {allowed}"
    context = getattr(error, "ctx", None)
    message += "." if message[-1:].isalnum() or message.endswith(")") else ""
    return f"{message} See '{context.command_path} --help'." if message and context else message


def _spelled(parameter: Any) -> str:
    """How an option is typed; the name of an argument."""
    return parameter.opts[0] if parameter.param_type_name == "option" else parameter.name
