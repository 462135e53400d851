"""The tutorial in docs/index.md, typed from its first line to its last."""

import pytest

from tests.docs.terminal import ROOT, Terminal, agrees, console_commands, last_digit, missing

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
        ("1000 samples, 136 draws", "1000 samples, 136 draws", True),
        ("1000 samples, 136 draws", "1000 samples, 146 draws", False),
        ("│ fx │  1.158 │", "│ fx    │ 1.17 │", True),
        ("│ fx │  1.158 │", "│ fx    │ 1.19 │", False),
        ("relative error 0.38%", "relative error 0.37%", True),
        ("estimated error 8.9e-04", "estimated error 9.2e-04", False),
        ("fz: … to 435 N", "fz: -1.8 to 434.8 N", True),
        ("fz: … to 435 N", "fx: -1.8 to 434.8 N", False),
    ],
)
def test_a_promise_is_kept_to_two_per_cent(promised, printed, same):
    assert agrees(promised, printed) is same


def test_promises_are_kept_in_their_order():
    assert missing(["a", "b"], "a\nc\nb\n") == []
    assert missing(["b", "a"], "a\nc\nb\n") == ["a"]
    assert last_digit("8.9e-04") == pytest.approx(1e-5)
