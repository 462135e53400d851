"""Help as it is printed: names left, what they mean right of them, every word as it is written."""

from typing import Any

from cyclopts import App, Group
from cyclopts.help import create_parameter_help_panel
from rich.console import Console
from rich.table import Table
from rich.text import Text

NAMES = 30  #: columns for names and what is to be put for their values


class Columns:
    """Prints the panels of a help text; the protocol is that of `cyclopts`."""

    def __call__(self, console: Console, options: Any, panel: Any) -> None:
        """Print commands, arguments or options."""
        if not panel.entries:
            return
        console.print(Text(f"{panel.title}:", style="bold"))
        table = Table.grid(padding=(0, 2, 0, 0))
        table.add_column(max_width=NAMES, overflow="fold")
        table.add_column()
        for entry in panel.entries:
            table.add_row(Text("  " + ", ".join(labels(entry))), Text(meaning(entry)))
        console.print(table)
        console.print()

    def render_usage(self, console: Console, options: Any, usage: Any) -> None:
        """Print how the command is typed."""
        text = Text(str(usage).strip())
        console.print(text if text.plain.startswith("Usage") else Text("Usage: ") + text, "", sep="\n")

    def render_description(self, console: Console, options: Any, description: Any) -> None:
        """Print what the command does."""
        console.print(description, "", sep="\n", markup=False, highlight=False)


def options_of(app: App, name: str) -> list[Any]:
    """Arguments and options of a command as its help has them."""
    arguments = app[name].assemble_argument_collection(parse_docstring=True)
    return create_parameter_help_panel(Group("Options"), arguments, "plaintext").entries


def labels(entry: Any) -> tuple[str, ...]:
    """An option as it is typed, with what stands for its value."""
    metavar = f" {entry.metavar}" if entry.metavar and not entry.positional_label else ""
    *others, last = entry.display_labels
    return (*others, f"{last}{metavar}")


def meaning(entry: Any) -> str:
    """Meaning of an option, its choices and its default."""
    text = str(getattr(entry.description, "primary_renderable", None) or entry.description or "")
    more = [f"one of {', '.join(entry.choices)}"] if entry.choices else []
    more += ["required"] if entry.required else []
    more += [f"default: {entry.default}"] if entry.default else []
    return " ".join([" ".join(text.split()), *([f"[{'; '.join(more)}]"] if more else [])])
