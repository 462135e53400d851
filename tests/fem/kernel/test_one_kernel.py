"""Everything in fem that has elements takes them from the kernel, and the kernel from a scikit-fem basis."""

from collections.abc import Callable

import pytest
from skfem import CellBasis

from fem.array.solving import ResponseSettings, solve_response
from fem.conduction.potentials import unit_conductors
from fem.contact import surface_compliance
from fem.kernel.elements import Basis
from fem.kernel.rubber import Rubber
from fem.methods.plan import make_plan
from fem.methods.solving import solve_scene
from fem.pictures.parts import picture_field
from fem.scene.scene import Block
from geometry.design import Array, Material, SensorDesign, Unit
from tests.fem.scenes import pressed

UNIT = SensorDesign(array=Array(rows=1, cols=1))


def scene(model: str = "linear"):
    rubber, place = Material(model=model), ((2.0, 2.0), (2.0, 2.0))
    return pressed(Block(size_mm=(4.0, 4.0, 4.0)), *place, (0.0, 0.0, -0.1), material=rubber, tolerance=0.5)


#: by what is solved: how, and which of the kernel's objects it must make
USERS: dict[str, tuple[Callable[[], object], type]] = {
    "scenes": (lambda: solve_scene(scene()), Rubber),
    "cells": (lambda: solve_response(UNIT, ResponseSettings(tolerance=0.1)), Rubber),
    "finite strain": (lambda: solve_scene(scene("neo-hookean")), Rubber),
    "contact": (lambda: surface_compliance(UNIT), Rubber),
    "conduction": (lambda: unit_conductors.__wrapped__(Unit()), Basis),
    "pictures": (lambda: picture_field(scene(), make_plan(scene(), field=True)), Rubber),
}


@pytest.mark.parametrize(("solve", "kind"), USERS.values(), ids=USERS)
def test_all_elements_are_the_kernel_s(solve, kind, monkeypatch, tmp_path):
    """By what is made while each is solved anew."""
    made: list[object] = []
    initial = kind.__init__

    def noted(self, *given, **named) -> None:
        initial(self, *given, **named)
        made.append(self if kind is Basis else self.basis)

    monkeypatch.setenv("TRIPILLAR_CACHE", str(tmp_path))
    for name, value in (("GRID_LEVEL", 1), ("GRID_DEGREE", 2), ("STEPS_PER_ELECTRODE", 2)):
        monkeypatch.setattr(f"fem.contact.surface.{name}", value)
    monkeypatch.setattr(kind, "__init__", noted)
    solve()
    assert made
    assert all(isinstance(basis, CellBasis) and len(basis.doflocs.T) == basis.N for basis in made)
