"""Contacts of MuJoCo on a slab are what statics says, in the sensor's own frame."""

import runpy
import sys

import numpy as np
import pytest

from geometry.errors import ArgumentError, MissingPackageError

mujoco = pytest.importorskip("mujoco")

from tripillar.simulators.contacts import ContactReader, soften, stacked  # noqa: E402 (needs mujoco)

GRAVITY, KG = 9.81, 1.3
PULL = np.array([2.0, -1.0, -GRAVITY])  #: gravity in the slab's frame: also along +x and −y
SOLVED = 1e-6  #: relative: MuJoCo's tolerance of 1e-8, and what is left of the box's settling


def settled(slab_first=True, cone="elliptic"):
    """A box at rest on a tilted slab of 40 × 40 × 10 mm; all is stated in the slab's frame."""
    slab = """<geom name="top" type="box" size=".02 .02 .005" pos="0 0 .005"/><site name="frame"/>"""
    slab = f'<body name="slab" pos=".3 -.2 .7" quat=".8 .3 -.4 .2">{slab}</body>'
    weight = f"""<frame pos=".3 -.2 .7" quat=".8 .3 -.4 .2"><body name="box" pos=".003 -.007 .015"><freejoint/>
      <geom name="box" type="box" size=".006 .004 .005" mass="{KG}"/></body></frame>"""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option cone="{cone}" timestep=".002" impratio="10"/><default><geom friction="1 0 0"/></default>
        <worldbody>{slab + weight if slab_first else weight + slab}</worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    model.opt.gravity = data.site("frame").xmat.reshape(3, 3) @ PULL
    mujoco.mj_step(model, data, nstep=600)
    return model, data


@pytest.mark.parametrize(("slab_first", "cone"), [(True, "elliptic"), (False, "elliptic"), (True, "pyramidal")])
def test_a_box_at_rest_weighs_what_it_weighs_and_turns_nothing(slab_first, cone):
    """ΣF = m g in the slab's frame, whichever geom MuJoCo takes first; the moment about the box's middle is 0."""
    model, data = settled(slab_first, cone)
    contacts = ContactReader(model, site="frame", geom="top").read(data)
    assert contacts.net_n == pytest.approx(KG * PULL * (1, 1, -1), abs=SOLVED * KG * GRAVITY)
    assert contacts.points_mm[:, 2] == pytest.approx(np.full(4, 10.0), abs=0.2)  # MuJoCo: midway into the overlap
    assert np.ptp(contacts.points_mm, axis=0)[:2] == pytest.approx([12.0, 8.0], abs=1e-2)
    frame = data.site("frame")
    box_mm = 1000.0 * (data.body("box").xpos - frame.xpos) @ frame.xmat.reshape(3, 3)
    moment_nmm = np.cross(contacts.points_mm - box_mm, contacts.force_n * (1, 1, -1)).sum(axis=0)
    assert moment_nmm == pytest.approx(np.zeros(3), abs=1e-3 * KG * GRAVITY)  # 1 µm: what a step creeps, and more


