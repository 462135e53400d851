"""Write docs/commands.md from the commands themselves; `make docs` does so, and a test holds the file to them."""

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from tripillar.cli.app import app
from tripillar.terminal.console import HEADINGS

PAGE = Path(__file__).parents[1] / "commands.md"

TITLE = """# Commands

Every command with all its options, as `tripillar COMMAND --help` prints them; this page is made from the commands
themselves. Results go to stdout (with `--json` as one object), progress and names of files to stderr. A mistake is one
line and exit code 2."""


def reference(group: Any) -> str:
    """The whole page, Markdown, of a group of commands."""
    with typer.Context(group, info_name="tripillar") as context:
        blocks = [TITLE, "\n".join(options_of(group, context))]
        for heading in HEADINGS:
            blocks.append(f"## {heading}")
            for name, command in group.commands.items():
                if command.rich_help_panel == heading:
                    blocks += section(name, command, context)
    return "\n\n".join(blocks) + "\n"


def section(name: str, command: Any, parent: Any) -> Iterator[str]:
    """What one command does, how it is typed, its arguments and options."""
    with typer.Context(command, info_name=name, parent=parent) as context:
        yield f"### {name}"
        yield inspect.cleandoc(command.help)
        yield f"    {context.command_path} {' '.join(command.collect_usage_pieces(context))}"
        yield "\n".join(options_of(command, context))


def options_of(command: Any, context: Any) -> Iterator[str]:
    """A line for each argument and option but --help: how it is typed, what it means, its default."""
    for parameter in command.params:
        typed, meaning = parameter.get_help_record(context)
        yield f"- `{typed}`: {' '.join(meaning.split())}"


if __name__ == "__main__":
    PAGE.write_text(reference(typer.main.get_command(app)), encoding="utf-8")
