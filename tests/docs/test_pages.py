"""Pages of the documentation say what is so: commands and options exist, tables are those of the code."""

import re
import runpy
import tomllib

import pytest

from geometry.design import SensorDesign
from geometry.design_file import design_from_toml, design_to_toml, whole_design
from geometry.layout import require_told
from tests.docs.terminal import ROOT, console_commands
from tripillar.cli.commands import COMMANDS
from tripillar.cli.help import options_of
from tripillar.cli.parser import app_of

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
APP = app_of()
NAMES = [name for commands in COMMANDS.values() for name in commands]
NO_COMMANDS = {"recording", "COMMAND"}  #: `tripillar recording` is what a recording's attribute `format` says


def commands_named(text: str) -> list[str]:
    """What stands in a page as a command of ours, whether in a block or in a line of text."""
    text = re.sub(r" \\\n> +", " ", text)  # a command typed over two lines
    inline = re.findall(r"`(tripillar [^`]+)`", text)
    blocks = re.findall(r"^ *(?:\$ )?(tripillar .*)$", text, re.MULTILINE)
    return inline + [line.split("  #")[0].split("   ")[0] for line in blocks]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_options_exist(page):
    for line in commands_named(page.read_text(encoding="utf-8")):
        _, name, *words = line.split()
        if name in NO_COMMANDS:
            continue
        if name.startswith("--"):  # an option of the whole
            assert name in ("--help", "--version"), line
            continue
        assert name in NAMES, line
        known = {flag for entry in options_of(APP, name) for flag in entry.all_options}
        given = {word.partition("=")[0] for word in words if re.fullmatch(r"--?[a-z][a-z-]*(=.*)?", word)}
        assert given <= known | {"--help"}, line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_are_whole(page):
    """A blank line between rows ends a table: the rows after it are shown as text."""
    for table in re.findall(r"(?:^\|.*\n)+", page.read_text(encoding="utf-8"), re.MULTILINE):
        rows = table.splitlines()
        assert re.fullmatch(r"\|( :?-+:? \|)+", "".join(rows[1:2])), rows[0]
        assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1, rows[0]


def test_the_reference_of_commands_is_what_they_say():
    """`make docs` writes it; it is there without, and the same."""
    made = runpy.run_path(str(ROOT / "docs" / "site-parts" / "command_reference.py"))
    shown = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert shown == made["reference"](), "run docs/site-parts/command_reference.py"
    assert re.findall(r"^### (.*)$", shown, re.MULTILINE) == NAMES


def test_the_contribution_guide_names_what_is_there():
    guide = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    paths = re.findall(r"\]\(([^)#]+)", guide) + re.findall(r"`((?:\w+/)+[\w.-]*)`", guide)
    assert len(paths) > 12
    assert not [path for path in paths if not (ROOT / path).exists()]


def test_the_citation_is_of_this_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"version: {project['version']}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_layout_shown_leads_to_forces_in_ten_lines_and_four_commands():
    """The tutorial's test types them; here its pillars tell all axes, and a command is one to type."""
    file, *typed = console_commands(ROOT / "docs/sensor.md")
    assert len(file.content[:-1]) <= 10
    assert [command.line.split()[:2] for command in typed if command.line != "kill %1"] == [
        ["tripillar", name] for name in ("dataset", "train", "board", "live")
    ]
    unit = whole_design("\n".join([*file.content[:-1], ""]), "the page").unit
    assert (unit.layout.pillar_names, unit.layout.pillars[1].section) == (("z1", "z2", "x", "y"), "round")
    require_told(unit)


def test_the_design_file_shown_is_the_papers_and_holds_all_keys():
    (shown,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs/sensor.md").read_text(encoding="utf-8"), re.DOTALL)
    assert design_from_toml(shown) == SensorDesign()
    assert tomllib.loads(shown) == tomllib.loads(design_to_toml(SensorDesign()))
