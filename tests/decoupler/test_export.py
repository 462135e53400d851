"""Exported models: what they say of themselves, and what is refused; `test_contract` holds their forces."""

import re
import shutil
import subprocess

import numpy as np
import onnxruntime
import pytest

from common.errors import MissingPackageError
from decoupler import write_model
from decoupler.export import checked, export_model
from decoupler.export.c_header import header_text
from decoupler.export.portable import ExportError
from geometry import DesignError
from tests.decoupler.exported import STRICT
from tests.decoupler.test_contract import made
from tests.house import House


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
    header = header_text(made("dead-inverse").model, np.float32)
    arrays = re.findall(r"^static const (float|short) \w+((?:\[\d+\])+)", header, re.MULTILINE)
    sizes = [{"float": 4, "short": 2}[kind] * np.prod([*map(int, re.findall(r"\d+", size))]) for kind, size in arrays]
    assert f"Flash: {sum(sizes)} bytes" in header
    (tmp_path / "model.h").write_text(header, encoding="utf-8")
    (tmp_path / "sketch.cpp").write_text(
        '#include "model.h"\nvoid loop(float *r, float *f) { tripillar_forces(r, f); }'
    )
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


def test_on_the_command_line(tmp_path):
    write_model(made("fz-plain-resistance").model, tmp_path / "model.safetensors")
    result = House(tmp_path).result("export", "--model", "model.safetensors", "--out", "model.h")
    assert (result["precision"], result["deviation"] < 1e-4) == ("float", True)
    assert (tmp_path / result["file"]).exists()
