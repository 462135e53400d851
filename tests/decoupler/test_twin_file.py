"""Twins as files: read as written, refused in one line, and the samples that are drawn from them."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.errors import DesignError, FileFormatError
from common.storage.seal import BLANK, MARK, sealed
from dataset import DatasetSettings, simulate
from dataset.simulation import BLOCK
from decoupler.data.pairs import Pairs
from decoupler.model_file import require_same_sensor, write_model
from decoupler.twin import identify, read_twin, simulate_twin, write_twin
from fem.array.closed_forms import layer_response
from geometry.design import Array, SensorDesign
from geometry.design_file import read_design, write_design
from geometry.layout import pillar_volumes
from geometry.tolerances import with_values
from tests.decoupler.synthetic_sensor import layer_sensitivities

DESIGN = SensorDesign(array=Array(rows=2, cols=2))


@pytest.fixture(scope="module")
def truth():
    made = layer_response(with_values(DESIGN, {"rubber.young_mpa": 5.7, "unit.height_mm": 10.2}))
    settings = DatasetSettings(
        protocol="three-axis", samples=200, seed=3, noise=0.001, gain_spread=0.1, offset_ohm=100.0, specimen=1
    )
    return replace(simulate(made, settings).labels(), design=DESIGN)


@pytest.fixture(scope="module")
def identified(truth):
    return identify(Pairs.of(truth[:20]), layer_response(DESIGN), layer_sensitivities(DESIGN))


@pytest.fixture(scope="module")
def folder(identified, tmp_path_factory):
    path = tmp_path_factory.mktemp("twin")
    write_model(identified.decoder, path / "own.safetensors")
    write_twin(identified, path / "twin.toml", path / "own.safetensors")
    return path


def test_a_twin_is_a_design_at_its_most_probable_values(folder, identified):
    """People read in it what was found; what is computed with is the design and the decoder that it names."""
    twin, design = read_twin(folder / "twin.toml"), read_design(folder / "twin.toml")
    assert twin.design == design
    told, found = twin.told, identified.posterior
    for name, (value, deviation) in identified.parameters.items():
        assert told["parameters"][name] == pytest.approx([value, deviation], rel=1e-2)
    assert design.unit.height_mm == pytest.approx(identified.parameters["unit.height_mm"][0])
    assert np.array(list(told["correlations"].values())).diagonal() == pytest.approx(1.0)
    for name in ("gain", "gain_deviation", "offset_ohm", "offset_deviation_ohm"):
        by_pillar = np.stack([told[name][pillar] for pillar in "zxy"], axis=-1)
        assert by_pillar.ravel() == pytest.approx(getattr(found, name), rel=1e-5)
    assert (found.gain_deviation < found.expected.widths.gain).all()  # the pairs have told something
    c = found.gain * np.tile(design.resistivity_ohm_mm / pillar_volumes(design.unit), 4)
    assert np.allclose(c, twin.read_decoder().inverse.forward.ohm_per_mm2, rtol=1e-3)  # volumes to first order
    write_design(DESIGN, folder / "design.toml")
    assert read_twin(folder / "design.toml") is None


def test_samples_of_a_twin_show_what_is_unknown(folder, truth):
    """The true sensor reads as far from the most probable one as the draws do, some per mille."""
    twin = read_twin(folder / "twin.toml")
    response, many = layer_response(twin.design), DatasetSettings(protocol="three-axis", samples=BLOCK + 40, seed=5)
    samples, decoder = simulate_twin(twin, response, many), twin.read_decoder()
    require_same_sensor(decoder, samples, folder / "own.safetensors", folder / "samples.nc")
    apart, off = (
        data.resistance_ohm.reshape(len(data), -1)
        / decoder.inverse.forward.resistances(data.force_n.reshape(len(data), -1))
        - 1.0
        for data in (samples, truth)
    )
    assert 0 < np.sqrt(np.mean(apart**2)) < 0.02
    assert np.sqrt(np.mean(off**2)) < 3 * np.sqrt(np.mean(apart**2) + 0.001**2)
    part = simulate_twin(twin, response, many, numbers=range(BLOCK, BLOCK + 40))
    few = simulate_twin(twin, response, replace(many, samples=30))  # fewer than sensors
    for each, same in ((part, samples[BLOCK:]), (few, samples[:30])):  # draws are in single precision
        assert each.resistance_ohm == pytest.approx(same.resistance_ohm, rel=1e-6)
    with pytest.raises(DesignError, match=r"gain_spread=0\.1: a twin has its own"):
        simulate_twin(twin, response, replace(many, gain_spread=0.1))


@settings(max_examples=40, deadline=None)
@given(at=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), cut=st.booleans())
def test_a_damaged_twin_is_refused(folder, at, bit, cut):
    """A flipped bit anywhere, and a file that lost its end, but for its first line, which states the hash."""
    whole = (folder / "twin.toml").read_bytes()
    place = max(int(at * len(whole)), cut * (whole.index(b"\n") + 1))
    other = whole[:place] if cut else whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :]
    (folder / "damaged.toml").write_bytes(other)
    with pytest.raises((DesignError, FileFormatError)):
        read_twin(folder / "damaged.toml")


def test_another_decoder_is_refused(folder, tmp_path):
    text = (folder / "twin.toml").read_bytes()
    (tmp_path / "twin.toml").write_bytes(text)
    decoder = read_twin(folder / "twin.toml").read_decoder()
    write_model(replace(decoder, made_from={"other": "pairs"}), tmp_path / "own.safetensors")
    with pytest.raises(DesignError, match="not the decoder that the twin was written with"):
        read_twin(tmp_path / "twin.toml").read_decoder()
    none = re.sub(MARK + b"[0-9a-f]{64}", BLANK, text.replace(b"decoder_hash =", b"# decoder_hash ="))
    (tmp_path / "twin.toml").write_bytes(b"".join(sealed(none)))  # as if it had been written so
    with pytest.raises(DesignError, match=r"\[twin\] names no decoder"):
        read_twin(tmp_path / "twin.toml")
