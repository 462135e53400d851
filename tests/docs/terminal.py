"""Commands that pages of the documentation say to type, a place to type them, and what they promise to print."""

import os
import re
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

from tests.house import PATIENT_S, run_here

ROOT = Path(__file__).parents[2]
NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w.]*\w)")
RELATIVE = 0.02  #: of a number promised: another machine's rounding and threads move the last digits of what is trained


@dataclass
class Command:
    """One line that is typed, the lines below it that it promises to print, and those of a file that it writes."""

    line: str
    promised: list[str] = field(default_factory=list)
    content: list[str] = field(default_factory=list)  #: up to END


def console_commands(page: Path) -> list[Command]:
    """List every command of a page's ``console`` blocks, in order."""
    commands: list[Command] = []
    for block in re.findall(r"```console\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                commands.append(Command(line[2:]))
            elif commands[-1].line.endswith("\\") and line.startswith(">"):
                commands[-1].line = commands[-1].line[:-1] + line[1:].strip()
            elif commands[-1].line.endswith("<< END") and line.startswith("> "):
                commands[-1].content.append(line[2:])
            else:
                commands[-1].promised.append(line)
    return commands


def indented_commands(page: Path, *programs: str) -> list[str]:
    """List the commands of a page's indented blocks that begin with one of the programs, comments left out."""
    lines = re.findall(r"^    (\S.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    typed = (re.sub(r"\s+#.*$", "", line).strip() for line in lines)
    return [line for line in typed if line.split()[0] in programs]


class Terminal:
    """A folder in which commands are typed: they run in this process, or in one of their own if they end in ``&``."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self.folder, self._jobs = folder, list[subprocess.Popen]()
        self._environment = os.environ | {"COLUMNS": "200", "PYTHONPATH": str(ROOT)}

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        """End whatever is left running."""
        for job in self._jobs:
            job.kill()
            job.wait()

    def type(self, command: Command) -> str:
        """Run a command to its end, or until it has printed what it promised if it ends in ``&``; what it printed."""
        program, *words = shlex.split(command.line.removesuffix("&"))
        if program == "kill":
            for number in words:
                job = self._jobs.pop(int(number.removeprefix("%")) - 1)
                job.terminate()
                assert job.wait(PATIENT_S) == 0
            return ""
        if program == "cat":
            assert command.content.pop() == "END"
            (self.folder / words[1]).write_text("\n".join([*command.content, ""]))
            return ""
        assert program == "tripillar"
        if command.line.endswith("&"):
            return self._leave_running(words, command)
        said = StringIO()
        code = run_here(words, self.folder, self._environment, said, said)
        assert code == 0, f"{command.line}\nended with {code}:\n{said.getvalue()}"
        return said.getvalue()

    def _leave_running(self, words: list[str], command: Command) -> str:
        printed = self.folder / f".job-{len(self._jobs)}"
        with printed.open("w") as out:
            program = [sys.executable, "-m", "tripillar", *words]
            job = subprocess.Popen(program, stdout=out, stderr=out, cwd=self.folder, env=self._environment)
        self._jobs.append(job)
        end_s = time.monotonic() + PATIENT_S
        while missing(command.promised, printed.read_text()):
            assert time.monotonic() < end_s, f"{command.line}\ndid not do what it promised:\n{printed.read_text()}"
            assert job.poll() is None, f"{command.line}\nended:\n{printed.read_text()}"
            time.sleep(0.05)
        return printed.read_text()


def missing(promised: list[str], printed: str) -> list[str]:
    """List the promised lines from the first that is not printed in its order; other lines may come between."""
    lines = iter(printed.replace("\r", "\n").splitlines())
    for k, line in enumerate(promised):
        if line.strip() and not any(agrees(line, other) for other in lines):
            return promised[k:]
    return []


def agrees(promised: str, printed: str) -> bool:
    """Compare a line with the promised one: … stands for anything, numbers agree to 2 % or one in their last digit."""
    promised, printed = (" ".join(line.split()) for line in (promised, printed))
    pattern = ".*".join(NUMBER.sub("\0", part) for part in promised.split("…"))
    pattern = "".join(".*" if part == ".*" else re.escape(part) for part in re.split(r"(\.\*)", pattern))
    found = re.fullmatch(pattern.replace("\0", f"({NUMBER.pattern})"), printed)
    if not found:
        return False
    pairs = zip(NUMBER.findall(promised), found.groups(), strict=True)
    return all(abs(float(one) - float(other)) <= RELATIVE * abs(float(one)) + last_digit(one) for one, other in pairs)


def last_digit(number: str) -> float:
    """Give what one more in its last digit adds to a number, 0 for a whole one.

    >>> last_digit("0.38"), last_digit("8.9e-04"), last_digit("136")
    (0.01, 1e-05, 0.0)
    """
    mantissa, _, exponent = number.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(f"1e{int(exponent or 0) - decimals}") if decimals else 0.0
