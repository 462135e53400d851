"""The scripts of examples/ run, and what they print is so."""

import re
import runpy

import pytest

from tests.docs.terminal import ROOT


@pytest.fixture
def printed_by(tmp_path, shared_cache, monkeypatch, capsys):
    """Run a script in this process; what it printed."""
    monkeypatch.chdir(tmp_path)

    def printed_by(name):
        runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")
        return capsys.readouterr().out

    return printed_by


@pytest.mark.long  # in short: tests/tripillar/sweep
def test_a_sweep_gives_the_best_design_within_bounds(printed_by):
    """Designs are listed by their error; the net of the first errs by what the readings allow, or less."""
    first, _, *lines = printed_by("sweep_to_choice.py").splitlines()
    within, judged = map(int, re.match(r"(\d+) of (\d+) designs", first).groups())
    rows = [[float(value) for value in re.findall(r"[\d.]+", line)] for line in lines[:within]]
    assert 0 < within < judged
    errors = [error_n for _, _, _, error_n, _, _ in rows]
    assert errors == sorted(errors)
    assert min(range_n for *_, range_n, _ in rows) >= 450
    ratios = [float(re.fullmatch(r"f[xyz]: error [\d.]+ N, ([\d.]+) times .*", line)[1]) for line in lines[within:]]
    assert len(ratios) == 3
    assert max(ratios) < 1.15


def test_a_design_gives_forces_near_their_limit(printed_by):
    """Within what the project promises of joint nets, and far nearer than each pillar alone."""
    lines = printed_by("design_to_forces.py").splitlines()
    errors = [re.fullmatch(r"(f[xyz]) +([\d.]+) N +([\d.]+) N +([\d.]+) +([\d.]+) N", line) for line in lines]
    found = {row[1]: [float(value) for value in row.groups()[1:]] for row in errors if row}
    assert set(found) == {"fx", "fy", "fz"}
    for error_n, _, ratio, alone_n in found.values():
        assert ratio < 1.15
        assert alone_n > 20 * error_n
    last = re.search(r"Fz ([\d.]+) ± ([\d.]+) N, applied ([\d.]+)", lines[-1])
    force_n, deviation_n, applied_n = map(float, last.groups())
    assert abs(force_n - applied_n) < 4 * deviation_n  # one normal error in 16,000 is larger
