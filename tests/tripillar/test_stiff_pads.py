"""Stiff pads from stage to stage: what each draws, writes, judges or refuses of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.errors import FileFormatError, SceneError
from dataset import DatasetSettings, simulate
from dataset.loads import displacements
from decoupler import require_same_sensor
from decoupler.data.columns import component_named
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.training.trainer import train
from fem.array.solving import ResponseSettings, solve_response
from fem.kernel.loads import StiffLoad
from fem.methods.plan import make_plan
from fem.methods.solving import follow
from fem.pictures.arrays import solve_array_field
from fem.pictures.parts import sensor_parts, solve_scene_parts
from fem.scene.scene import Probe, Scene, Sensor
from geometry.design import PAD_KINDS, Array, Pad, SensorDesign
from geometry.layout import electrode_squares, unit_centres
from studies.pads import with_pad
from tripillar.face.caller import Caller, called_by
from tripillar.face.checks import mention

PAIR = SensorDesign(array=Array(rows=1, cols=2), pad=Pad(kind="stiff"))
TRACTION = np.array([[0.2, -0.1, -1.0], [0.0, 0.0, 0.0]])


def scene_of_plates(off_mm=0.0):
    """The pair under `TRACTION`, its second plate off its place; U1 and U2 of both units are asked for."""
    loads = tuple(
        StiffLoad(center_mm=(x - off_mm * (x > 0), y), size_mm=(12.0, 12.0), force_n=tuple(144.0 * traction))
        for (x, y), traction in zip(unit_centres(PAIR), TRACTION, strict=True)
    )
    probes = tuple(
        Probe(name=str(k), kind="mean", center_mm=tuple((s[:2] + s[2:]) / 2), size_mm=tuple(s[2:] - s[:2]))
        for k, s in enumerate(electrode_squares(PAIR))
    )
    body, rubber = Sensor(design=PAIR), PAIR.matrix_material
    return Scene(body=body, material=rubber, loads=loads, probes=probes, tolerance=2e-2)


@pytest.fixture(scope="module")
def responses():
    return {kind: solve_response(with_pad(PAIR, kind), ResponseSettings(tolerance=2e-2)) for kind in PAD_KINDS}


def off_rigid(points_mm, moved_mm):
    """Largest distance [mm] of displacements from those of the rigid motion, small rotations, that is nearest."""
    arm = points_mm - points_mm.mean(axis=0)
    motions = np.concatenate([np.broadcast_to(np.eye(3), (len(arm), 3, 3)), np.cross(np.eye(3), arm[:, None])], axis=1)
    A = motions.swapaxes(1, 2).reshape(-1, 6)
    return np.abs(A @ np.linalg.lstsq(A, moved_mm.ravel())[0] - moved_mm.ravel()).max()


def test_plates_are_drawn_plane_and_carry_their_electrodes(monkeypatch):
    """Each moves as a rigid body with both of its upper electrodes, loaded or not; on a coarse grid, too."""
    monkeypatch.setattr("fem.array.design_cell.GRID_LEVEL", 1)
    field = solve_array_field(PAIR)
    parts = sensor_parts(field, field.state(TRACTION), stress=False)
    assert list(parts)[-1] == "plates"  # of soft ones: pads
    assert np.allclose(parts["plates"].traction_mpa[:144], TRACTION[0])
    again = solve_scene_parts(scene_of_plates(), stress=False)
    assert np.allclose(again["plates"].displacement_mm, parts["plates"].displacement_mm, atol=1e-12)
    shown = parts["plates"], parts["electrodes"]
    points, moved = (np.vstack([getattr(part, name) for part in shown]) for name in ("points_mm", "displacement_mm"))
    for side in (-1, 1):
        own = (np.abs(points[:, 2] - 10.0) < 1e-6) & (np.sign(points[:, 0]) == side)
        assert off_rigid(points[own], moved[own]) < 1e-9
    assert np.ptp(moved[:, 2]) > 0.1  # they tilt


def test_a_scene_with_every_plate_is_the_response(responses):
    """Solved by copies of one cell, it moves U1 and U2 of both units as the response says, to the tolerance of both."""
    asked = scene_of_plates()
    with pytest.raises(SceneError, match="square plates at the same place of every unit"):
        solve_scene_parts(scene_of_plates(off_mm=0.5), stress=False)
    plan = make_plan(asked)
    assert plan.method == "cells"
    solution = follow(plan, asked)
    assert solution.seconds["condense"] > solution.seconds["factor"] == 0.0  # what it is, beside the usual keys
    found = np.array(list(solution.probes.values()))
    expected = displacements(responses["stiff"], TRACTION[None])[0].reshape(-1, 3)
    assert np.abs(found - expected).max() < 2e-2 * np.abs(expected).max()
    alone = replace(asked, loads=asked.loads[:1])  # no plate on the other unit: another body, of boxes
    assert make_plan(alone).method == "boxes"


def test_models_and_data_of_other_pads_do_not_mix(responses):
    """A net of its own kind is right to 0.5 %; samples of the other kind are refused, bare pairs doubted."""
    settings = DatasetSettings(protocol="contact", samples=100, seed=1)
    data = {kind: simulate(response, settings) for kind, response in responses.items()}
    network, everything = NetworkConfig(hidden=4, feature="inverse"), component_named("all")
    model = train(data["stiff"], "all", network, TrainingConfig(), response=responses["stiff"])
    assert np.abs(model.forces(data["stiff"].resistance_ohm) - data["stiff"].force_n).max() < 0.005 * 720
    with pytest.raises(FileFormatError, match=r"pad\.kind: model stiff, data soft"):
        require_same_sensor(model, data["soft"], Path("m"), Path("d"))
    specimen = DatasetSettings(protocol="three-axis", samples=20, seed=3, noise=1e-3, gain_spread=0.1, offset_ohm=100.0)
    said: list[str] = []
    with called_by(Caller(say=said.append)):
        for kind in ("soft", "stiff"):
            assert not said
            pairs = simulate(responses[kind], specimen)
            mention(pairs, "samples", everything, SensorModel.of(responses["soft"], everything), is_known=False)
    assert "are they of another?" in said[0]
