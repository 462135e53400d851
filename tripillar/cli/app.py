"""TriPillar's command line: a sub-command for each job of `tripillar.face`, in the order of the pipeline.

Results go to stdout (with --json as one object), progress and messages to stderr. A user's mistake is one line and exit
code 2. A command's job is loaded when it is named, its stage when it runs: help is instant, and training loads no CAD.
"""

import sys

from common.errors import DesignError
from tripillar.cli.commands import COMMANDS, GONE, job_of
from tripillar.cli.door import command_of
from tripillar.cli.plain import typed_plainly
from tripillar.terminal.entry import run


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
