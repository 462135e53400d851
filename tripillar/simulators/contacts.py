"""Contacts of MuJoCo with a sensor's slab: forces in the sensor's frame, mm and N; stiffness. Loads mujoco."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from trimesh import creation

from common.errors import ArgumentError, needing
from fem.contact import Capsule, Convex, Shape
from geometry.layout import FloatArray

with needing("the simulator", "simulators"):
    import mujoco

MIN_IMPEDANCE = 0.5  #: MuJoCo's d of a contact: smaller is nearer to a spring, but chatters sooner
MAX_DAMPED = 0.6  #: largest b/d times the time step; contacts chatter from 1 on
ROUND = 48  #: faces of a round body
MIN_COSINE = np.sqrt(0.5)  #: of the angle between a contact's normal and z; flatter ones are at the slab's sides


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceContacts:
    """Contacts on a sensor's top at one moment."""

    points_mm: FloatArray  #: (k, 3): places in the sensor's frame
    force_n: FloatArray  #: (k, 3): on the sensor along x and y, and Fz positive in compression
    geoms: NDArray[np.int64]  #: (k,): of the model, that touch the slab there
    left_out: int  #: contacts at the slab's sides and underside, which the array does not feel

    @property
    def net_n(self) -> FloatArray:
        """Sum of the forces, (3,) [N]."""
        return self.force_n.sum(axis=0)

    @property
    def centre_mm(self) -> FloatArray:
        """Centre of pressure, (2,): x and y [mm]; NaN where nothing presses."""
        with np.errstate(invalid="ignore"):
            return self.force_n[:, 2] @ self.points_mm[:, :2] / self.force_n[:, 2].sum()


class Body(NamedTuple):
    """A shape that touches a sensor, as `VirtualSensor.press` takes it."""

    shape: Shape  #: as it stands
    place_mm: FloatArray  #: (3,): of its origin, from the array's middle and above the slab's top
    normal_n: float  #: what presses


class ContactReader:
    """Contacts of a MuJoCo simulation on one sensor.

    Parameters
    ----------
    model : mujoco.MjModel
    site : str
        The sensor's frame: a site in the middle of the array, x along its columns, y along its rows, z out of its top.
    geom, body : str
        The slab, one of the two: a geom, or all geoms of a body.
    mm_per_length : float
        Millimetres in the model's unit of length, 1000 for metres; forces are taken as newtons.

    Raises
    ------
    ArgumentError
        If the model has no such site, geom or body, or both or none of the latter are given.

    Notes
    -----
    `mujoco.mj_contactForce` gives the force of geom1 on geom2, along the contact's normal and two tangents, whichever
    cone the model has. Torques at contacts (condim 4 and 6) have no pads to go to and are left out. A contact counts
    as being on the top if its normal is within 45° of the site's z.
    """

    def __init__(
        self, model: Any, *, site: str, geom: str | None = None, body: str | None = None, mm_per_length: float = 1000.0
    ) -> None:
        if (geom is None) == (body is None):
            raise ArgumentError("give the slab as geom or as body, one of the two.")
        if not mm_per_length > 0:
            raise ArgumentError(f"mm_per_length={mm_per_length!r} must be above 0; 1000 for a model in metres.")
        self.model, self.mm_per_length = model, float(mm_per_length)
        self._shape = cache(lambda geom: _shape(model, geom, self.mm_per_length))
        self._site = _number(model, "site", site)
        if geom is not None:
            self._is_slab = np.arange(model.ngeom) == _number(model, "geom", geom)
        else:
            self._is_slab = model.geom_bodyid == _number(model, "body", body)

    def bodies(self, data: Any) -> dict[int, Body]:
        """The geoms that touch the top, by their number: spheres, capsules, ellipsoids, cylinders, boxes, meshes.

        A mesh is its convex hull, as it is for MuJoCo; round bodies other than balls and capsules have flat faces.

        Raises
        ------
        ArgumentError
            If a geom is of another kind.
        """
        found = self.read(data)
        axes = data.site_xmat[self._site].reshape(3, 3)
        slab = np.flatnonzero(self._is_slab)
        turned, (middle, half) = (
            axes.T @ data.geom_xmat[slab].reshape(-1, 3, 3),
            np.split(self.model.geom_aabb[slab], 2, 1),
        )
        above = (data.geom_xpos[slab] - data.site_xpos[self._site]) @ axes
        top = (above + np.einsum("gab,gb->ga", turned, middle) + np.einsum("gab,gb->ga", np.abs(turned), half))[
            :, 2
        ].max()
        bodies = {}
        for geom in np.unique(found.geoms).tolist():
            place = (data.geom_xpos[geom] - data.site_xpos[self._site]) @ axes - (0.0, 0.0, top)
            bodies[geom] = Body(
                replace(self._shape(geom), turn=axes.T @ data.geom_xmat[geom].reshape(3, 3)),
                place * self.mm_per_length,
                float(found.force_n[found.geoms == geom, 2].sum()),
            )
        return bodies

    def read(self, data: Any) -> SurfaceContacts:
        """Contacts of a `mujoco.MjData`; after ``mj_step`` those of the state that the step began with."""
        geoms = data.contact.geom
        is_slab = self._is_slab[geoms] & (geoms >= 0)  # −1: a deformable body, which is no slab
        touching = np.flatnonzero(is_slab[:, 0] != is_slab[:, 1])
        axes = data.site_xmat[self._site].reshape(3, 3)  # columns: the sensor's axes in the world
        force, torque_too = np.zeros((len(touching), 3)), np.zeros(6)
        for k, number in enumerate(touching):
            mujoco.mj_contactForce(self.model, data, number, torque_too)
            force[k] = torque_too[:3] @ data.contact.frame[number].reshape(3, 3) @ axes
        onto = np.where(is_slab[touching, 1], 1.0, -1.0)[:, None]  # geom1 pushes geom2 along the normal
        normal_z = (onto * data.contact.frame[touching, :3]) @ axes[:, 2]
        on_top = normal_z <= -MIN_COSINE
        points = (data.contact.pos[touching] - data.site_xpos[self._site]) @ axes * self.mm_per_length
        force_n = onto * force * (1.0, 1.0, -1.0)
        others = np.where(is_slab[touching, 0], geoms[touching, 1], geoms[touching, 0])
        return SurfaceContacts(
            points_mm=points[on_top],
            force_n=force_n[on_top],
            geoms=others[on_top],
            left_out=int(len(on_top) - on_top.sum()),
        )


