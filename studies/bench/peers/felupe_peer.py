"""FElupe on the same mesh, elements and loads: finite strain solved a second time by other code.

FElupe is under the GPL and no dependency of the project: the extra `bench` or `pip install felupe` brings it.
"""

from importlib.util import find_spec
from typing import Any

import numpy as np

from fem.equations import State
from fem.rubber.body import RubberBody
from fem.scene.loads import DeadLoad, FollowerLoad, Load, StiffLoad
from fem.system import System
from geometry.layout import FloatArray

STEPS = 8  #: of the load; FElupe's Newton has the pressure as a field of its own, but no step control


def missing() -> str:
    """The wheel, where it is not installed."""
    return "" if find_spec("felupe") else "felupe is not installed (pip install 'tripillar[bench]')"


def felupe_displacements(body: RubberBody, loads: list[Load], state: State, steps: int = STEPS) -> FloatArray:
    """Displacements (n_nodes, 3) of a body of one rubber under the same loads [mm].

    Plates are not in FElupe: their nodes are moved as `state` says, and all others are solved for. The law is FElupe's
    nearly incompressible form, U(J) = λ/2 (J − 1)², around its compressible neo-Hookean one without λ; pressure and
    volume are linear in each element, so that their elimination gives the form of `RubberBody`.
    """
    import felupe as fe
    from felupe.element._base import Element

    class Linear(Element):
        """1, r, s, t on every hexahedron."""

        def __init__(self) -> None:
            super().__init__()
            self.shape = (4, 3)
            self.points = np.zeros((4, 3))
            self.cells = np.arange(4).reshape(1, -1)
            self.cell_type = "VTK_EMPTY_CELL"

        def function(self, r: FloatArray) -> FloatArray:
            return np.array([1.0, *r])

        def gradient(self, r: FloatArray) -> FloatArray:
            return np.vstack([np.zeros((1, 3)), np.eye(3)])

    points, n = body.boxes.points_mm, body.n_elements
    order = np.rint(fe.TriQuadraticHexahedron().points + 1).astype(int) @ np.array([9, 3, 1])
    mesh = fe.Mesh(points, body.nodes[:, order], "hexahedron27")
    region = fe.RegionTriQuadraticHexahedron(mesh)
    corners = fe.Mesh(np.zeros((4 * n, 3)), np.arange(4 * n).reshape(n, 4), "VTK_EMPTY_CELL")
    linear = fe.Region(corners, Linear(), region.quadrature, grad=False)
    volume = np.zeros((4 * n, 1))
    volume[::4] = 1.0
    u = fe.Field(region, dim=3)
    field = fe.FieldContainer([u, fe.Field(linear, dim=1), fe.Field(linear, dim=1, values=volume)])
    law = fe.NearlyIncompressible(fe.NeoHookeCompressible(mu=body.law.mu_mpa[0, 0]), bulk=body.law.lame_mpa[0, 0])
    solid = fe.SolidBody(law, field)
    system = System(body, loads)
    held: dict[str, Any] = {"base": fe.Boundary(u, fz=0.0)}
    mask = np.zeros(len(points), dtype=bool)
    mask[system.plates.node] = True
    if mask.any():
        held["plates"] = fe.Boundary(u, mask=mask)
    dof0, dof1 = fe.dof.partition(field, held)
    pressures = [
        (load.pressure_mpa, fe.SolidBodyPressure(_top_field(fe, body, mesh, load)))
        for load in loads
        if isinstance(load, FollowerLoad)
    ]
    moved = np.zeros_like(points)
    moved[mask] = state.u[mask]
    prescribed = np.concatenate([moved.ravel(), np.zeros(8 * n)])[dof0]
    for share in np.arange(1, steps + 1) / steps:
        items = [solid]
        if any(isinstance(load, DeadLoad | FollowerLoad) for load in loads):
            items.append(fe.PointLoad(field, np.arange(len(points)), values=share * system.dead))
        for pressure, item in pressures:
            item.update(share * pressure)
            items.append(item)
        fe.newtonraphson(
            items=items, dof0=dof0, dof1=dof1, ext0=share * prescribed, x0=field, tol=1e-11, maxiter=40, verbose=0
        )
    assert not any(isinstance(load, StiffLoad) for load in loads) or mask.any()
    return np.asarray(field[0].values)


def _top_field(fe: Any, body: RubberBody, mesh: Any, load: FollowerLoad) -> Any:
    x0, y0, x1, y1 = load.rectangle
    x, y, z = mesh.points.T
    inside = (x > x0 - 1e-9) & (x < x1 + 1e-9) & (y > y0 - 1e-9) & (y < y1 + 1e-9)
    mask = inside & (z == body.boxes.height_mm)
    region = fe.RegionTriQuadraticHexahedronBoundary(mesh, only_surface=True, mask=mask)
    return fe.FieldContainer([fe.Field(region, dim=3)])
