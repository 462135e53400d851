"""The sensor's solids against closed forms, and the files they are written to."""

import numpy as np
import pytest
from build123d import GeomType, import_step

from geometry import GeometryError, SensorDesign
from geometry.cad import (
    STEP_TIME,
    array_solid,
    matrix_solid,
    pillar_solids,
    sensor_solids,
    slab_solid,
    unit_solid,
    write_solids,
)
from geometry.layout import pillar_ends, pillar_shares, pillar_volumes, unit_centres
from tests.geometry.closed_forms import oblique_width, union_mm3

EXACT = 1e-9  # rounding of the CAD kernel's integrals; every form below is exact


def bounds(solid) -> np.ndarray:
    box = solid.bounding_box(optimal=True)
    return np.array([tuple(box.min), tuple(box.max)])


def test_pillars_are_squares_of_the_width_swept_from_electrode_to_electrode(design):
    """They end flush on the centres of their electrodes, and V = S·l."""
    pillars, ends = pillar_solids(design.unit), pillar_ends(design.unit)
    assert [pillar.volume for pillar in pillars] == pytest.approx(pillar_volumes(design.unit), rel=EXACT)
    for pillar, (bottom, top) in zip(pillars, ends, strict=True):
        faces = sorted(pillar.faces(), key=lambda face: abs(face.normal_at().Z))
        sides, flat = faces[:4], sorted(faces[4:], key=lambda face: face.center().Z)
        assert [tuple(face.center()) for face in flat] == [pytest.approx(end, abs=EXACT) for end in (bottom, top)]
        normals = np.array([tuple(face.normal_at()) for face in sides])
        assert normals @ (top - bottom) == pytest.approx(np.zeros(4), abs=1e1 * EXACT)
        # each side lies half a width from the axis, and square to or opposite each other side
        distances = [n @ (np.array(tuple(f.center())) - bottom) for n, f in zip(normals, sides, strict=True)]
        assert distances == pytest.approx([design.unit.pillar_width_mm / 2] * 4, abs=EXACT)
        assert np.sort(normals @ normals.T, axis=1) == pytest.approx(np.tile([-1, 0, 0, 1], (4, 1)), abs=EXACT)


def test_a_unit_is_one_body_of_its_closed_form_that_spans_its_footprint(design):
    """The same by shares of boxes, whose lines lie 1/400 of the footprint apart: within 0.1 %."""
    solid, unit = unit_solid(design.unit), design.unit
    assert solid.volume == pytest.approx(union_mm3(unit), rel=EXACT)
    lines = np.linspace(-0.51, 0.51, 401) * unit.footprint_mm, np.linspace(0.0, unit.height_mm, 41)
    boxes = np.diff(lines[0])[0] ** 2 * np.diff(lines[1])[0]
    assert pillar_shares(unit, lines[0], lines[0], lines[1]).sum() * boxes == pytest.approx(union_mm3(unit), rel=1e-3)
    assert solid.is_valid
    assert len(solid.solids()) == 1
    end = (unit.span_mm + oblique_width(unit)) / 2
    assert bounds(solid) == pytest.approx(np.array([[-end, -end, 0], [end, end, unit.height_mm]]), abs=1e-6)


def test_an_array_is_a_unit_at_every_centre_and_none_touch(design):
    first, *others = array_solid(design).solids()
    whole, one = unit_solid(design.unit), bounds(unit_solid(design.unit))
    for unit, centre in zip((first, *others), unit_centres(design), strict=True):
        assert unit.volume == pytest.approx(whole.volume, rel=EXACT)
        assert bounds(unit) == pytest.approx(one + np.append(centre, 0.0), abs=1e-6)
    assert all(first.distance_to(other) > 0.1 for other in others)


def test_matrix_is_the_slab_without_the_pillars(design):
    slab, matrix = slab_solid(design), matrix_solid(design)
    assert slab.volume == pytest.approx(np.prod(design.slab_mm), rel=EXACT)
    x, y, h = design.slab_mm
    assert bounds(matrix) == pytest.approx(np.array([[-x / 2, -y / 2, 0], [x / 2, y / 2, h]]), abs=1e-6)
    assert matrix.is_valid
    assert len(matrix.solids()) == 1
    assert matrix.volume == pytest.approx(slab.volume - design.n_units * unit_solid(design.unit).volume, rel=EXACT)
    assert all(face.geom_type == GeomType.PLANE for face in matrix.faces())


def test_step_files_hold_the_solids_exactly_and_one_design_gives_the_same_bytes_twice(small_design, tmp_path):
    """Also within one process, where the CAD kernel goes on counting parts, and under another path."""
    solids = sensor_solids(small_design)
    assert len(write_solids(solids, tmp_path / "first")) == 14
    for name, solid in solids.items():
        read = import_step(tmp_path / "first" / f"{name}.step")
        assert len(read.solids()) == len(solid.solids())
        assert read.volume == pytest.approx(solid.volume, rel=EXACT)
        assert bounds(read) == pytest.approx(bounds(solid), abs=1e-6)
    write_solids(sensor_solids(small_design), tmp_path / "second")
    first, second = ({path.name: path.read_bytes() for path in (tmp_path / at).iterdir()} for at in ("first", "second"))
    assert first == second
    assert STEP_TIME.encode() in first["unit.step"]  # the two may be written within a second


def test_nothing_is_written_if_any_surface_is_refused(tmp_path):
    unit = unit_solid(SensorDesign().unit)
    with pytest.raises(GeometryError, match="'lidless' is not watertight"):
        write_solids({"whole": unit, "lidless": unit.faces()[0]}, tmp_path)
    assert list(tmp_path.iterdir()) == []
