"""Exported models against `Decoupler.forces`: the ONNX graph by onnxruntime, the header by the system's C compiler."""

import re
import shutil
import subprocess
import sys

import numpy as np
import onnxruntime
import pytest

from decoupler import write_model
from decoupler.export import export_model
from decoupler.export.c_header import STRICT, header_text
from decoupler.export.portable import ExportError, output_weights_n
from geometry import DesignError
from geometry.storage.files import digest
from tests.decoupler.test_contract import made
from tests.house import House

CC = shutil.which("cc")
needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler 'cc' is installed")
ROUNDING = 1e-9  #: of full scale; double leaves some 1e-15, from another order of sums


def trained(name: str = "fz-plain-resistance"):
    """The decoder of a case of the contract."""
    return made(name).model


def test_as_designed_and_nothing_dead():
    """Without a converter and dead pillars the exported forms lack those steps."""
    for name in ("ANY_DEAD", "CONVERTER", "STEPS"):
        assert f"#define TRIPILLAR_{name} 0\n" in header_text(trained("all-skip-root"), np.float64)


def test_onnx_says_what_it_is(tmp_path):
    model = trained("dead-inverse")
    exported = export_model(model, tmp_path / "model.onnx")
    assert exported.precision == "double"
    assert exported.deviation < ROUNDING
    session = onnxruntime.InferenceSession(tmp_path / "model.onnx")
    assert [(i.name, i.type, i.shape) for i in session.get_inputs()] == [
        ("resistance_ohm", "tensor(double)", ["n", 2, 3, 3])
    ]
    told = session.get_modelmeta().custom_metadata_map
    assert told["component"] == "all"
    assert told["feature"] == "inverse"
    assert told["design_hash"] == digest(model.design)
    assert told["data_hash"] == model.made_from["data_hash"]
    assert told["model_hash"] == model.made_from["recipe"]
    assert "ohm" in told["units"]
    assert told["version"]


@pytest.mark.parametrize("feature", ["root", "inverse"])
def test_header_states_its_size(feature):
    """Bytes of constants as counted from the arrays in the text: floats of 4, shorts of 2."""
    header = header_text(trained(f"dead-{feature}"), np.float32)
    arrays = re.findall(r"^static const (float|short) \w+((?:\[\d+\])+)", header, re.MULTILINE)
    counted = sum(
        {"float": 4, "short": 2}[kind] * np.prod([int(n) for n in re.findall(r"\d+", size)]) for kind, size in arrays
    )
    assert f"Flash: {counted} bytes" in header


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler 'c++' is installed")
def test_header_is_cpp_too(tmp_path):
    """An Arduino sketch is C++."""
    (tmp_path / "model.h").write_text(header_text(trained("dead-inverse"), np.float32), encoding="utf-8")
    (tmp_path / "sketch.cpp").write_text(
        '#include "model.h"\nvoid loop(float *r, float *f) { tripillar_forces(r, f); }'
    )
    subprocess.run(["c++", "-std=c++11", *STRICT[1:], "-fsyntax-only", "sketch.cpp"], cwd=tmp_path, check=True)


@pytest.mark.parametrize(("name", "module"), [("m.onnx", "onnx_file"), pytest.param("m.h", "c_header", marks=needs_cc)])
def test_what_deviates_is_not_kept(name, module, tmp_path, monkeypatch):
    """With weights a thousandth off the check fails, and the old file is still there."""
    (tmp_path / name).write_text("old")
    monkeypatch.setattr(f"decoupler.export.{module}.output_weights_n", lambda model: 1.001 * output_weights_n(model))
    with pytest.raises(ExportError, match="is not written: its forces deviate from the model's by"):
        export_model(trained(), tmp_path / name)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "old"


def test_what_is_not_installed_is_said(tmp_path, monkeypatch):
    model = trained()
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert export_model(model, tmp_path / "m.onnx").unchecked == "onnxruntime is not installed"
    assert (tmp_path / "m.onnx").stat().st_size > 0
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert export_model(model, tmp_path / "m.h").unchecked == "no C compiler 'cc' is installed"
    monkeypatch.setitem(sys.modules, "decoupler.export.onnx_file", None)
    with pytest.raises(ExportError, match=r"pip install 'tripillar\[export\]'"):
        export_model(model, tmp_path / "other.onnx")
    assert not (tmp_path / "other.onnx").exists()


def test_what_is_unknown_is_refused(tmp_path):
    model = trained()
    with pytest.raises(DesignError, match=r"model.tflite must end in .onnx or .h"):
        export_model(model, tmp_path / "model.tflite")
    with pytest.raises(DesignError, match="precision='half' is unknown; choose one of float, double"):
        export_model(model, tmp_path / "model.h", "half")
    assert not list(tmp_path.iterdir())


def test_on_the_command_line(tmp_path):
    write_model(trained(), tmp_path / "model.safetensors")
    house = House(tmp_path)
    done = house.tripillar("export", "--model", "model.safetensors", "--out", "model.onnx")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("largest deviation from the model: ")
    assert done.stderr.splitlines() == ["model.onnx"]
    result = house.result("export", "--model", "model.safetensors", "--out", "model.h")
    assert result["precision"] == "float"
    assert (tmp_path / result["file"]).exists()
    for words, says in (
        (("--model", "model.safetensors", "--out", "model.pt"), "must be a file that ends in .onnx or .h"),
        (("--model", "none.safetensors", "--out", "other.h"), "no such file"),
        (("--model", "model.onnx", "--out", "other.h"), "no safetensors file"),
    ):
        assert says in house.refusal("export", *words)