def stacked(contacts: Sequence[SurfaceContacts]) -> tuple[FloatArray, FloatArray]:
    """Contacts of e environments as `VirtualSensor.touch` takes them: points [mm] and forces [N], both (e, k, 3).

    Environments with fewer than k contacts, and at least one each, have points in the middle without force.
    """
    most = max([1, *(len(one.points_mm) for one in contacts)])
    points, forces = np.zeros((len(contacts), most, 3)), np.zeros((len(contacts), most, 3))
    for k, one in enumerate(contacts):
        points[k, : len(one.points_mm)] = one.points_mm
        forces[k, : len(one.force_n)] = one.force_n
    return points, forces


def soften(model: Any, geom: str, body: str, stiffness_n_per_mm: float) -> None:
    """Make each contact of a geom with a body a spring of this stiffness with critical damping.

    The model is in metres and has elliptic cones; the geom's priority is above the body's geoms', so that MuJoCo takes
    its parameters.

    Raises
    ------
    ArgumentError
        If the cones are pyramidal: their stiffness depends on friction.

    Notes
    -----
    MuJoCo's contact force f obeys R f = (b v + k r)/d − a: penetration r, its rate v, the bodies' acceleration a apart,
    ``solref`` = (−k, −b), impedance d and R = Â (1 − d)/d, Â the body's inverse mass as the model states it
    (`body_invweight0`); MuJoCo's documentation, chapter Computation. At rest f = k r/(Â (1 − d)), so
    k = stiffness · Â (1 − d) makes the spring. It has an apparent mass 1/R, with d = 1/2 the body's own, and
    b = 2 √k damps both critically. d is 1/2, or where b/d is too fast for the model's time step so much that it is not.
    """
    if model.opt.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        raise ArgumentError('soft contacts need elliptic cones: write <option cone="elliptic"/> in the model.')
    g, inverse_kg = _number(model, "geom", geom), model.body_invweight0[_number(model, "body", body), 0]
    rate2 = 1000.0 * stiffness_n_per_mm * inverse_kg  # k = rate² (1 − d)
    a = rate2 * (2.0 * model.opt.timestep / MAX_DAMPED) ** 2  # a (1 − d) = d² where b/d is the fastest
    d = max(MIN_IMPEDANCE, 0.5 * (np.sqrt(a * a + 4.0 * a) - a))
    k = rate2 * (1.0 - d)
    model.geom_solimp[g] = (d, d, 0.001, 0.5, 2.0)
    model.geom_solref[g] = -k, -2.0 * np.sqrt(k)


def _shape(model: Any, geom: int, mm_per_length: float) -> Capsule | Convex:
    """The body of a geom about its origin."""
    kind, kinds = model.geom_type[geom], mujoco.mjtGeom
    x, y, _ = size = model.geom_size[geom] * mm_per_length
    if kind == kinds.mjGEOM_SPHERE:
        return Capsule(x)
    if kind == kinds.mjGEOM_CAPSULE:
        return Capsule(x, 2.0 * y)
    if kind == kinds.mjGEOM_BOX:
        return Convex.hull(creation.box(2.0 * size).vertices)
    if kind == kinds.mjGEOM_CYLINDER:
        return Convex.hull(creation.cylinder(x, 2.0 * y, sections=ROUND).vertices)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return Convex.hull(creation.icosphere().vertices * size)
    if kind == kinds.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        return Convex.hull(model.mesh_vert[first : first + model.mesh_vertnum[mesh]] * mm_per_length)
    raise ArgumentError(
        f"geom {geom} is a {kinds(kind).name[7:].lower()}: sphere, capsule, ellipsoid, cylinder, box or mesh can press."
    )


def _number(model: Any, kind: str, name: str | None) -> int:
    """Number of the site, geom or body of a name."""
    try:
        return int(getattr(model, kind)(name).id)
    except KeyError as error:  # MuJoCo's own, which lists what there is
        raise ArgumentError(f"the model has no {kind} '{name}'. {error.args[0]}") from None
