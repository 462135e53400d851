"""Fixtures of the finite-element tests."""

import pytest
from skfem import MeshTet

from tests.fem.boxes import box_mesh


@pytest.fixture(scope="session")
def disordered_cube() -> MeshTet:
    """A 10 mm cube in 384 distorted tetrahedra."""
    return box_mesh((4, 4, 4), (10.0, 10.0, 10.0), disorder=0.25)
