"""Bars on a terminal's stderr."""

from tripillar.terminal.progress import Bars


def test_what_ends_before_its_limit_ends_with_a_full_bar(capsys):
    with Bars() as bars:
        bars.begin("training", total=200)(150, "nothing left to learn")
    assert capsys.readouterr().err.splitlines()[-1].split()[3] == "100%"


def test_what_fails_ends_with_the_bar_where_it_was(capsys):
    bars = Bars()
    bars.__enter__()
    bars.begin("training", total=200)(150, "")
    bars.__exit__(ValueError, ValueError("no"), None)
    assert " 75%" in capsys.readouterr().err
