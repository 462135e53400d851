"""Write docs/commands.md from the jobs themselves; `make docs` does so, and a test holds the file to them."""

from collections import Counter
from pathlib import Path
from typing import Any

from tripillar.cli.commands import COMMANDS
from tripillar.cli.help import labels, meaning, options_of
from tripillar.cli.parser import app_of

PAGE = Path(__file__).parents[1] / "commands.md"
COMMON = 2  #: commands from which on an option of theirs is told once for all

TITLE = """# Commands

What `tripillar COMMAND --help` prints. `INT=6` is 6 unless given, choices stand in brackets. *Also* names options of
several commands, listed here; every command has the first four:"""

OF_THE_PROGRAM = (
    "- `--version`: Print the version and exit.",
    "- `--install-completion`: Let the shell complete commands, options and choices.",
)


def reference() -> str:
    """The whole page, Markdown."""
    app = app_of()
    names = [name for commands in COMMANDS.values() for name in commands]
    told = {name: [shown(each) for each in options_of(app, name)] for name in names}
    counts = Counter(line for lines in told.values() for line in lines)
    often = sorted((line for line, count in counts.items() if count >= COMMON), key=lambda line: -counts[line])
    # of a flag that means two things, the one that more commands have
    common = list({flag_of(line): line for line in reversed(often)}.values())[::-1]
    blocks = [TITLE, "\n".join([*OF_THE_PROGRAM, *common])]
    for heading, commands in COMMANDS.items():
        blocks.append(f"## {heading}")
        for name in commands:
            own = [line for line in told[name] if line not in common]
            also = [flag_of(line) for line in told[name] if line in common and counts[line] < len(names)]
            blocks += [f"### {name}", app[name].help.strip(), "\n".join(own)]
            if also:
                blocks.append(f"Also {', '.join(f'`{flag}`' for flag in also)}.")
    return "\n\n".join(block for block in blocks if block) + "\n"


def flag_of(line: str) -> str:
    """The first name of an option in its line."""
    return line.split("`")[1].split()[0].rstrip(",")


def shown(option: Any) -> str:
    """A line for an argument or option: how it is typed, its default, what it means, its choices."""
    default = f"={option.default}" if option.default and option.default != '""' else ""
    told = meaning(option).replace("[one of ", "[").removesuffix(f" [default: {option.default}]")
    return f"- `{', '.join(labels(option))}{default}`: {told.replace(f'; default: {option.default}]', ']')}"


if __name__ == "__main__":
    PAGE.write_text(reference(), encoding="utf-8")
