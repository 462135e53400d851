"""What pages of the documentation say to type, a shell to type it into, and what they promise it prints."""

import os
import re
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.]*\w)")
RELATIVE = 0.02  #: of a number promised: another machine's rounding and threads move the last digits of what is trained
GIVE_UP_S = 120.0  #: on one command


@dataclass
class Command:
    """One line that is typed, and the lines below it that it promises to print."""

    line: str
    promised: list[str] = field(default_factory=list)


def console_commands(page: Path) -> list[Command]:
    """Every command of a page's ``console`` blocks, in order."""
    commands: list[Command] = []
    for block in re.findall(r"```console\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                commands.append(Command(line[2:]))
            elif commands[-1].line.endswith("\\") and line.startswith(">"):
                commands[-1].line = commands[-1].line[:-1] + line[1:].strip()
            else:
                commands[-1].promised.append(line)
    return commands


def indented_commands(page: Path, *programs: str) -> list[str]:
    """Commands of a page's indented blocks that begin with one of the programs, comments left out."""
    lines = re.findall(r"^    (\S.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    typed = (re.sub(r"\s+#.*$", "", line).strip() for line in lines)
    return [line for line in typed if line.split()[0] in programs]


class Terminal:
    """A shell in a folder of its own, where `tripillar` is this working tree's, and jobs can be left running."""

    def __init__(self, folder: Path, cache: Path) -> None:
        self.folder = folder
        programs = folder / ".programs"
        programs.mkdir(parents=True)
        (programs / "tripillar").write_text(f'#!/bin/sh\nexec {sys.executable} -m tripillar "$@"\n')
        (programs / "tripillar").chmod(0o755)
        environment = os.environ | {
            "PATH": f"{programs}:{os.environ['PATH']}",
            "TRIPILLAR_CACHE": str(cache),
            "COLUMNS": "200",
            "PYTHONPATH": str(ROOT),
        }
        self._typed = 0
        self._shell = subprocess.Popen(
            ["bash", "-m"], stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=folder, env=environment
        )

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        """End the shell, and whatever it has left running."""
        assert self._shell.stdin
        self._shell.stdin.write("kill $(jobs -p) 2>/dev/null; wait\n")
        self._shell.stdin.close()
        self._shell.wait(timeout=GIVE_UP_S)

    def type(self, command: Command) -> str:
        """Run a command to its end, or until it has printed what it promised if it ends in ``&``; what it printed."""
        assert self._shell.stdin
        self._typed += 1
        name = str(self.folder / ".programs" / str(self._typed))
        said, ended = Path(f"{name}.said"), Path(f"{name}.ended")
        line = command.line.removesuffix("&")
        runs = f"{{ {line} & }}" if line != command.line else f"{{ {line} ; }}"
        self._shell.stdin.write(f"{runs} > {shlex.quote(str(said))} 2>&1 < /dev/null\n")
        self._shell.stdin.write(f"echo $? > {shlex.quote(str(ended))}\n")
        self._shell.stdin.flush()
        end_s = time.monotonic() + GIVE_UP_S
        while time.monotonic() < end_s:
            status = ended.read_text().strip() if ended.exists() else ""
            if status not in ("", "0"):
                raise AssertionError(f"{command.line}\nended with {status}:\n{said.read_text()}")
            if status and (line == command.line or not missing(command.promised, said.read_text())):
                return said.read_text()
            time.sleep(0.02)
        raise AssertionError(f"{command.line}\ndid not do what it promised:\n{said.read_text()}")


def missing(promised: list[str], printed: str) -> list[str]:
    """Promised lines that are not printed in their order, the first of them first; other lines may come between."""
    lines = iter(printed.replace("\r", "\n").splitlines())
    for k, line in enumerate(promised):
        if line.strip() and not any(agrees(line, other) for other in lines):
            return promised[k:]
    return []


def agrees(promised: str, printed: str) -> bool:
    """Whether a line is the promised one: … stands for anything, numbers agree to 2 % or one in their last digit."""
    promised, printed = (" ".join(line.split()) for line in (promised, printed))
    pattern = ".*".join(NUMBER.sub("\0", part) for part in promised.split("…"))
    pattern = "".join(".*" if part == ".*" else re.escape(part) for part in re.split(r"(\.\*)", pattern))
    found = re.fullmatch(pattern.replace("\0", f"({NUMBER.pattern})"), printed)
    if not found:
        return False
    pairs = zip(NUMBER.findall(promised), found.groups(), strict=True)
    return all(abs(float(one) - float(other)) <= RELATIVE * abs(float(one)) + last_digit(one) for one, other in pairs)


def last_digit(number: str) -> float:
    """What one more in its last digit adds to a number, 0 to a whole one.

    >>> last_digit("0.38"), last_digit("8.9e-04"), last_digit("136")
    (0.01, 1e-05, 0.0)
    """
    mantissa, _, exponent = number.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(f"1e{int(exponent or 0) - decimals}") if decimals else 0.0
