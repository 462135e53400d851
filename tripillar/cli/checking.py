"""The command that checks this machine."""

from dataclasses import asdict
from typing import Annotated

import typer

from tripillar.terminal.console import JsonOption, VerbosityOption, progress_bars, show_json

MARKS = {"ok": "✓", "optional": "·", "wrong": "✗"}


def doctor(
    compute: Annotated[bool, typer.Option(help="Compute what has a known answer, too: about 5 s.")] = True,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Check this machine: versions, solver, display, serial ports, known answers.

    Ends with code 1 if something is wrong.
    """
    from tripillar.doctor.known_answers import KNOWN, check_answers
    from tripillar.doctor.surroundings import check_surroundings

    with progress_bars(verbosity) as bars:
        checks = list(check_surroundings())
        if compute:
            advance = bars.begin("known answers", total=len(KNOWN))
            for check in check_answers():
                advance(1, check.name)
                checks.append(check)
    wrong = sum(check.state == "wrong" for check in checks)
    if json_:
        show_json({"checks": [asdict(check) for check in checks], "wrong": wrong})
    else:
        for check in checks:
            print(f"{MARKS[check.state]} {check.name:32} {check.found}")
            if check.advice:
                print(f"    {check.advice}")
        print("all is well" if not wrong else f"{wrong} of {len(checks)} checks failed")
    if wrong:
        raise typer.Exit(1)
