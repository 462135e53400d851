"""The commands: for each the job of `tripillar.face` that it runs, in the order of the pipeline; and what is gone."""

from importlib import import_module

from tripillar.cli.door import Job

#: jobs by heading of the help and name of the command: the module of `tripillar.face`, and the function if it is
#: called otherwise
COMMANDS = {
    "From a design to its response": {
        "design": "bodies", "cad": "bodies", "solve": "bodies", "response": "bodies", "press": "pressing",
    },
    "From data to a model": {
        "dataset": "samples", "train": "learning", "evaluate": "learning", "identify": "identifying:identify_as_typed",
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
