"""The public face: few names, each with an example, loaded when it is used."""

import doctest
import importlib
import re
from dataclasses import replace

import numpy as np
import pytest

import tripillar as tp
from fem.array.closed_forms import layer_response
from geometry import Array
from geometry.design import Pad
from tests.docs.terminal import ROOT

MAX_NAMES = 24
DESIGN = replace(tp.SensorDesign(), array=replace(tp.SensorDesign().array, rows=1, cols=2))
QUICK = {"hidden": 2, "max_iterations": 2}


def test_it_has_few_names_each_with_an_example_and_no_module_is_hidden():
    """The doctests themselves run as all others do."""
    files = [path.stem for path in (ROOT / "tripillar" / "face").glob("*.py") if path.stem != "__init__"]
    modules = [tp, *(importlib.import_module(f"tripillar.face.{name}") for name in files)]
    found = [test for module in modules for test in doctest.DocTestFinder().find(module)]
    used = set(re.findall(r"\btp\.(\w+)", "".join(each.source for test in found for each in test.examples)))
    assert len(tp.__all__) <= MAX_NAMES
    assert used - {"__version__"} == set(tp.__all__)
    for name in tp.__all__:
        assert getattr(tp, name) is getattr(tp, name)
        assert name in dir(tp)
        assert not (ROOT / "tripillar" / f"{name}.py").exists()
        assert not (ROOT / "tripillar" / name).exists()
    with pytest.raises(AttributeError, match="module 'tripillar' has no attribute 'trian'; it has Samples, "):
        _ = tp.trian


def test_a_given_response_is_used_and_what_is_of_another_design_type_or_name_refused(monkeypatch):
    """Whatever its tolerance or method, and none is solved."""
    known, other = (layer_response(one) for one in (DESIGN, replace(DESIGN, pad=Pad(size_mm=11.0))))
    samples = tp.dataset(known, "contact-fz", 60, noise=1e-3)
    monkeypatch.setattr("tripillar.pipeline.stage.array_response", lambda *_: pytest.fail("solved"))
    assert tp.train(replace(samples, design=None), response=known, **QUICK).form.feature == "inverse"
    model = tp.train(samples, response=known, **QUICK)
    untold = replace(samples, design=None)
    told = tp.train(untold, design=DESIGN, response=known, **QUICK)
    assert told.design == DESIGN
    assert np.array_equal(told.forces(samples.resistance_ohm), model.forces(samples.resistance_ohm))
    tp.evaluate(None, untold, folds=2, design=DESIGN, response=known, **QUICK)
    assert tp.evaluate(model, samples[40:], response=known)["fz"].limits is not None
    for call in (
        lambda given: tp.train(samples, net="plain", response=given, **QUICK),
        lambda given: tp.evaluate(model, samples[40:], response=given),
        lambda given: tp.evaluate(None, samples, folds=2, response=given),
    ):
        with pytest.raises(tp.TriPillarError, match=r"^the response is of another design than samples: [^\n]*\.$"):
            call(other)
        with pytest.raises(tp.TriPillarError, match=r"^response is of type Samples, expected ArrayResponse"):
            call(samples)
    for call, says in (
        (lambda: tp.write({}, "x"), "a dict cannot be written"),
        (lambda: tp.sweep({}), r"^file is of type dict, expected a path: write it to a file \(TOML\)\.$"),
        (lambda: tp.dataset(nois=0.1), "nois= is no argument; there are bits, "),
    ):
        with pytest.raises(tp.TriPillarError, match=says):
            call()


def test_notebooks_show_what_samples_evaluations_and_designs_are(tmp_path):
    """In a line or a few, with size and kind, no array printed."""
    known = layer_response(DESIGN)
    tp.write(tp.dataset(known, "contact-fz", 60), tmp_path / "samples.zarr")
    stored = tp.read_samples(tmp_path / "samples.zarr")
    assessed = tp.evaluate(tp.train(stored, response=known, **QUICK), stored[40:], response=known)
    shown = ((DESIGN, "pitch_mm"), (stored, "60 "), (stored[:9], "9 samples of 1 × 2"), (assessed, "fz: "))
    for thing, said in shown:
        for text in (repr(thing), thing._repr_html_()):
            assert (said in text, "array(" in text, len(text) < 8000) == (True, False, True)


def test_options_that_data_contradict_or_training_would_ignore_are_refused():
    """Another design; a network's form where maps are learned; two kinds of samples for one network."""
    response = layer_response(tp.SensorDesign(array=Array(rows=1, cols=2)))
    linear = tp.dataset(response, "three-axis", 8, seed=1)
    finite, mixed = (replace(linear, strain_model=np.minimum(np.arange(8.0) + k, 1.0)) for k in (1, 0))
    other = replace(response.design, pad=Pad(size_mm=11.0))
    for data, asked, said in (
        (linear, {"design": other}, "is of another design than design=: leave it out"),
        (replace(linear, design=None), {"design": tp.SensorDesign()}, "is of another design than design="),
        (finite, {"hidden": 5}, "is at finite strain, which maps learn: leave hidden=, net= and feature= out"),
        (finite, {"net": "convolution"}, "which maps learn"),
        (finite, {"feature": "inverse"}, "which maps learn"),
        (mixed, {"feature": "root"}, "holds linear samples and others at finite strain: give one kind"),
    ):
        with pytest.raises(tp.TriPillarError, match=said):
            tp.train(data, response=response, **asked)
