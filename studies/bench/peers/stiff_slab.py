"""``python -m studies.bench.peers.stiff_slab [UNITS]``: a whole slab under stiff pads by NGSolve.

Rigid plates bonded to it, solved for every motion of every plate.

A quarter of the slab, hp-refined toward the edges of pads, is solved for each parity about its middle planes. What
holds the plates in a motion is a column of a stiffness of all plates' motions; a force moves all by its inverse.
Nothing in `fem` solves that way: no cells, no ports, no extrapolation.
"""

import sys
from itertools import product
from typing import Any

import numpy as np

from fem.array.response import ArrayResponse
from fem.array.solving import solve_response
from fem.scene.loads import DeadLoad
from fem.scene.scene import Block, Probe, Scene
from geometry.design import Array, Pad, SensorDesign
from geometry.layout import ELECTRODES, FloatArray, electrode_squares, pad_squares
from studies.bench.peers.ngsolve_peer import Grading, System, reference_mesh

EDGES = ("loads", "corners")  #: that meshes are refined toward: of plates
ON_PLANE = 1e-9  #: of the height: how far rounding may put a corner off a plane


def stiff_columns(design: SensorDesign, grading: Grading, units: list[int]) -> tuple[FloatArray, int]:
    """Displacement of every electrode by 1 N along each axis on the plates of some units.

    Parameters
    ----------
    design : SensorDesign
        Of one rubber, with even numbers of rows and columns, and stiff pads in the middle of their units.
    grading : Grading
    units : list of int
        To be loaded.

    Returns
    -------
    array, shape (len(units), 3, n_units, 2, 3)
        Displacement of each electrode, for each unit and axis of the force [mm/N].
    int
        Unknowns of the quarter, without those inside elements.
    """
    scene = quarter(design)
    mesh = reference_mesh([scene], grading)
    system = System(scene, mesh, grading.order, "displacement")
    faces = _Faces(system, scene.height_mm)
    plates = [faces.within(rectangle) for rectangle in scene.load_rectangles_mm]
    middles = np.array([load.center_mm for load in scene.loads])
    given = np.vstack([faces.motions(on, middle) for on, middle in zip(plates, middles, strict=True)])
    places = electrode_squares(design).reshape(-1, 2, 2).mean(axis=1)
    centres = pad_squares(design).reshape(-1, 2, 2).mean(axis=1)
    home = _nearest(np.abs(places), middles)
    arm = np.column_stack([np.abs(places) - middles[home], np.zeros(len(places))])
    moved = np.zeros((len(units), 3, len(places), 3))
    for parity in product((1, -1), repeat=2):
        S = _stiffness(system, given, faces.held(parity) | np.any(plates, axis=0))
        forces = np.zeros((len(units), 3, len(middles), 6))
        for number, unit in enumerate(units):
            plate = _nearest(np.abs(centres[[unit]]), middles)[0]
            forces[number, :, plate, :3] = np.diag(_flips(centres[unit], parity)) / 4
        r = np.linalg.solve(S, forces.reshape(-1, len(S)).T).T.reshape(forces.shape)[:, :, home]
        u = r[..., :3] + np.cross(r[..., 3:], arm)
        moved += u * np.array([_flips(place, parity) for place in places])
    unknowns = int(sum(system.space.FreeDofs(True)))
    return moved.reshape(len(units), 3, design.n_units, len(ELECTRODES), 3), unknowns


def quarter(design: SensorDesign) -> Scene:
    """The quarter x, y > 0 of a slab as a block from the origin, its plates as the loads."""
    squares = pad_squares(design)
    x, y, z = design.slab_mm
    loads = tuple(
        DeadLoad(center_mm=((x0 + x1) / 2, (y0 + y1) / 2), size_mm=(x1 - x0, y1 - y0), traction_mpa=(0.0, 0.0, 0.0))
        for x0, y0, x1, y1 in squares[(squares > 0).all(axis=1)].tolist()
    )
    probe = Probe(name="middle", kind="point", position_mm=(0.0, 0.0, z))
    return Scene(body=Block(size_mm=(x / 2, y / 2, z)), material=design.matrix_material, loads=loads, probes=(probe,))


