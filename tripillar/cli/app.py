"""TriPillar's command line: a sub-command for each job of `tripillar.face`, in the order of the pipeline.

Results go to stdout (with --json as one object), progress and messages to stderr. A user's mistake is one line and exit
code 2. A command's job is loaded when it is named, its stage when it runs: help is instant, and training loads no CAD.
"""

import sys
from importlib import import_module

from common.errors import DesignError
from tripillar.cli.door import Job, command_of
from tripillar.cli.plain import typed_plainly
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
    "replay --ros2": "replay --out FILE.mcap",
    "sweep --train": "train on samples of the designs that it has found",
    "board --scene": "board --pressure MPA",
}


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
    if words and words[0] in known:
        given = typed_plainly(job_of(words[0]), words[1:])
        if given is not None:
            return command_of(job_of(words[0]))(*given[0], **given[1])
    from tripillar.cli.parser import app_of, run_app  # which takes as long to load as a small scene to solve

    app = app_of(*({words[0]} & known if words else ()))
    if not words:
        app.help_print([])
        return 0
    return run_app(app, words)


def main() -> None:
    """Run the command line."""
    run(called)
