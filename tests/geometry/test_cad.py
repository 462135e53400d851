"""The sensor's solids against closed forms, and the files they are written to."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from build123d import GeomType, import_step

from geometry import GeometryError, SensorDesign, Unit
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
from geometry.layout import pillar_ends, pillar_volumes, unit_centres
from tests.geometry.closed_forms import oblique_width, union_mm3

EXACT = 1e-9  # rounding of the CAD kernel's integrals; every form below is exact


def bounds(solid) -> np.ndarray:
    box = solid.bounding_box(optimal=True)
    return np.array([tuple(box.min), tuple(box.max)])


def union_volume(unit: Unit) -> float:
    """∫ A dz, where A is the area that three moving rectangles cover together.

    A is quadratic in z between heights at which two edges pass each other: two Gauss points are exact there.
    """
    w, ow, h = unit.pillar_width_mm, oblique_width(unit), unit.height_mm
    half = np.array([[w, w], [ow, w], [w, ow]]) / 2
    bottom, top = pillar_ends(unit)[:, :, :2].transpose(1, 0, 2)

    def low_high(z: float) -> tuple[np.ndarray, np.ndarray]:
        centre = bottom + (top - bottom) * z / h
        return centre - half, centre + half

    def area(z: float) -> float:
        low, high = low_high(z)
        total = 0.0
        for n in (1, 2, 3):
            for chosen in combinations(range(3), n):
                sides = high[list(chosen)].min(axis=0) - low[list(chosen)].max(axis=0)
                total -= (-1) ** n * np.prod(np.maximum(sides, 0.0))
        return total

    edges_0, edges_h = (np.concatenate(low_high(z)) for z in (0.0, h))
    heights = {0.0, h}
    for a, b in combinations(range(6), 2):
        for gap_0, gap_h in zip(edges_0[a] - edges_0[b], edges_h[a] - edges_h[b], strict=True):
            if gap_0 * gap_h < 0:
                heights.add(h * gap_0 / (gap_0 - gap_h))
    volume = 0.0
    for z0, z1 in zip(sorted(heights)[:-1], sorted(heights)[1:], strict=True):
        for point in (-1 / np.sqrt(3), 1 / np.sqrt(3)):
            volume += (z1 - z0) / 2 * area((z0 + z1) / 2 + point * (z1 - z0) / 2)
    return volume


def test_pillar_volume_is_section_times_length(design):
    assert [p.volume for p in pillar_solids(design.unit)] == pytest.approx(pillar_volumes(design.unit), rel=EXACT)


def test_pillars_end_flush_on_the_centres_of_their_electrodes(design):
    for pillar, ends in zip(pillar_solids(design.unit), pillar_ends(design.unit), strict=True):
        flat = sorted((f for f in pillar.faces() if abs(f.normal_at().Z) > 1 - 1e-12), key=lambda f: f.center().Z)
        assert [tuple(face.center()) for face in flat] == [pytest.approx(end, abs=EXACT) for end in ends]


def test_section_perpendicular_to_the_axis_is_a_square_of_the_pillars_width(design):
    for pillar, (bottom, top) in zip(pillar_solids(design.unit), pillar_ends(design.unit), strict=True):
        axis = (top - bottom) / np.linalg.norm(top - bottom)
        sides = [f for f in pillar.faces() if abs(f.normal_at().Z) < 1 - 1e-12]
        normals = np.array([tuple(f.normal_at()) for f in sides])
        assert normals @ axis == pytest.approx(np.zeros(4), abs=EXACT)
        # each side lies half a width from the axis, and square to or opposite each other side
        distances = [n @ (np.array(tuple(f.center())) - bottom) for n, f in zip(normals, sides, strict=True)]
        assert distances == pytest.approx([design.unit.pillar_width_mm / 2] * 4, abs=EXACT)
        assert np.sort(normals @ normals.T, axis=1) == pytest.approx(np.tile([-1, 0, 0, 1], (4, 1)), abs=EXACT)


def test_unit_volume_by_closed_form_and_by_sections(design):
    """Oblique pillars lose w²·h·ow/(2s) each inside the z pillar, and nothing to each other outside it."""
    assert union_volume(design.unit) == pytest.approx(union_mm3(design.unit), rel=EXACT)
    assert unit_solid(design.unit).volume == pytest.approx(union_mm3(design.unit), rel=EXACT)


def test_unit_is_one_valid_body_that_spans_its_footprint(design):
    solid, unit = unit_solid(design.unit), design.unit
    assert solid.is_valid
    assert len(solid.solids()) == 1
    reach = (unit.span_mm + oblique_width(unit)) / 2
    assert bounds(solid) == pytest.approx(np.array([[-reach, -reach, 0], [reach, reach, unit.height_mm]]), abs=1e-6)


def test_array_is_a_unit_at_every_centre(design):
    units = array_solid(design).solids()
    assert [u.volume for u in units] == pytest.approx([unit_solid(design.unit).volume] * design.n_units, rel=EXACT)
    one = bounds(unit_solid(design.unit))
    for unit, centre in zip(units, unit_centres(design), strict=True):
        assert bounds(unit) == pytest.approx(one + np.append(centre, 0.0), abs=1e-6)


def test_units_never_touch_even_at_the_least_pitch(design):
    first, *others = array_solid(design).solids()
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


def test_step_files_hold_the_solids_exactly(small_design, tmp_path):
    solids = sensor_solids(small_design)
    write_solids(solids, tmp_path)
    for name, solid in solids.items():
        read = import_step(tmp_path / f"{name}.step")
        assert len(read.solids()) == len(solid.solids())
        assert read.volume == pytest.approx(solid.volume, rel=EXACT)
        assert bounds(read) == pytest.approx(bounds(solid), abs=1e-6)


def test_one_design_gives_the_same_bytes_twice(small_design, tmp_path):
    """Also within one process, where the CAD kernel goes on counting parts, and under another path."""
    first, second = tmp_path / "first", tmp_path / "second"
    assert len(write_solids(sensor_solids(small_design), first)) == 14
    write_solids(sensor_solids(small_design), second)
    assert contents(first) == contents(second)
    assert STEP_TIME.encode() in contents(first)["unit.step"]  # the two may be written within a second


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_nothing_is_written_if_any_surface_is_refused(tmp_path):
    unit = unit_solid(SensorDesign().unit)
    with pytest.raises(GeometryError, match="'lidless' is not watertight"):
        write_solids({"whole": unit, "lidless": unit.faces()[0]}, tmp_path)
    assert list(tmp_path.iterdir()) == []
