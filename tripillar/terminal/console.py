"""Options that all commands share; results go to stdout, all else to stderr."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from geometry.design import SensorDesign
from geometry.design_file import read_design, states_twin
from geometry.errors import DesignError, FileFormatError, TriPillarError
from geometry.storage.files import require_file, require_folder

if TYPE_CHECKING:
    from rich.table import Table

    from decoupler.twin.twin_file import TwinFile
    from tripillar.terminal.progress import Bars

#: headings under which --help lists the commands
HEADINGS = SOLVING, LEARNING, STUDYING, BOARD = (
    "From a design to its response", "From data to a model", "Studies, pictures, help", "A sensor on the table"
)  # fmt: skip

DesignOption = Annotated[Path | None, typer.Option("--design", help="Design file (TOML); default: the paper's sensor.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object on stdout.")]
GainSpreadOption = Annotated[
    float, typer.Option("--gain-spread", help="Spread of the pillars' gains: each is uniform in 1 ± this.")
]
OffsetOption = Annotated[float, typer.Option("--offset", help="Standard deviation of the pillars' offsets [Ω].")]
VerbosityOption = Annotated[
    bool | None,
    typer.Option("--verbose/--quiet", "-v/-q", help="Print a line for each step and its time, or no progress at all."),
]


#: commands that are gone, and what to write instead
GONE = {
    "fine-tune": "tripillar identify --data PAIRS.nc --design sensor.toml --out own.safetensors; it needs no model",
}


class UnderHeadings(TyperGroup):
    """Lists commands under the headings above, each with the first line of its help."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in GONE:
            raise DesignError(f"{cmd_name} is gone: write {GONE[cmd_name]}.")
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        commands = [(name, self.commands[name]) for name in self.list_commands(ctx)]
        for heading in HEADINGS:
            with formatter.section(heading):
                formatter.write_dl(
                    (name, (command.help or "").partition("\n")[0])
                    for name, command in commands
                    if getattr(command, "rich_help_panel", "") == heading
                )


def chosen(path: Path | None) -> SensorDesign:
    """The design of a --design option."""
    return SensorDesign() if path is None else read_design(path)


def chosen_twin(path: Path | None) -> "TwinFile | None":
    """The twin in the file of a --design option, if there is one."""
    if path is None or not states_twin(path):
        return None
    from decoupler.twin.twin_file import read_twin

    return read_twin(path)


def progress_bars(verbosity: bool | None) -> "Bars":
    """Progress as -v or -q ask for it, bars where neither does."""
    from tripillar.terminal.progress import Bars

    return Bars(quiet=verbosity is False, verbose=verbosity is True)


def say(note: str) -> None:
    """A message on stderr, if there is one."""
    if note:
        print(note, file=sys.stderr)


def show_json(result: dict[str, Any]) -> None:
    """Print a result as one JSON object on stdout."""
    print(json.dumps(result, indent=2))


def answer(as_json: bool, result: dict[str, Any], text: str | Callable[[], "Iterable[Table]"], *files: Path) -> None:
    """Print a result as JSON, or for people as a text or as tables; then name the files written, on stderr."""
    if as_json:
        show_json(result)
    elif isinstance(text, str):
        print(text)
    else:
        from tripillar.terminal.tables import show

        for table in text():
            show(table)
    wrote(files)


def wrote(files: Iterable[Path]) -> None:
    """Name every file written, last of all, on stderr."""
    for path in files:
        print(path, file=sys.stderr)


def output_file(path: Path | None) -> Path | None:
    """Callback of an option that names a file to write: refused before anything is computed if it cannot be."""
    if path is not None:
        require_file(path)
    return path


def output_samples(path: Path) -> Path:
    """The same of a data set: a file, or a zarr directory."""
    from dataset.leaves import is_zarr, require_zarr_place

    if is_zarr(path):
        require_zarr_place(path)
    else:
        require_file(path)
    return path


def output_folder(path: Path) -> Path:
    """The same for a folder."""
    require_folder(path)
    return path


def require_suffix(option: str, path: Path | None, *suffixes: str) -> None:
    """Refuse a file to write whose name says another kind, or a folder in its place."""
    if path is not None and (path.suffix not in suffixes or path.is_dir()):
        *others, last = suffixes
        kinds = f"{', '.join(others)} or {last}" if others else last
        raise DesignError(f"{option} {path} must be a file that ends in {kinds}.")


@contextmanager
def spelled(**flags: str) -> Iterator[None]:
    """Name flags in errors that name the parameters they set: ``goal_mse=-1`` becomes ``--goal -1``."""
    try:
        yield
    except TriPillarError as error:
        message = str(error)
        for parameter, flag in flags.items():
            message = message.replace(f"{parameter}=", f"{flag} ")
        if message == str(error):
            raise
        raise type(error)(message) from None


def require_other(out: Path | None, *read: Path | None) -> None:
    """Refuse to write over what the command reads."""
    for path in read:
        if out is not None and path is not None and out.exists() and path.exists() and out.samefile(path):
            raise FileFormatError(f"{out} is read by this command: give another name for what it writes.")
