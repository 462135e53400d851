"""The scripts of examples/ run, and what they print is so."""

import re
import runpy

import pytest

from tests.docs.terminal import ROOT


@pytest.fixture
def printed_by(tmp_path, coarse, monkeypatch, capsys):
    """Run a script in this process; what it printed."""
    monkeypatch.chdir(tmp_path)

    def printed_by(name):
        runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")
        return capsys.readouterr().out

    return printed_by


@pytest.mark.long  # in short: tests/tripillar/sweeps
def test_a_sweep_gives_the_best_design_within_bounds(printed_by):
    """Those within the bounds come first, by their error; the net of the first errs by what readings allow, or less."""
    _, *lines = printed_by("sweep_to_choice.py").splitlines()
    rows = [[float(value) for value in re.findall(r"[\d.]+", line)] for line in lines[:8]]
    is_within = [range_n >= 450 and area_cm2 <= 11 for *_, range_n, area_cm2 in rows]
    assert 0 < sum(is_within) < 8
    assert is_within == sorted(is_within, reverse=True)
    errors = [error_n for (_, _, _, error_n, _, _), within in zip(rows, is_within, strict=True) if within]
    assert errors == sorted(errors)
    ratios = [float(re.fullmatch(r"f[xyz]: error [\d.]+ N, ([\d.]+) times .*", line)[1]) for line in lines[8:]]
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
