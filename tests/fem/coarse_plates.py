"""Tops of plates on coarse cells, and conduction under them on one coarse mesh: a second each."""

from dataclasses import replace

import pytest

from fem.conduction.meshes import unit_hexahedra
from fem.conduction.potentials import Conductor
from fem.contact import SurfaceCompliance
from fem.contact import surface as surface_module
from fem.contact.conducting import conducted_by_tiles
from geometry.design import SensorDesign


def coarse_surface(design: SensorDesign, level: int, degree: int) -> SurfaceCompliance:
    """The compliance of a top of plates from cells of one level and degree; of conduction with what that adds."""
    conductor = Conductor(unit_hexahedra(design.unit, 2, 1)) if design.electrics.is_conduction else None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surface_module, "_extrapolated", lambda source: source.condensed(level, degree))
        made = replace(surface_module._solved(design, lambda step: None), design=design)
        if conductor is None:
            return made
        for name in ("fem.array.conducted.unit_conductors", "fem.conduction.potentials.unit_conductors"):
            patch.setattr(name, lambda unit, strained=False: (conductor, conductor))
        patch.setattr("fem.array.meshed.GRID_LEVEL", level)
        patch.setattr("fem.array.meshed.GRID_DEGREE", degree)
        patch.setattr("fem.contact.conducting.kept", lambda kind, key, make, *_: (make(), None, False))
        return replace(made, conducted=conducted_by_tiles(design, made.on_electrodes)[0])
