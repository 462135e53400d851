"""A MuJoCo model to begin with, for `mujoco_press.py` and `press_env.py`: a gripper's finger comes down on a sensor."""

import warnings

import mujoco
import numpy as np

from fem.array.response import ArrayResponse
from geometry.design import Array, Material, Pad, SensorDesign, Unit
from tripillar.simulators.contacts import soften

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
STEP_S = 0.001


class DrawingError(RuntimeError):
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


def finger_on_slab(design: SensorDesign, stiffness_n_per_mm: float, friction: float = FRICTION) -> mujoco.MjModel:
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


def pad_stiffness(response: ArrayResponse) -> float:
    """Force on a pad alone over the mean depth that its electrodes sink to, mean of all pads [N/mm]."""
    n = response.design.n_units
    sunk = -response.influence_mm_per_n.reshape(n, 2, 3, n, 3)[:, :, 2, :, 2].mean(axis=1)  # along z, of −z forces
    return float(1.0 / -sunk.diagonal().mean())


def renderer(model: mujoco.MjModel, wide: int, high: int) -> mujoco.Renderer:
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
