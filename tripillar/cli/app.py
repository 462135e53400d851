"""TriPillar's command line: a sub-command for each job of `tripillar.face`, in the order of the pipeline.

Results go to stdout (with --json as one object), progress and messages to stderr. A user's mistake is one line and exit
code 2. A command's job is loaded when it is named, its stage when it runs: help is instant, and training loads no CAD.
"""

import sys
from importlib import import_module, metadata

from cyclopts import App, Group

from common.errors import DesignError
from tripillar.cli.door import Job, command_of
from tripillar.cli.help import Columns
from tripillar.terminal.entry import run

#: jobs by heading of the help and name of the command: the module of `tripillar.face`, and the function if it is
#: called otherwise
COMMANDS = {
    "From a design to its response": {
        "design": "bodies", "cad": "bodies", "solve": "bodies", "response": "bodies", "press": "pressing",
    },
    "From data to a model": {
        "dataset": "samples", "train": "learning", "evaluate": "learning", "identify": "identifying",
        "export": "exporting", "rubber": "rubbers",
    },
    "Studies, pictures, help": {
        "run": "studying", "view": "viewing", "sweep": "studying", "doctor": "studying",
    },
    "A sensor on the table": {
        "info": "boards", "live": "boards:watch", "record": "boards", "replay": "boards", "tare": "boards",
        "board": "simulating",
    },
}  # fmt: skip
#: commands and options that are gone, and what to write instead
GONE = {
    "mesh": "cad --mesh --out DIR",
    "crossval": "evaluate --folds 10 --data FILE",
    "optimize": "sweep FILE --optimize",
    "ports": "info",
    "bench": "info PORT --seconds 10",
    "convert": "export RECORDING --out FILE",
    "calibrate": "identify --as-designed --port PORT --out FILE.json",
    "simulate": "board",
    "fine-tune": "identify --data PAIRS.nc --design sensor.toml --out own.safetensors; it needs no model",
    "identify --model": "identify --finite MODEL",
    "sweep --train": "train on samples of the designs that it has found",
    "board --scene": "board --pressure MPA",
}
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
                app.command(command_of(job_of(name)), name=name, group=group, sort_key=place)
    return app


def job_of(name: str) -> Job:
    """The job of a command."""
    home = next(commands[name] for commands in COMMANDS.values() if name in commands)
    module, _, function = home.partition(":")
    job: Job = getattr(import_module(f"tripillar.face.{module}"), function or name)
    return job


def called() -> int:
    """Run what was typed; its exit code."""
    words = sys.argv[1:]
    for gone in (words[0], *(f"{words[0]} {word}" for word in words[1:])) if words else ():
        if gone in GONE:
            raise DesignError(f"{gone} is gone: write tripillar {GONE[gone]}.")
    known = {name for commands in COMMANDS.values() for name in commands}
    app = app_of(*({words[0]} & known if words else ()))
    if not words:
        app.help_print([])
        return 0
    return int(app(words) or 0)


def main() -> None:
    """Run the command line."""
    run(called)
