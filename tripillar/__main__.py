"""The program `tripillar`, also `python -m tripillar`: it takes Ctrl-C over before it loads anything else."""

import _signal  # type: ignore[import-not-found]  # `signal` takes ten times as long to load as all before it
import os
import sys


def main() -> None:
    """Run the command line, unless another distribution's package stands in the place of one of ours."""
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)  # ends the process in silence: there is nothing to remove yet
    if sys.getfilesystemencoding() == "ascii":  # libraries refuse names such as é.nc there
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | {"PYTHONUTF8": "1"})
    from tripillar.terminal import interrupts

    interrupts.install()
    from tripillar.doctor.foreign import foreign_packages

    if foreign := foreign_packages():
        print(f"tripillar: {foreign}", file=sys.stderr)
        sys.exit(2)
    from tripillar.cli.app import main as run

    run()


if __name__ == "__main__":
    main()
