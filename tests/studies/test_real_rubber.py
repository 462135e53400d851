"""The readers of published series, and their tables, on small files in the same formats with the same flaws."""

import json

import numpy as np
import pytest

from common.errors import DesignError
from dataset.memory import broken_contacts, log_rise
from geometry.design import Memory
from studies.real_rubber import array, eflesh, readers
from studies.real_rubber.published import real_rubber

MEMORY = Memory(a=(0.3, 0.2), b_lengthen=1.5, b_shorten=8.0, tau_s=(5.0, 60.0), g1=2.0, g2=-5.0)
WAVE = np.interp(np.arange(0.0, 120.0, 0.08), [0, 5, 10, 40, 44, 80, 90, 94, 120], [0, 0, 0.3, 0.3, 0, 0, 0.3, 0, 0])


def write_strip(path):
    """Negative inner readings that alternate, an axis that points the other way, and a position of 0 here and there."""
    t = np.arange(len(WAVE)) * 0.08
    ohm = 1000.0 * np.exp(2 * np.log1p(WAVE) + log_rise(WAVE, broken_contacts(WAVE, 0.08, MEMORY), MEMORY))
    position = -40.0 * WAVE
    for first in (80, 200, 520, 1100):
        position[first : first + 4] = 0.0
    swing = 1.0 + 0.1 * (-1.0) ** np.arange(len(t))
    rows = np.column_stack([20 * ohm, -ohm * swing, t, position, t - 0.03, 5 * WAVE, t + 0.04])
    np.savetxt(path, rows, delimiter=",")
    return ohm


def write_pad(folder, name):
    for k, (part, rate, values) in enumerate(
        (("velostat_data", 140, 900 / (1 + 30 * WAVE)), ("futek_data", 250, 10 * WAVE))
    ):
        t = np.arange(0.0, 119.0, 1 / rate)
        lines = [
            f"{v:.3f} {1.6e9 + 0.5 * k + s:.4f}"
            for v, s in zip(np.interp(t, np.arange(len(WAVE)) * 0.08, values), t, strict=True)
        ]
        path = folder / readers.PADS / part / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join([lines[0].split()[0], *lines]))


def write_eflesh(folder, kind, n=150):
    """Two recordings whose scale says −1 in every third line."""
    mix = np.random.default_rng(0).standard_normal((2, 15))
    for k in (1, 2):
        t, (a, b) = 10.0 * k + np.arange(n) / 30.0, np.random.default_rng(k).uniform(0, 30, (2, n))
        places = (
            [a, b, 0 * a]
            if kind == "spatial_resolution"
            else [0 * a, 0 * a, 0 * a, np.where(np.arange(n) % 3, 100 * a, -1.0)]
        )
        seen = np.column_stack([a, b if kind == "spatial_resolution" else a]) @ mix * 40
        one = folder / readers.EFLESH / kind / f"r{k}"
        one.mkdir(parents=True)
        np.savetxt(one / "sensor_post_baselines.csv", np.column_stack([t, seen]), delimiter=",")
        np.savetxt(one / "states.csv", np.column_stack([t + 0.001, *places]), delimiter=",")


def test_a_strip_is_read_as_it_was_stretched(tmp_path):
    ohm = write_strip(tmp_path / "s.csv")
    series = readers.read_strip(tmp_path, "s")
    t = np.arange(len(WAVE)) * 0.08
    assert series.strain == pytest.approx(np.interp(series.time_s, t, WAVE), abs=0.02)
    assert series.resistance_ohm == pytest.approx(np.interp(series.time_s, t, ohm), rel=0.06)
    assert readers.contact_pct(tmp_path, "s") == pytest.approx(90.0, abs=1.5)


def test_a_pad_is_synchronised_by_the_clocks_of_both_streams(tmp_path):
    write_pad(tmp_path, "p")
    series = readers.read_pad(tmp_path, "p")
    t = np.arange(len(WAVE)) * 0.08
    resistance = np.interp(series.time_s + 0.51, t, 900 / (1 + 30 * WAVE))
    assert series.resistance_ohm == pytest.approx(resistance, rel=0.02)
    assert series.force_n == pytest.approx(np.interp(series.time_s + 0.01, t, 10 * WAVE), abs=0.02)


def test_tables_of_all_that_is_there(tmp_path, monkeypatch, capsys):
    """Of eFlesh no clone is there: its line says which; without any clone the study ends."""
    data, out = tmp_path / "data", tmp_path / "out"
    with pytest.raises(DesignError, match=r"git clone https://github\.com/notvenky/eFlesh"):
        real_rubber(data=data, out=out)
    for name in ("a", "b"):
        (data / "electromech-stretcher").mkdir(parents=True, exist_ok=True)
        write_strip(data / "electromech-stretcher" / f"{name}.csv")
    monkeypatch.setattr("studies.real_rubber.published.STRIPS", {"a": ("b",)})
    monkeypatch.setattr("studies.real_rubber.others.STEPS", 2)
    real_rubber(data=data, out=out)
    assert "eFlesh is missing" in capsys.readouterr().err
    tables = json.loads((out / "real-rubber.json").read_text(encoding="utf-8"))["tables"]
    (row,) = tables["resistance from strain [% of range]"]
    assert row["ours"] < 3 < row["static polynomial"]
    assert row["force, ours"] < 5  # the force is 5 N times the strain, whatever the law of the rubber
    assert {path.name for path in out.iterdir()} == {"real-rubber.json", "real-rubber.png"}


@pytest.mark.parametrize("kind", ["normal_force", "spatial_resolution"])
def test_contacts_of_efleshs_are_decoded_that_were_not_learned(kind, tmp_path):
    write_eflesh(tmp_path, kind)
    for channels, wanted in readers.read_recordings(tmp_path, kind):
        assert wanted.shape == ((100, 1) if kind == "normal_force" else (150, 3))
        assert channels.shape == (len(wanted), 15)
    rows = eflesh.judged(tmp_path, kind)
    assert max(row["rmse"] for row in rows) < 1.0


def test_the_study_of_arrays_ignores_memory_by_the_law_at_rest():
    """Its strains without memory are those of the law with no contact broken; bench series remember."""
    strain, memory = np.linspace(-0.25, 0.2, 10), array.RUBBERS[array.OWN]
    still = 2 * np.log1p(strain) + memory.g1 * strain
    assert array.static_strain(still, memory) == pytest.approx(strain, abs=1e-6)
    series = array.bench_series(memory)
    assert series.strain.max() == pytest.approx(array.STRETCH, rel=0.02)
    released = (series.strain == 0) & (np.maximum.accumulate(series.strain) > 0.1)
    assert series.resistance_ohm[released].max() > 1.1 * series.resistance_ohm[:100].mean()
