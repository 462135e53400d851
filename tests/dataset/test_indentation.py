"""Data sets of contact by shape."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import DatasetSettings, read_samples, simulate
from dataset.indentation import judged_press, largest_strain, samples_of, write_contact
from dataset.resistance import pillar_resistances
from fem import SolverError
from fem.contact import ContactError, Sphere, press, surface_compliance
from geometry.design import Array, SensorDesign
from geometry.layout import pillar_volumes
from tests.dataset.conftest import made_up_response

DESIGN = SensorDesign(array=Array(rows=1, cols=2))


def test_labels_are_those_of_the_contact_and_depend_on_seed_and_number_alone(tmp_path, shared_cache):
    """Forces press, tractions are forces over the pad, resistances follow from the lengths; the file says the same."""
    known = made_up_response(DESIGN)  # which contact does not ask
    settings = DatasetSettings(protocol="indent", samples=1, seed=3)
    few, data = simulate(known, settings), simulate(known, replace(settings, samples=2, noise=0.001))
    assert np.array_equal(few.force_n, data.force_n[:1])
    assert np.array_equal(few.displacement_mm, data.displacement_mm[:1])
    assert (data.force_n[..., 2] >= 0).all()
    assert (data.force_n[..., 2].sum(axis=(1, 2)) > 0).all()
    assert data.traction_mpa * [144.0, 144.0, -144.0] == pytest.approx(data.force_n, rel=1e-12)
    ohms = pillar_resistances(few.length_mm, pillar_volumes(DESIGN.unit), DESIGN.resistivity_ohm_mm)
    assert few.resistance_ohm == pytest.approx(ohms, rel=1e-12)
    contact = press(DESIGN, Sphere(6.0), 0.8, at_mm=(3.0, 0.0), cells=16)
    write_contact(contact, tmp_path / "contact.nc")
    kept = read_samples(tmp_path / "contact.nc")
    assert kept.force_n[0] == pytest.approx(contact.force_n, rel=1e-12)
    assert kept.resistance_ohm == pytest.approx(samples_of([contact]).resistance_ohm, rel=1e-12)
    assert 0 < largest_strain(contact) < 0.3


def test_a_press_without_balance_is_left_out_as_one_whose_error_is_too_large(monkeypatch, shared_cache):
    def unbalanced(*_: object, **__: object) -> None:
        raise SolverError("no balance")

    monkeypatch.setattr("dataset.indentation.press", unbalanced)
    with pytest.raises(ContactError, match="no balance"):
        judged_press(np.random.default_rng(0), surface_compliance(DESIGN)[0])
