"""Twins as files: read as written, refused in one line, and the samples that are drawn from them."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dataset import DatasetSettings, simulate
from dataset.simulation import BLOCK
from decoupler.data.pairs import Pairs
from decoupler.model.model_file import require_same_sensor, write_model
from decoupler.twin import identify, read_twin, simulate_twin, write_twin
from fem.array.closed_forms import layer_response
from fem.array.sensitivities import ResponseSensitivities
from geometry.design import Array, SensorDesign
from geometry.design_file import read_design, write_design
from geometry.errors import DesignError, FileFormatError
from geometry.layout import pillar_volumes
from geometry.storage.seal import BLANK, MARK, sealed
from geometry.tolerances import RESISTIVITY, changed, usual_deviations, with_values

DESIGN = SensorDesign(array=Array(rows=2, cols=2))
PAIRS = 20


@pytest.fixture(scope="module")
def truth():
    made = layer_response(with_values(DESIGN, {"rubber.young_mpa": 5.7, "unit.height_mm": 10.2}))
    settings = DatasetSettings(
        protocol="three-axis", samples=200, seed=3, noise=0.001, gain_spread=0.1, offset_ohm=100.0, specimen=1
    )
    return replace(simulate(made, settings).labels(), design=DESIGN)


@pytest.fixture(scope="module")
def folder(truth, tmp_path_factory):
    """Holds a twin of 20 pairs, its derivatives from the closed form."""
    deviations = {name: sd for name, sd in usual_deviations(DESIGN).items() if name != RESISTIVITY}
    moved = [
        [layer_response(changed(DESIGN, name, by * sd)).influence_mm_per_n for by in (0.1, -0.1)]
        for name, sd in deviations.items()
    ]
    sds = np.array(list(deviations.values()))
    by = np.array([above - below for above, below in moved]) / (0.2 * sds).reshape(-1, *[1] * 7)
    sensitivities = ResponseSensitivities(
        design=DESIGN, parameters=tuple(deviations), deviation=sds, influence_mm_per_n=by
    )
    twin = identify(Pairs.of(truth[:PAIRS]), layer_response(DESIGN), sensitivities)
    path = tmp_path_factory.mktemp("twin")
    write_model(twin.decoder, path / "own.safetensors")
    write_twin(twin, path / "twin.toml", path / "own.safetensors")
    return path


def test_a_twin_is_a_design_at_its_most_probable_values(folder):
    twin = read_twin(folder / "twin.toml")
    design = read_design(folder / "twin.toml")
    assert twin.design == design
    for name in ("rubber.young_mpa", "unit.height_mm"):
        value, deviation = twin.parameters[name]
        assert abs(value - {"rubber.young_mpa": 5.7, "unit.height_mm": 10.2}[name]) < 4 * deviation
        assert deviation < usual_deviations(DESIGN)[name]
    assert design.unit.height_mm == pytest.approx(twin.parameters["unit.height_mm"][0])
    assert twin.covariance.shape == (len(twin.parameters),) * 2
    decoder = twin.read_decoder()
    by_file = np.stack([twin.gain[p] for p in "zxy"], axis=-1) * design.resistivity_ohm_mm / pillar_volumes(design.unit)
    assert np.allclose(by_file.ravel(), decoder.inverse.forward.ohm_per_mm2, rtol=1e-3)  # volumes to first order
    assert all((deviation > 0).all() for deviation in twin.gain_deviation.values())
    write_design(DESIGN, folder / "design.toml")
    assert read_twin(folder / "design.toml") is None


def test_samples_of_a_twin_show_what_is_unknown(folder, truth):
    """The true sensor reads as far from the most probable one as the draws do, some per mille."""
    twin = read_twin(folder / "twin.toml")
    settings = DatasetSettings(protocol="three-axis", samples=300, seed=5)
    samples = simulate_twin(twin, layer_response(twin.design), settings)
    decoder = twin.read_decoder()
    require_same_sensor(decoder, samples, folder / "own.safetensors", folder / "samples.nc")
    expected = decoder.inverse.forward.resistances(samples.force_n.reshape(300, -1))
    apart = samples.resistance_ohm.reshape(300, -1) / expected - 1.0
    found = decoder.inverse.forward.resistances(truth.force_n.reshape(200, -1))
    off = truth.resistance_ohm.reshape(200, -1) / found - 1.0
    assert 0 < np.sqrt(np.mean(apart**2)) < 0.02
    assert np.sqrt(np.mean(off**2)) < 3 * np.sqrt(np.mean(apart**2) + 0.001**2)
    more = simulate_twin(twin, layer_response(twin.design), replace(settings, samples=400))
    assert more.resistance_ohm[:300] == pytest.approx(samples.resistance_ohm, rel=1e-6)  # draws are in single precision
    many = replace(settings, samples=BLOCK + 40)
    part = simulate_twin(twin, layer_response(twin.design), many, numbers=range(BLOCK, BLOCK + 40))
    whole = simulate_twin(twin, layer_response(twin.design), many)
    assert part.resistance_ohm == pytest.approx(whole.resistance_ohm[BLOCK:], rel=1e-6)
    with pytest.raises(DesignError, match=r"gain_spread=0\.1: a twin has its own"):
        simulate_twin(twin, layer_response(twin.design), replace(settings, gain_spread=0.1))


def test_other_samples_are_of_another_sensor(folder, truth):
    decoder = read_twin(folder / "twin.toml").read_decoder()
    other = replace(truth, design=replace(DESIGN, array=replace(DESIGN.array, pitch_mm=16.0)))
    with pytest.raises(FileFormatError, match="pitch_mm"):
        require_same_sensor(decoder, other, folder / "own.safetensors", folder / "samples.nc")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("misfit =", "fit =", "unknown key 'fit' in .twin."),
        ('"unit.height_mm" = [', '"unit.depth_mm" = [', "no parameter 'unit.depth_mm'"),
        ("[twin.gain]", "[twin.gain]\nq = [1.0]", r"gain must be 2 rows of 2 a pillar"),
        ("pairs = 20", 'pairs = "many"', "pairs must be a value of type int"),
    ],
)
def test_a_twin_that_makes_no_sense_is_refused(folder, tmp_path, old, new, message):
    text = (folder / "twin.toml").read_bytes().replace(old.encode(), new.encode(), 1)
    changed = re.sub(MARK + b"[0-9a-f]{64}", BLANK, text)
    (tmp_path / "twin.toml").write_bytes(b"".join(sealed(changed)))  # as if it had been written so
    with pytest.raises(DesignError, match=message):
        read_twin(tmp_path / "twin.toml")


@settings(max_examples=60, deadline=None)
@given(at=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), cut=st.booleans())
def test_a_damaged_twin_is_refused(folder, at, bit, cut):
    """A flipped bit anywhere, and a file that lost its end, but for its first line, which states the hash."""
    whole = (folder / "twin.toml").read_bytes()
    place = max(int(at * len(whole)), cut * (whole.index(b"\n") + 1))
    other = whole[:place] if cut else whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :]
    path = folder / "damaged.toml"
    path.write_bytes(other)
    with pytest.raises((DesignError, FileFormatError)):
        read_twin(path)


def test_another_decoder_is_refused(folder, tmp_path):
    (tmp_path / "twin.toml").write_bytes((folder / "twin.toml").read_bytes())
    decoder = read_twin(folder / "twin.toml").read_decoder()
    write_model(replace(decoder, made_from={"other": "pairs"}), tmp_path / "own.safetensors")
    with pytest.raises(DesignError, match="not the decoder that the twin was written with"):
        read_twin(tmp_path / "twin.toml").read_decoder()
