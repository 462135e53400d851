"""A MuJoCo model to begin with: a gripper whose finger comes down on a sensor. Loads mujoco."""

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.design import Array, Material, Pad, SensorDesign, Unit
from geometry.errors import ArgumentError, TriPillarError, needing

with needing("the simulator", "simulators"):
    import mujoco

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

#: a sensor for fingers: 24 × 24 × 4 mm of soft silicone, 10 N on a pad shorten its pillars by a fifth
FINGERTIP = SensorDesign(
    resistivity_ohm_mm=1600.0,
    unit=Unit(span_mm=4.0, height_mm=4.0, pillar_width_mm=0.8, electrode_mm=0.8),
    array=Array(rows=4, cols=4, pitch_mm=6.0),
    pad=Pad(size_mm=5.0),
    pillar_material=Material(young_mpa=0.5),
    matrix_material=Material(young_mpa=0.5),
)
TIP_MM = (5.0, 4.0)  #: radius and half the length of the fingertip, a capsule along y
CLEARANCE_MM = 4.0  #: between slab and fingertip at rest
FINGER_KG = 0.2
FRICTION = 0.6  #: of the slab, Coulomb's
MIN_IMPEDANCE = 0.5  #: MuJoCo's d of a contact: smaller is nearer to a spring, but chatters sooner
MAX_DAMPED = 0.6  #: largest b/d times the time step; contacts chatter from 1 on
STEP_S = 0.001


class DrawingError(TriPillarError, RuntimeError):
    """MuJoCo finds no way to draw on this machine."""


_MODEL = """
<mujoco model="press">
  <option timestep="{step_s}" integrator="implicitfast" cone="elliptic" impratio="50"/>
  <visual>
    <headlight ambient="0.35 0.35 0.35" diffuse="0.45 0.45 0.45" specular="0 0 0"/>
    <global offwidth="1280" offheight="960" azimuth="125" elevation="-22"/>
    <map znear="0.05" zfar="20" force="1"/>
    <scale forcewidth="0.05"/>
  </visual>
  <statistic center="0 0 {middle}" extent="{extent}"/>
  <asset>
    <texture type="skybox" builtin="gradient" rgb1="1 1 1" rgb2="0.86 0.89 0.93" width="64" height="256"/>
    <material name="slab" rgba="0.66 0.77 0.85 1" specular="0.2"/>
    <material name="metal" rgba="0.33 0.36 0.4 0.55" specular="0.6" shininess="0.6"/>
    <material name="rubber" rgba="0.95 0.6 0.3 0.5"/>
    <material name="table" rgba="0.93 0.93 0.91 1" specular="0"/>
  </asset>
  <worldbody>
    <light pos="0.05 -0.1 0.3" dir="-0.2 0.3 -1" diffuse="0.5 0.5 0.5"/>
    <geom name="table" type="box" size="{table} {table} 0.003" pos="0 0 -0.003" material="table" contype="0"
      conaffinity="0"/>
    <body name="sensor">
      <geom name="slab" type="box" size="{half_x} {half_y} {half_z}" pos="0 0 {half_z}" material="slab" priority="1"
        friction="{friction} 0 0" condim="3"/>
      <site name="sensor" size="0.0005" rgba="0 0 0 0"/>
    </body>
    <body name="finger" pos="0 0 {tip_z}" gravcomp="1">
      <joint name="x" type="slide" axis="1 0 0" damping="1"/>
      <joint name="y" type="slide" axis="0 1 0" damping="1"/>
      <joint name="z" type="slide" axis="0 0 1" damping="1"/>
      <inertial pos="0 0 0" mass="{kg}" diaginertia="1e-4 1e-4 1e-4"/>
      <geom name="tip" type="capsule" size="{radius} {half_length}" zaxis="0 1 0" material="rubber"/>
      <geom type="box" size="{radius} {half_length} 0.012" pos="0 0 0.012" material="metal" contype="0"
        conaffinity="0"/>
      <geom type="box" size="0.022 {half_length} 0.004" pos="0.014 0 0.028" material="metal" contype="0"
        conaffinity="0"/>
      <geom type="box" size="{radius} {half_length} 0.006" pos="0.031 0 0.019" material="metal" contype="0"
        conaffinity="0"/>
      <geom type="cylinder" size="0.008 0.01" pos="0.014 0 0.042" material="metal" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <position name="x" joint="x" kp="4000" kv="50"/>
    <position name="y" joint="y" kp="4000" kv="50"/>
    <position name="z" joint="z" kp="4000" kv="50"/>
  </actuator>
</mujoco>
"""


def finger_on_slab(design: SensorDesign, stiffness_n_per_mm: float, friction: float = FRICTION) -> Any:
    """A slab of a design on a table, and a finger above it that position actuators move along x, y and z.

    Parameters
    ----------
    design : SensorDesign
    stiffness_n_per_mm : float
        Of the contact between finger and slab, such as `pad_stiffness`.
    friction : float
        Coulomb's coefficient.

    Returns
    -------
    mujoco.MjModel
        In metres. Site ``sensor`` is the sensor's frame, geom ``slab`` the slab, body ``finger`` what touches it; the
        actuators x, y and z take the finger's place [m] from where it begins, 4 mm above the slab.
    """
    x, y, z = np.array(design.slab_mm) / 1000.0
    radius, half_length = np.array(TIP_MM) / 1000.0
    filled = _MODEL.format(
        step_s=STEP_S, middle=z + 0.006, extent=1.9 * max(x, y), table=1.2 * max(x, y), half_x=x / 2, half_y=y / 2,
        half_z=z / 2, friction=friction, tip_z=z + CLEARANCE_MM / 1000.0 + radius, kg=FINGER_KG, radius=radius,
        half_length=half_length,
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_string(filled)
    soften(model, "slab", "finger", stiffness_n_per_mm)
    return model


def pad_stiffness(response: "ArrayResponse") -> float:
    """Force on a pad alone over the mean depth that its electrodes sink to, mean of all pads [N/mm]."""
    n = response.design.n_units
    sunk = -response.influence_mm_per_n.reshape(n, 2, 3, n, 3)[:, :, 2, :, 2].mean(axis=1)  # along z, of −z forces
    return float(1.0 / -sunk.diagonal().mean())


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
    g = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, geom)
    inverse_kg = model.body_invweight0[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body), 0]
    rate2 = 1000.0 * stiffness_n_per_mm * inverse_kg  # k = rate² (1 − d)
    a = rate2 * (2.0 * model.opt.timestep / MAX_DAMPED) ** 2  # a (1 − d) = d² where b/d is the fastest
    d = max(MIN_IMPEDANCE, 0.5 * (np.sqrt(a * a + 4.0 * a) - a))
    k = rate2 * (1.0 - d)
    model.geom_solimp[g] = (d, d, 0.001, 0.5, 2.0)
    model.geom_solref[g] = -k, -2.0 * np.sqrt(k)


def renderer(model: Any, wide: int, high: int) -> Any:
    """A `mujoco.Renderer`.

    Raises
    ------
    DrawingError
        If this machine cannot draw as MuJoCo asks it to.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of GLFW, about the display that it lacks
            from mujoco import gl_context

            if gl_context.GLContext.__module__ == "mujoco.glfw":
                import glfw

                if not glfw.init():  # going on without would end the process
                    raise RuntimeError("no display")
            return mujoco.Renderer(model, high, wide)
    except Exception as error:  # each library of OpenGL has errors of its own
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise DrawingError(
            f"MuJoCo cannot draw here ({reason}): without a display set MUJOCO_GL=egl, or osmesa, "
            "before Python starts, and install that library."
        ) from None