class _Faces:
    """Faces of the surface of a quarter and the degrees of freedom on them."""

    def __init__(self, system: System, height_mm: float) -> None:
        import ngsolve as ng

        mesh, self.space, self.height_mm = system.mesh, system.space, height_mm
        scalar = self.space.components[0]
        self.n = scalar.ndof  # of each component, one after the other, vertices first
        self.vertices = np.array([vertex.point for vertex in mesh.vertices])
        faces = list(mesh.Elements(ng.BND))
        self.corners = [self.vertices[[vertex.nr for vertex in face.vertices]] for face in faces]
        self.dofs = [np.array(scalar.GetDofNrs(face)) for face in faces]

    def within(self, rectangle: FloatArray) -> FloatArray:
        """Mask (3 n,) of what is bonded to a plate on a rectangle of the top."""
        x0, y0, x1, y1 = rectangle
        on = np.zeros(self.n, dtype=bool)
        for corners, dofs in zip(self.corners, self.dofs, strict=True):
            x, y, _ = corners.mean(axis=0)
            if x0 < x < x1 and y0 < y < y1 and self._flat(corners, 2, self.height_mm):
                on[dofs] = True
        return np.tile(on, 3)

    def held(self, parity: tuple[int, ...]) -> FloatArray:
        """Mask (3 n,) of what is 0 in fields of a parity, on the base and on the planes x = 0 and y = 0."""
        on = np.zeros((3, self.n), dtype=bool)
        for corners, dofs in zip(self.corners, self.dofs, strict=True):
            if self._flat(corners, 2, 0.0):
                on[:, dofs] = True
            for axis in (0, 1):
                if self._flat(corners, axis, 0.0):
                    on[np.ix_((np.arange(3) == axis) == (parity[axis] == 1), dofs)] = True
        return on.ravel()

    def motions(self, on: FloatArray, middle: FloatArray) -> FloatArray:
        """The six motions of a plate, (6, 3 n): linear fields have values at vertices only."""
        arm = self.vertices - (*middle, self.height_mm)
        moved = np.zeros((6, 3, self.n))
        moved[:3, :, : len(arm)] = np.eye(3)[:, :, None]
        moved[3:, :, : len(arm)] = np.cross(np.eye(3)[:, None], arm).transpose(0, 2, 1)
        return moved.reshape(6, -1) * on

    def _flat(self, corners: FloatArray, axis: int, place: float) -> bool:
        return bool(np.abs(corners[:, axis] - place).max() < ON_PLANE * self.height_mm)


def _stiffness(system: System, given: FloatArray, fixed: FloatArray) -> FloatArray:
    """Forces and moments that hold the plates in each of their motions `given` (m, ndof), shape (m, m)."""
    import ngsolve as ng

    free = ng.BitArray(system.space.FreeDofs(True))
    for dof in np.flatnonzero(fixed).tolist():
        free.Clear(dof)
    matrix = system.a.mat
    inverse = matrix.Inverse(free, inverse="sparsecholesky")
    field, rest = matrix.CreateColVector(), matrix.CreateColVector()
    held = []
    for motion in given:
        field.FV().NumPy()[:] = motion
        rest.data = matrix * field
        field.data -= inverse * rest
        rest.data = matrix * field
        held.append(given @ rest.FV().NumPy())
    S = np.array(held)
    return (S + S.T) / 2


def _flips(place: FloatArray, parity: tuple[int, ...]) -> FloatArray:
    """Signs (3,) of a field of a parity at a place (2,), from its values at the place's image in the quarter."""
    signs = np.ones(3)
    for axis in (0, 1):
        if place[axis] < 0:
            signs *= parity[axis] * np.where(np.arange(3) == axis, -1, 1)
    return signs


def _nearest(places: FloatArray, middles: FloatArray) -> Any:
    return np.linalg.norm(places[:, None] - middles, axis=-1).argmin(axis=1)


def distances_from(response: ArrayResponse, grading: Grading) -> dict[str, float]:
    """Largest distance of any unit's electrodes by a force on an inner, edge or corner plate, over that plate's."""
    rows, cols = response.design.array.rows, response.design.array.cols
    places = {"inner": rows // 2 * cols + cols // 2, "edge": cols // 2, "corner": 0}
    columns, _ = stiff_columns(response.design, grading, list(places.values()))
    found = {}
    for (place, unit), exact in zip(places.items(), columns, strict=True):
        influence = response.influence_mm_per_n[:, :, :, :, unit // cols, unit % cols]
        ours = influence.transpose(4, 0, 1, 2, 3).reshape(exact.shape)
        apart = np.sqrt(((ours - exact) ** 2).sum(axis=(0, 2, 3)))
        found[place] = float(apart.max() / np.linalg.norm(exact[:, unit]))
    return found


def main(units: int) -> None:
    """Print how far responses of so many stiff pads a side are from finer and finer runs of NGSolve."""
    design = SensorDesign(array=Array(rows=units, cols=units), pad=Pad(kind="stiff"))
    response = solve_response(design)
    print(f"estimated error {response.error_estimate:.1e}", flush=True)
    for order, levels, edge_mm in ((4, 2, 6.0), (5, 2, 6.0), (5, 2, 3.0), (6, 3, 3.0)):
        grading = Grading(order=order, levels=levels, ratio=0.15, largest_mm=10.0, edge_mm=edge_mm, edges=EDGES)
        print(grading, distances_from(response, grading), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2)
