"""Contacts of MuJoCo on a slab are what statics says, in the sensor's own frame."""

import numpy as np
import pytest

from common.errors import ArgumentError

mujoco = pytest.importorskip("mujoco")

from tripillar.simulators.contacts import ContactReader, stacked  # noqa: E402 (needs mujoco)

GRAVITY, KG = 9.81, 1.3
PULL = np.array([2.0, -1.0, -GRAVITY])  #: gravity in the slab's frame: also along +x and −y
SOLVED = 1e-6  #: relative: MuJoCo's tolerance of 1e-8, and what is left of the box's settling
SLAB = '<geom name="top" type="box" size=".05 .05 .005" pos="0 0 .005"/><site name="frame"/>'


def forward(xml):
    """A model and its data as it stands."""
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{xml}</mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize(("slab_first", "cone"), [(True, "elliptic"), (False, "pyramidal")])
def test_a_box_at_rest_weighs_what_it_weighs_and_turns_nothing(slab_first, cone):
    """ΣF = m g in the tilted slab's frame, whichever geom is first; the moment about the box's middle is 0."""
    frame = '<frame pos=".3 -.2 .7" quat=".8 .3 -.4 .2">{}</frame>'
    slab = frame.format(f'<body name="slab">{SLAB}</body>')
    weight = frame.format(f"""<body name="box" pos=".003 -.007 .015"><freejoint/>
      <geom name="box" type="box" size=".006 .004 .005" mass="{KG}"/></body>""")
    model, data = forward(
        f"""<option cone="{cone}" timestep=".002" impratio="10"/><default><geom friction="1 0 0"/></default>
        <worldbody>{slab + weight if slab_first else weight + slab}</worldbody>"""
    )
    model.opt.gravity = data.site("frame").xmat.reshape(3, 3) @ PULL
    mujoco.mj_step(model, data, nstep=600)
    reader = ContactReader(model, site="frame", geom="top")
    contacts, nothing = reader.read(data), reader.read(mujoco.MjData(model))
    assert contacts.net_n == pytest.approx(KG * PULL * (1, 1, -1), abs=SOLVED * KG * GRAVITY)
    assert contacts.points_mm[:, 2] == pytest.approx(np.full(4, 10.0), abs=0.2)  # MuJoCo: midway into the overlap
    assert np.ptp(contacts.points_mm, axis=0)[:2] == pytest.approx([12.0, 8.0], abs=1e-2)
    site = data.site("frame")
    box_mm = 1000.0 * (data.body("box").xpos - site.xpos) @ site.xmat.reshape(3, 3)
    moment_nmm = np.cross(contacts.points_mm - box_mm, contacts.force_n * (1, 1, -1)).sum(axis=0)
    assert moment_nmm == pytest.approx(np.zeros(3), abs=1e-3 * KG * GRAVITY)  # 1 µm: what a step creeps, and more
    points, forces = stacked([nothing, contacts])  # of environments
    assert not forces[0].any()
    assert (points[1] == contacts.points_mm).all()
    assert (forces[1] == contacts.force_n).all()
    with pytest.raises(ArgumentError, match=r"no geom 'floor'.*box.*top"):
        ContactReader(model, site="frame", geom="floor")


def test_a_body_in_centimetres_and_other_contacts():
    """All geoms of a body count, in the unit that is stated; what touches the sides or comes from below does not."""
    ball = '<freejoint/><geom type="sphere" size=".5"/></body>'
    model, data = forward(
        f"""<option gravity="0 0 0"/><worldbody><body name="slab"><site name="frame"/>
        <geom type="box" size="2 2 .5" pos="-2 0 .5"/><geom type="box" size="2 2 .5" pos="2 0 .5"/></body>
        <body pos="2 1 1.49">{ball}<body pos="-3 -1 -.49">{ball}<body pos="4.49 0 .5">{ball}</worldbody>"""
    )
    contacts = ContactReader(model, site="frame", body="slab", mm_per_length=10.0).read(data)
    assert contacts.points_mm[:, :2] == pytest.approx(np.array([[20.0, 10.0]]))
    assert contacts.force_n[0, 2] > 0
    assert contacts.left_out == 2


def test_bodies_are_the_geoms_that_press_as_they_stand():
    """A ball, a lying capsule, a tilted box and others on a slab that is itself turned."""
    geoms = {
        "ball": 'type="sphere" size=".005" pos="-.03 0 .0149"',
        "bar": 'type="capsule" size=".003 .004" zaxis="0 1 0" pos="-.01 0 .0129"',
        "box": 'type="box" size=".004 .003 .002" euler="0 10 0" pos=".01 0 .0125"',
        "rod": 'type="cylinder" size=".003 .004" zaxis="1 0 0" pos=".02 .01 .0129"',
        "egg": 'type="ellipsoid" size=".003 .004 .005" pos=".02 -.01 .0149"',
        "mesh": 'type="mesh" mesh="wedge" pos=".03 0 .0129"',
    }
    bodies = "".join(f'<body><freejoint/><geom name="{name}" {each}/></body>' for name, each in geoms.items())
    bodies = bodies.replace("<body>", '<frame euler="0 30 0"><body>').replace("</body>", "</body></frame>")
    model, data = forward(
        f"""<option gravity="0 0 0"/><asset>
        <mesh name="wedge" vertex="-.004 -.004 .003  .004 -.004 .003  .004 .004 .003  -.004 .004 .003  0 0 -.003"/>
        </asset><worldbody><frame euler="0 30 0">{SLAB}</frame>{bodies}</worldbody>"""
    )
    found = ContactReader(model, site="frame", geom="top").bodies(data)
    named = {model.geom(number).name: body for number, body in found.items()}
    assert set(named) == set(geoms)
    x, y = np.meshgrid(np.linspace(-4, 4, 81), np.linspace(-4, 4, 81))
    for name, body in named.items():
        assert 0.05 < -body.place_mm[2] - body.shape.lowest_mm < 0.5, name  # how deep it is in the slab
        assert body.normal_n > 0, name
        assert np.nanmin(body.shape.heights_mm(x, y)) == pytest.approx(0.0, abs=0.05), name
    assert named["ball"].place_mm == pytest.approx([-30.0, 0.0, 4.9], abs=1e-6)
    assert abs(named["bar"].shape.turn[1, 2]) == pytest.approx(1.0)


def test_a_softened_contact_is_a_spring(press_env):
    """At rest each of the finger's two contacts is one of the stiffness asked for: F = K · depth."""
    world = press_env.finger_on_slab(press_env.FINGERTIP, 240.0)
    data = mujoco.MjData(world)
    data.ctrl[2] = -0.006
    mujoco.mj_step(world, data, nstep=2000)
    pressed = ContactReader(world, site="sensor", geom="slab").read(data)
    assert pressed.net_n[2] == pytest.approx(2 * 240.0 * -1000 * data.contact.dist[0], rel=1e-3)
    assert data.qvel == pytest.approx(np.zeros(3), abs=1e-6)  # nothing chatters
