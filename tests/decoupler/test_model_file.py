"""Files of models and exports: refusals, nothing half-written, what they say; `test_contract` has their round trip."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from common.errors import MissingPackageError
from common.storage.seal import BLANK, MARK, sealed
from decoupler import NetworkConfig, TrainingConfig, train
from decoupler.export import checked, export_model
from decoupler.export.c_header import header_text
from decoupler.export.checked import facts_of, traced
from decoupler.export.onnx_file import onnx_model
from decoupler.export.traced import ExportError, Traced
from decoupler.model_file import model_cache_key, read_model, require_same_sensor, write_model
from geometry import Array, DesignError, FileFormatError
from geometry.design import Electrics, Memory, Prony
from tests.decoupler.exported_forms import CC, STRICT, by_header, by_onnx
from tests.decoupler.synthetic_sensor import RESPONSE, SMALL, labelled, response, sensor
from tests.decoupler.test_contract import made

DATA = labelled(SMALL, "xyz", n_samples=40, seed=0)
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
    """What differs is named with both values; data of no stated design, or of other drifts or memory, are taken."""
    require_same_sensor(decoupler, DATA, "m", "d")
    drifting = replace(DATA.design, electrics=Electrics(drift=0.005))
    rubber = replace(DATA.design.pillar_material, memory=Memory(a=(0.1, 0.0)), prony=Prony(share=(0.1, 0.0)))
    for design in (None, drifting, replace(DATA.design, pillar_material=rubber)):
        require_same_sensor(decoupler, replace(DATA, design=design), "m", "d")
    other = replace(DATA.design, array=Array(rows=2, cols=3, pitch_mm=17.0))
    for data, said in (
        (replace(DATA, design=other), r"another sensor .* \(array.pitch_mm: model 15, data 17\)"),
        (labelled(sensor(1, 2), "xyz", 4, 0), "rows: model 2, data 1; cols: model 3, data 2"),
    ):
        with pytest.raises(FileFormatError, match=said):
            require_same_sensor(decoupler, data, "m", "d")


def test_using_a_model_loads_no_torch_and_nothing_that_solves(path):
    """A live sensor starts in a fraction of a second; torch alone takes seconds."""
    code = (
        "import sys, pathlib, tripillar; tripillar.read_model(pathlib.Path(sys.argv[1])); "
        "sys.exit(bool({'torch', 'skfem', 'fem'} & {name.split('.')[0] for name in sys.modules}))"
    )
    assert subprocess.run([sys.executable, "-c", code, path], check=False).returncode == 0


def test_onnx_says_what_it_is(tmp_path):
    model = made("dead-inverse").model
    exported = export_model(model, tmp_path / "model.onnx")
    assert (exported.precision, exported.deviation < 1e-12) == ("double", True)
    session = onnxruntime.InferenceSession(tmp_path / "model.onnx")
    asked = [(one.name, one.type, one.shape) for one in session.get_inputs()]
    assert asked == [("resistance_ohm", "tensor(double)", ["n", 2, 3, 3])]
    told = session.get_modelmeta().custom_metadata_map
    stated = (model.design_hash, model.made_from["data_hash"], model.made_from["recipe"])
    assert tuple(told[name] for name in ("design_hash", "data_hash", "model_hash")) == stated


def test_a_header_states_its_size_and_is_cpp_too(tmp_path):
    """Bytes of constants as counted from the arrays in the text: floats of 4, shorts of 2. A sketch is C++."""
    case = made("dead-inverse")
    header = header_text(traced(case.model, case.test.resistance_ohm.astype(np.float32)), facts_of(case.model))
    arrays = re.findall(r"^static const (float|short) \w+((?:\[\d+\])+)", header, re.MULTILINE)
    sizes = [{"float": 4, "short": 2}[kind] * np.prod([*map(int, re.findall(r"\d+", size))]) for kind, size in arrays]
    assert f"Flash: {sum(sizes)} bytes" in header
    (tmp_path / "model.h").write_text(header, encoding="utf-8")
    sketch = '#include "model.h"\nvoid loop(float *r, float *f) { tripillar_forces(r, f); }'
    (tmp_path / "sketch.cpp").write_text(sketch)
    if (compiler := shutil.which("c++")) is not None:
        subprocess.run([compiler, "-std=c++11", *STRICT, "-fsyntax-only", "sketch.cpp"], cwd=tmp_path, check=True)


def test_what_cannot_be_exported_is_refused_and_leaves_the_old_file(tmp_path, monkeypatch):
    model = made("converter").model
    for name, precision, said in (
        ("model.tflite", None, r"model.tflite must end in .onnx or .h"),
        ("model.h", "half", "precision='half' is unknown; choose one of float, double"),
    ):
        with pytest.raises(DesignError, match=said):
            export_model(model, tmp_path / name, precision)
    (tmp_path / "m.h").write_text("old")
    monkeypatch.setattr(checked, "MAX_DEVIATION", 1e-9)
    with pytest.raises(ExportError, match="is not written: rounding to float moves its forces by"):
        export_model(model, tmp_path / "m.h")
    assert (tmp_path / "m.h").read_text() == "old"
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    monkeypatch.delitem(__import__("sys").modules, "decoupler.export.onnx_file", raising=False)
    with pytest.raises(MissingPackageError, match=r"pip install 'tripillar\[export\]'"):
        export_model(model, tmp_path / "m.onnx")


SHAPE = 3, 4, 3  #: rows, columns and pillars of a made-up sensor
GENERATOR = np.random.default_rng(0)
W1, W2, LIMIT = (GENERATOR.normal(size=size) for size in ((27, 5), (8, 2), 5))


def convolved(ohms):
    """A network that no file knows: a 3 × 3 convolution over units, and a linear layer that sees all pillars, too."""
    n, units = len(ohms), np.pad(np.arange(12).reshape(3, 4), 1, constant_values=12)
    near = np.array([units[row : row + 3, col : col + 3].reshape(-1) for row in range(3) for col in range(4)])
    x = (ohms**0.5 / 100.0 - 1.0).reshape(n, 12, 3)
    beside = np.concatenate([x, np.zeros_like(x[:, :1])], axis=1)[:, near].reshape(n, 12, 27)
    hidden = np.minimum(np.tanh(beside @ W1 + 0.1).clip(-0.5), LIMIT)
    hidden *= (abs(hidden) > 0.2) & ~(x[..., :1] < -0.2) & (LIMIT > -1.0)
    hidden = hidden + (LIMIT > 0.0)
    pooled = np.sum(hidden.swapaxes(1, 2) ** 2, axis=-1) / 12.0
    forces = 2.0 * (np.concatenate([hidden * np.exp(-pooled)[:, None], x], axis=2) @ W2 + 1.0) + 0.5
    return (forces + (x @ x.swapaxes(1, 2)) @ forces)[:, ::-1].reshape(n, 3, 4, 2)


def test_a_network_is_exported_as_it_is_written():
    """Another order of sums rounds by some 1e-15 of the largest force."""
    scans = np.random.default_rng(1).uniform(5e3, 2e4, (5, *SHAPE))
    expected, graph = convolved(scans), convolved(Traced(scans, scans.dtype))
    forms = [graph.values, by_onnx(onnx_model(graph, {}).SerializeToString(), scans, np.float64)]
    forms += [by_header(header_text(graph, {}), scans, np.float64)] if CC is not None else []
    for found in forms:
        np.testing.assert_allclose(found.reshape(expected.shape), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("network", "said"),
    [
        (lambda x: np.linalg.inv(x[..., 0]), "inv"),
        (lambda x: np.sort(x, axis=1), "sort"),
        (lambda x: np.einsum("nrcp->nrc", x), "einsum"),
        (lambda x: np.hypot(x, 1.0), "hypot"),
        (lambda x: x.cumsum(axis=1), "cumsum"),
        (lambda x: np.maximum.reduce(x, axis=1), "maximum.reduce"),
        (lambda x: x[0, 0, 0, 0] * x, "a move of elements from scan to scan"),
        (lambda x: x if x.sum(axis=3) > 1.0 else 2.0 * x, "a decision by what is read"),
        (lambda x: x - x.sum(axis=0), "a sum over scans"),
        (lambda x: x[::-1], "a move of elements from scan to scan"),
        (lambda x: x.reshape(-1, 3), "a move of elements from scan to scan"),
        (lambda x: x[:, :1, :1, :1] + x[:, 0, 0, :1], "an operation that mixes scans"),
        (lambda x: x * np.arange(len(x))[:, None, None, None], "an operation that tells scans apart"),
        (lambda x: np.ones((7, 7)) @ x[:, 0, 0], "a matrix product that mixes scans"),
    ],
)
def test_what_no_file_can_do_is_refused_by_its_name(network, said):
    with pytest.raises(ExportError, match=f"models that need {said} are not exported"):
        network(Traced(np.ones((7, *SHAPE)), np.dtype(float)))
