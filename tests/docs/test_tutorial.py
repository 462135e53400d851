"""The tutorial in docs/index.md, typed from its first line to its last."""

import pytest

from tests.docs.terminal import ROOT, Terminal, agrees, console_commands, missing

PAGE = ROOT / "docs" / "index.md"


def test_the_tutorial_does_what_it_promises(tmp_path, shared_cache):
    """Every command succeeds, and prints what the page says below it."""
    commands = console_commands(PAGE)
    assert len(commands) > 12
    with Terminal(tmp_path) as terminal:
        for command in commands:
            printed = terminal.type(command)
            assert not missing(command.promised, printed), f"{command.line}\nprinted:\n{printed}"


@pytest.mark.parametrize(
    ("promised", "printed", "same"),
    [
        ("│ fx │  1.158 │", "│ fx    │ 1.17 │", True),
        ("│ fx │  1.158 │", "│ fx    │ 1.19 │", False),
        ("fz: … to 435 N", "fz: -1.8 to 434.8 N", True),
        ("fz: … to 435 N", "fx: -1.8 to 434.8 N", False),
    ],
)
def test_a_promise_is_kept_to_two_per_cent(promised, printed, same):
    assert agrees(promised, printed) is same
