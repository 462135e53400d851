"""Tops of plates on coarse cells, and conduction under them on one coarse mesh: a second each."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from fem.conduction.meshes import unit_hexahedra
from fem.conduction.potentials import AT_REST, Conductor, UnitConductors
from fem.contact import SurfaceCompliance
from fem.contact import surface as surface_module
from fem.contact.surface import conducted_by_tiles
from geometry.design import SensorDesign
from geometry.layout import FloatArray, upper_electrodes
from tests.fem.scenes import coarse_cells


def conduct_by(patch: pytest.MonkeyPatch, conductor: Conductor | None) -> None:
    """Let one mesh of a unit serve as all of its meshes of conduction."""
    for name in ("fem.array.conducted.unit_conductors", "fem.conduction.potentials.unit_conductors"):
        patch.setattr(name, lambda unit, strained=False: UnitConductors(conductor, conductor, AT_REST))


@contextmanager
def coarse(design: SensorDesign, level: int, degree: int) -> Iterator[None]:
    """Cells of one level and degree, and of conduction one coarse mesh; nothing of conduction is kept."""
    conductor = Conductor(unit_hexahedra(design.unit, 2, 1)) if design.electrics.is_conduction else None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surface_module, "_extrapolated", lambda source: source.condensed(level, degree))
        coarse_cells(patch, level, degree)
        conduct_by(patch, conductor)
        patch.setattr(surface_module, "kept_value", lambda hint, kind, key, make: (make(), None, False))
        yield


def coarse_surface(design: SensorDesign, level: int, degree: int) -> SurfaceCompliance:
    """The compliance of a top of plates; of conduction with what that adds."""
    with coarse(design, level, degree):
        made = replace(surface_module._solved(design, lambda step: None), design=design)
        if not design.electrics.is_conduction:
            return made
        return replace(made, conducted=conducted_by_tiles(design, made.on_electrodes)[0])


def rigid_plates(design: SensorDesign) -> FloatArray:
    """Electrodes that move with plates on springs, 10 µm/N and 1e-4 rad/(N mm), by a hundredth with others."""
    x, y, _ = upper_electrodes(design.unit).T
    own = np.zeros((6, len(x), 3))
    own[0, :, 0] = own[1, :, 1] = 1e-2
    own[2:5, :, 2] = np.stack([0 * x - 1e-2, -1e-4 * x, -1e-4 * y])
    own[5, :, 0], own[5, :, 1] = -1e-4 * y, 1e-4 * x
    return np.einsum("uv,lea->ulvea", 0.01 + np.eye(design.n_units), own).reshape(design.n_units, 6, -1)
