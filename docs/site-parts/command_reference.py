"""Write docs/commands.md from the commands themselves; `make docs` does so, and a test holds the file to them."""

import inspect
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from tripillar.cli.app import app
from tripillar.terminal.console import HEADINGS

PAGE = Path(__file__).parents[1] / "commands.md"
COMMON = 3  #: commands from which on an option of theirs is told once for all

TITLE = """# Commands

Every command with its options, as `tripillar COMMAND --help` prints them; this page is made from the commands
themselves. Results go to stdout (with `--json` as one object), progress and names of files to stderr. A mistake is one
line and exit code 2. *Also* names the options that are told here, since many commands have them:"""


def reference(group: Any) -> str:
    """The whole page, Markdown, of a group of commands."""
    with typer.Context(group, info_name="tripillar") as context:
        own = list(options_of(group, context))
        told = {name: list(options_of(command, context)) for name, command in group.commands.items()}
        counts = Counter(line for lines in told.values() for line in lines)
        common = [line for line, count in counts.items() if count >= COMMON]
        blocks = [TITLE, "\n".join(own + common)]
        for heading in HEADINGS:
            blocks.append(f"## {heading}")
            for name, command in group.commands.items():
                if command.rich_help_panel == heading:
                    blocks += section(name, command, context, common)
    return "\n\n".join(blocks) + "\n"


def section(name: str, command: Any, parent: Any, common: list[str]) -> Iterator[str]:
    """What one command does, how it is typed if it has arguments, its options."""
    with typer.Context(command, info_name=name, parent=parent) as context:
        yield f"### {name}"
        yield inspect.cleandoc(command.help)
        typed = " ".join(command.collect_usage_pieces(context)).removeprefix("[OPTIONS]").strip()
        if typed:
            yield f"    {context.command_path} {typed}"
        lines = list(options_of(command, context))
        also = [line.split("`")[1].split()[0].rstrip(",") for line in lines if line in common]
        if own := [line for line in lines if line not in common]:
            yield "\n".join(own)
        if also:
            yield f"Also {', '.join(f'`{flag}`' for flag in also)}."


def options_of(command: Any, context: Any) -> Iterator[str]:
    """A line for each argument and option but --help: how it is typed, what it means, its default."""
    for parameter in command.params:
        typed, meaning = parameter.get_help_record(context)
        yield f"- `{typed}`: {' '.join(meaning.split())}"


if __name__ == "__main__":
    PAGE.write_text(reference(typer.main.get_command(app)), encoding="utf-8")