def test_a_body_in_centimetres_and_other_contacts():
    """All geoms of a body count, in the unit that is stated; what touches the sides or comes from below does not."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option gravity="0 0 0"/><worldbody>
        <body name="slab"><site name="frame"/><geom type="box" size="2 2 .5" pos="-2 0 .5"/>
          <geom type="box" size="2 2 .5" pos="2 0 .5"/></body>
        <body pos="2 1 1.49"><freejoint/><geom type="sphere" size=".5"/></body>
        <body pos="-3 -1 -.49"><freejoint/><geom type="sphere" size=".5"/></body>
        <body pos="4.49 0 .5"><freejoint/><geom type="sphere" size=".5"/></body>
        </worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    contacts = ContactReader(model, site="frame", body="slab", mm_per_length=10.0).read(data)
    assert contacts.points_mm[:, :2] == pytest.approx(np.array([[20.0, 10.0]]))
    assert contacts.centre_mm == pytest.approx([20.0, 10.0])
    assert contacts.force_n[0, 2] > 0
    assert contacts.left_out == 2


def test_bodies_are_the_geoms_that_press_as_they_stand():
    """A ball, a lying capsule, a tilted box and a mesh on a slab that is itself turned; a plane cannot press."""
    geoms = {
        "ball": 'type="sphere" size=".005" pos="-.03 0 .0149"',
        "bar": 'type="capsule" size=".003 .004" zaxis="0 1 0" pos="-.01 0 .0129"',
        "box": 'type="box" size=".004 .003 .002" euler="0 10 0" pos=".01 0 .0125"',
        "rod": 'type="cylinder" size=".003 .004" zaxis="1 0 0" pos=".02 .01 .0129"',
        "egg": 'type="ellipsoid" size=".003 .004 .005" pos=".02 -.01 .0149"',
        "mesh": 'type="mesh" mesh="wedge" pos=".03 0 .0129"',
    }
    bodies = "".join(
        f'<body name="{name}" pos="0 0 0"><freejoint/><geom name="{name}" {each}/></body>'
        for name, each in geoms.items()
    )
    turned = bodies.replace("<body name", '<frame euler="0 30 0"><body name').replace("</body>", "</body></frame>")
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 0"/><asset>
        <mesh name="wedge" vertex="-.004 -.004 .003  .004 -.004 .003  .004 .004 .003  -.004 .004 .003  0 0 -.003"/>
        </asset>
        <worldbody><frame euler="0 30 0"><geom name="top" type="box" size=".05 .05 .005" pos="0 0 .005"/>
        <site name="frame"/></frame>{turned}</worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = ContactReader(model, site="frame", geom="top").bodies(data)
    named = {model.geom(number).name: body for number, body in found.items()}
    assert set(named) == set(geoms)
    x, y = np.meshgrid(np.linspace(-4, 4, 81), np.linspace(-4, 4, 81))
    for name, body in named.items():
        depth_mm = -body.place_mm[2] - body.shape.lowest_mm
        assert 0.05 < depth_mm < 0.5, name
        assert body.normal_n > 0, name
        assert np.nanmin(body.shape.heights_mm(x, y)) == pytest.approx(0.0, abs=0.05), name
    assert named["ball"].place_mm == pytest.approx([-30.0, 0.0, 4.9], abs=1e-6)
    assert abs(named["bar"].shape.turn[1, 2]) == pytest.approx(1.0)
    assert named["ball"].shape.heights_mm(3.0, 4.0 - 1e-9) == pytest.approx(5.0, abs=1e-3)
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom type="plane" size="1 1 1" zaxis="0 0 -1" pos="0 0 .0099"/><body><freejoint/>
        <geom name="top" type="box" size=".05 .05 .005" pos="0 0 .005"/><site name="frame"/></body></worldbody>
        </mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with pytest.raises(ArgumentError, match="geom 0 is a plane: sphere, capsule"):
        ContactReader(model, site="frame", geom="top").bodies(data)


def test_environments_are_stacked_with_points_that_do_not_press():
    model, data = settled()
    reader = ContactReader(model, site="frame", geom="top")
    here, nothing = reader.read(data), reader.read(mujoco.MjData(model))
    points, forces = stacked([nothing, here])
    assert points.shape == forces.shape == (2, 4, 3)
    assert not forces[0].any()
    assert (points[1] == here.points_mm).all()
    assert (forces[1] == here.force_n).all()
    assert np.isnan(nothing.centre_mm).all()
    assert stacked([nothing])[0].shape == (1, 1, 3)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"site": "tool", "geom": "top"}, r"no site 'tool'.*frame"),
        ({"site": "frame", "geom": "floor"}, r"no geom 'floor'.*box.*top"),
        ({"site": "frame"}, "one of the two"),
        ({"site": "frame", "body": "slab", "mm_per_length": 0.0}, "above 0"),
    ],
)
def test_what_the_model_lacks_is_refused(given, said):
    with pytest.raises(ArgumentError, match=said):
        ContactReader(settled()[0], **given)


@pytest.mark.parametrize("stiffness", [8.0, 240.0])
def test_a_softened_contact_is_a_spring(stiffness, press_env):
    """At rest each of the finger's two contacts is one of this stiffness, however stiff: F = K · depth."""
    world = press_env.finger_on_slab(press_env.FINGERTIP, stiffness)
    data = mujoco.MjData(world)
    data.ctrl[2] = -0.006
    mujoco.mj_step(world, data, nstep=2000)
    pressed = ContactReader(world, site="sensor", geom="slab").read(data)
    assert len(data.contact.dist) == 2
    assert pressed.net_n[2] == pytest.approx(2 * stiffness * -1000 * data.contact.dist[0], rel=1e-3)
    assert data.qvel == pytest.approx(np.zeros(3), abs=1e-6)  # nothing chatters
    world.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    with pytest.raises(ArgumentError, match="elliptic"):
        soften(world, "slab", "finger", stiffness)


def test_a_missing_simulator_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingPackageError, match=r"mujoco.*pip install 'tripillar\[simulators\]'"):
        runpy.run_path(sys.modules[ContactReader.__module__].__file__)
