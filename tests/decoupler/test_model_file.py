"""The model file: refusals in one line, nothing half-written; `test_contract` has its round trip."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from common.storage.seal import BLANK, MARK, sealed
from decoupler import (
    NetworkConfig,
    TrainingConfig,
    model_cache_key,
    read_model,
    require_same_sensor,
    train,
    write_model,
)
from geometry import Array, FileFormatError
from tests.decoupler.synthetic_sensor import labelled, response, sensor

DATA = labelled(sensor(2, 3), "xyz", n_samples=40, seed=0)
RESPONSE = response(sensor(2, 3))
NETWORK = NetworkConfig(hidden=4)
FEW = TrainingConfig(max_iterations=2)


@pytest.fixture(scope="module")
def decoupler():
    return train(DATA, "all", NETWORK, FEW)


@pytest.fixture
def path(decoupler, tmp_path):
    write_model(decoupler, tmp_path / "model.safetensors")
    return tmp_path / "model.safetensors"


def opened(path):
    with safe_open(path, framework="np") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118, no mapping
        return json.loads(file.metadata()["tripillar"]), arrays


def test_same_training_gives_the_same_file_which_anyone_can_read(path, tmp_path):
    write_model(train(DATA, "all", NETWORK, FEW), tmp_path / "b")
    assert path.read_bytes() == (tmp_path / "b").read_bytes()
    header, _ = opened(path)
    assert (header["network"]["hidden"], header["made_from"]["training"]["seed"]) == (4, 0)
    assert header["made_from"]["recipe"] == model_cache_key(DATA, "all", NETWORK, FEW)
    assert header["made_from"]["data_hash"] == DATA.content_hash


def test_what_is_no_model_file_is_refused_and_a_failed_write_leaves_the_old_one(decoupler, path, tmp_path):
    whole = path.read_bytes()
    with pytest.raises(TypeError):
        write_model(replace(decoupler, made_from={"no": object()}), path)
    assert [entry.read_bytes() for entry in tmp_path.iterdir()] == [whole]
    for share in (0.0, 0.01, 0.999):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FileFormatError, match=r"damaged|truncated or no safetensors file"):
            read_model(path)
    save_file({"weight": np.ones(3)}, path)
    for other, said in (
        (path, "no model of this program"),
        (tmp_path / "none", "no such file"),
        (tmp_path, "a folder"),
    ):
        with pytest.raises(FileFormatError, match=said):
            read_model(other)


def test_recipe_follows_all_that_matters():
    known, root = replace(NETWORK, feature="inverse"), replace(NETWORK, feature="root")
    recipe = model_cache_key(DATA, "fz", root, FEW)
    assert recipe == model_cache_key(DATA, "fz", root, FEW, RESPONSE)  # its feature does not heed the response
    others = [
        (replace(DATA, force_n=-DATA.force_n), "fz", root, FEW),
        (replace(DATA, dead=np.ones((2, 3, 3), dtype=bool)), "fz", root, FEW),
        (DATA, "fx", root, FEW),
        (DATA, "fz", root, replace(FEW, seed=1)),
        (DATA, "fz", NETWORK, FEW),
        (DATA, "fz", NETWORK, FEW, RESPONSE),
        (DATA, "fz", known, FEW, RESPONSE),
        (DATA, "fz", known, FEW, response(sensor(2, 2))),
    ]
    assert len({recipe, *(model_cache_key(*asked) for asked in others)}) == 9


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda header, arrays: header.pop("component"), "its header makes no sense"),
        (lambda header, arrays: header.update(format="tripillar-model-1"), "of another version, train it again"),
        (lambda header, arrays: header["network"].update(net="deep"), "net='deep' must be one of plain, skip"),
        (lambda header, arrays: arrays.pop("front.scaling.centre"), "centre"),
        (lambda header, arrays: arrays.update({"output_scaling.centre": np.ones(3)}), "do not belong together"),
        (lambda header, arrays: arrays["network.hidden"].fill(np.nan), "network.hidden is not finite"),
    ],
)
def test_file_that_contradicts_itself_is_refused(path, change, message):
    header, arrays = opened(path)
    change(header, arrays)
    save_file(arrays, path, {"tripillar": json.dumps(header)})
    with pytest.raises(FileFormatError, match="damaged, its content does not match the hash it states"):
        read_model(path)
    unsealed = re.sub(MARK + b"[0-9a-f]{64}", BLANK, path.read_bytes())
    path.write_bytes(b"".join(sealed(unsealed)))  # as if it had been written so
    with pytest.raises(FileFormatError, match=message):
        read_model(path)


def test_data_of_another_sensor_are_refused(decoupler):
    """What differs is named with both values; data that state no design are taken if the array fits."""
    require_same_sensor(decoupler, DATA, "m", "d")
    require_same_sensor(decoupler, replace(DATA, design=None), "m", "d")
    other = replace(DATA.design, array=Array(rows=2, cols=3, pitch_mm=17.0))
    for data, said in (
        (replace(DATA, design=other), r"another sensor .* \(array.pitch_mm: model 15, data 17\)"),
        (labelled(sensor(1, 2), "xyz", 4, 0), "rows: model 2, data 1; cols: model 3, data 2"),
    ):
        with pytest.raises(FileFormatError, match=said):
            require_same_sensor(decoupler, data, "m", "d")
