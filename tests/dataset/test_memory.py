"""Rubber that remembers: exact states for any time step, and closed forms of a hold and of a relaxation."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import DesignError
from common.storage.files import digest
from dataset.memory import PillarMemory, broken_contacts, decays, log_rise, relaxed_forces
from geometry.design import Material, Memory, Prony, SensorDesign
from geometry.design_file import design_from_toml, design_to_toml

MEMORY = Memory(a=(0.5, 0.3), b_lengthen=2.0, b_shorten=9.0, tau_s=(4.0, 90.0), g1=1.0, g2=-2.0)


@pytest.mark.parametrize(
    ("direction", "sign", "b"),
    [("unknown", 1, 2.0), ("unknown", -1, 9.0), ("lengthening", -1, 9.0), ("loading", 1, 2.0), ("loading", -1, 2.0)],
)
def test_a_ramp_and_a_hold_follow_their_closed_form(direction: str, sign: int, b: float) -> None:
    rate = 0.1
    seconds = np.r_[0.0:2.0:21j, 2.0 + np.geomspace(0.1, 300.0, 40)]
    strain, memory = sign * rate * np.minimum(seconds, 2.0), replace(MEMORY, direction=direction)
    q = broken_contacts(strain, np.diff(seconds), memory)
    assert (broken_contacts(strain, np.diff(seconds), PillarMemory.spread(memory, np.ones(6))) == q).all()
    for own, tau in zip(q, MEMORY.tau_s, strict=True):
        total = b * rate + 1 / tau
        up = b * rate / total * (1 - np.exp(-total * np.minimum(seconds, 2.0)))
        assert own == pytest.approx(up * np.exp(-np.maximum(seconds - 2.0, 0.0) / tau), abs=1e-14)


def test_states_are_exact_whatever_the_time_step() -> None:
    generator = np.random.default_rng(3)
    corners = generator.uniform(0.0, 0.3, 8)
    coarse = broken_contacts(corners, 5.0, MEMORY)
    fine = broken_contacts(np.interp(np.arange(351) / 50, np.arange(8), corners), 0.1, MEMORY)
    assert fine[:, ::50] == pytest.approx(coarse, abs=1e-12)
    q = np.zeros(2)
    for change in np.diff(corners):
        q = np.array([keep * own + gain for own, (keep, gain) in zip(q, decays(change, 5.0, MEMORY), strict=True)])
    assert coarse[:, -1] == pytest.approx(q, abs=1e-14)


def test_an_hour_of_pressing_stays_bounded() -> None:
    strain = 0.2 * np.sin(np.arange(36_000) * 0.37) ** 2
    q = broken_contacts(strain, 0.1, MEMORY)
    assert 0.0 <= q.min() <= q.max() <= 1.0
    assert q[:, -9_000:].mean() == pytest.approx(q[:, -18_000:-9_000].mean(), rel=1e-3)
    assert np.isfinite(log_rise(strain, q, MEMORY)).all()


def test_a_force_relaxes_to_what_it_settles_to() -> None:
    prony = Prony(share=(0.2, 0.1), tau_s=(1.0, 50.0))
    settled = np.r_[0.0, np.full(4000, 10.0)]
    force = relaxed_forces(settled, np.r_[1e-9, np.full(3999, 0.1)], prony)
    seconds = np.arange(4000) * 0.1
    np.testing.assert_allclose(force[1:], 10.0 + 2.0 * np.exp(-seconds) + np.exp(-seconds / 50), rtol=0, atol=1e-6)
    assert (relaxed_forces(settled, 0.1, Prony()) == settled).all()


def test_a_design_states_memory_and_files_hold_it() -> None:
    design = SensorDesign(pillar_material=Material(memory=MEMORY, prony=Prony(share=(0.05, 0.02))))
    assert design_from_toml(design_to_toml(design)) == design
    loading = replace(design, pillar_material=Material(memory=replace(MEMORY, direction="loading")))
    assert design_from_toml(design_to_toml(loading)) == loading
    assert digest(replace(MEMORY, direction="unknown")) == digest(MEMORY) != digest(loading.pillar_material.memory)
    assert design.is_homogeneous
    assert "memory" not in design_to_toml(SensorDesign())
    with pytest.raises(DesignError, match="pillar_material"):
        SensorDesign(matrix_material=Material(memory=MEMORY))
    with pytest.raises(DesignError, match="tau_s"):
        Memory(tau_s=(1.0, 0.0))
    with pytest.raises(DesignError, match="lengthening"):
        Memory(direction="size")
