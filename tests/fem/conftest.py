"""Fixtures of the finite-element tests."""

import os
from collections.abc import Callable
from dataclasses import replace

import pytest
from skfem import MeshTet

from fem.array.coupled_cells import CoupledArray
from fem.contact import SurfaceCompliance, surface_compliance
from fem.pictures.arrays import ArrayField
from geometry.design import Array, SensorDesign
from tests.fem.scenes import box_mesh


@pytest.fixture(scope="session")
def disordered_cube() -> MeshTet:
    """A 10 mm cube in 384 distorted tetrahedra."""
    return box_mesh((4, 4, 4), (10.0, 10.0, 10.0), disorder=0.25)


@pytest.fixture(scope="session")
def pair() -> SurfaceCompliance:
    """The top of the paper's unit twice, 1 × 2, from the cache of all tests: others press it, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", f"{os.environ['TRIPILLAR_TESTS']}/cache")
        return surface_compliance(SensorDesign(array=Array(rows=1, cols=2)))[0]


@pytest.fixture(scope="session")
def field_of(pair_field: ArrayField) -> Callable[[int, int], ArrayField]:
    """Arrays of the paper's unit of other sizes, coupled from the cell of `pair_field`."""

    def field_of(rows: int, cols: int) -> ArrayField:
        design = SensorDesign(array=Array(rows=rows, cols=cols))
        return replace(pair_field, design=design, coupled=CoupledArray(pair_field.interior.cell, rows, cols))

    return field_of
