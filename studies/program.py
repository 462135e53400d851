"""Studies as programs of their own, `python -m studies...`."""

import sys
from collections.abc import Callable
from typing import NoReturn

import cyclopts

from tripillar.cli.parser import run_app
from tripillar.terminal import interrupts
from tripillar.terminal.entry import run


def run_alone(function: Callable[..., None]) -> NoReturn:
    """Run a function as a program of its own, `python -m studies...`."""
    interrupts.install()
    app = cyclopts.App(
        help_format="plaintext", help_formatter="plain", result_action="return_value", version_flags=(),
        default_parameter=cyclopts.Parameter(negative=()), exit_on_error=False, print_error=False,
    )  # fmt: skip
    app.default(function)
    run(lambda: run_app(app, sys.argv[1:]))
