"""TriPillar's command line: a sub-command for each job, in the order of the pipeline.

Results go to stdout (with --json as one object), progress and messages to stderr. A user's mistake is one line and exit
code 2. Each command imports its stage when it runs, so that help is instant and training loads no CAD.
"""

from collections.abc import Callable
from importlib import metadata
from typing import Annotated

import typer

from tripillar.cli.board.fitting import calibrate, tare
from tripillar.cli.board.reading import bench, convert, info, live, ports, record, replay
from tripillar.cli.board.simulating import simulate
from tripillar.cli.exporting import export
from tripillar.cli.identifying import identify
from tripillar.cli.learning import crossval, dataset, evaluate, train
from tripillar.cli.pressing import press
from tripillar.cli.solving import cad, design, mesh, response, solve
from tripillar.cli.studying import doctor, optimize, run, sweep
from tripillar.cli.viewing import SeveralPressures, view
from tripillar.terminal.console import BOARD, LEARNING, SOLVING, STUDYING, UnderHeadings
from tripillar.terminal.entry import run as run_app

app = typer.Typer(
    cls=UnderHeadings,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # which would take a unit in brackets, [s], for markup
    context_settings={"max_content_width": 120},
)


def show_version(asked: bool) -> None:
    """Print the version and end, if asked to."""
    if asked:
        print(f"tripillar {metadata.version('tripillar')}")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Simulate a three-axis tactile sensor, train the network that reads its forces, and read them from a board.

    `tripillar COMMAND --help` explains a command. New here? Begin with `tripillar doctor`, then `tripillar design`.
    """
    if context.invoked_subcommand is None:
        print(context.get_help())


COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    SOLVING: (design, cad, mesh, solve, response, press),
    LEARNING: (dataset, train, evaluate, crossval, identify, export),
    STUDYING: (run, view, sweep, optimize, doctor),
    BOARD: (ports, info, live, bench, record, convert, replay, tare, calibrate, simulate),
}
for heading, commands in COMMANDS.items():
    for command in commands:
        app.command(rich_help_panel=heading, cls=SeveralPressures if command is view else None)(command)


def main() -> None:
    """Run the command line."""
    run_app(app)
