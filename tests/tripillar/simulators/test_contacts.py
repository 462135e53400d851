"""Contacts of MuJoCo on a slab are what statics says, in the sensor's own frame."""

import runpy
import sys

import numpy as np
import pytest

from geometry.errors import ArgumentError, MissingPackageError

mujoco = pytest.importorskip("mujoco")

from tripillar.simulators.contacts import ContactReader, stacked  # noqa: E402 (needs mujoco)

GRAVITY, KG = 9.81, 1.3
SOLVED = 1e-6  #: relative: MuJoCo's tolerance of 1e-8, and what is left of the box's settling


def settled(gravity=(0.0, 0.0, -GRAVITY), place="0 0 0", turned="1 0 0 0", slab_first=True, cone="elliptic", box="0 0"):
    """A box at rest on a slab of 40 × 40 × 10 mm that lies anywhere in the world; gravity is in the slab's frame."""
    slab = f"""<body name="slab" pos="{place}" quat="{turned}">
      <geom name="top" type="box" size=".02 .02 .005" pos="0 0 .005"/><site name="frame"/></body>"""
    # the box, too, is stated in the slab's frame
    weight = f"""<frame pos="{place}" quat="{turned}"><body name="box" pos="{box} .015"><freejoint/>
      <geom name="box" type="box" size=".006 .004 .005" mass="{KG}"/></body></frame>"""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option cone="{cone}" timestep=".002" impratio="10"/><default><geom friction="1 0 0"/></default>
        <worldbody>{slab + weight if slab_first else weight + slab}</worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    model.opt.gravity = data.site("frame").xmat.reshape(3, 3) @ gravity
    mujoco.mj_step(model, data, nstep=600)
    return model, data


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("slab_first", [True, False])
def test_a_box_at_rest_weighs_what_it_weighs_under_its_middle(slab_first, cone):
    """ΣFz = m g and its centre lies under the centre of mass, whichever geom MuJoCo takes first."""
    model, data = settled(slab_first=slab_first, cone=cone, box=".003 -.007")
    contacts = ContactReader(model, site="frame", geom="top").read(data)
    assert len(contacts.points_mm) == 4
    assert contacts.net_n == pytest.approx([0, 0, KG * GRAVITY], abs=SOLVED * KG * GRAVITY)
    assert contacts.centre_mm == pytest.approx([3.0, -7.0], abs=1e-3)
    assert contacts.points_mm[:, 2] == pytest.approx(10.0, abs=0.2)  # MuJoCo's point is midway into the overlap
    assert np.ptp(contacts.points_mm, axis=0)[:2] == pytest.approx([12.0, 8.0], abs=1e-3)


@pytest.mark.parametrize("slab_first", [True, False])
def test_tilted_gravity_drags_downhill(slab_first):
    """Gravity along +x and −y in the slab's frame drags it that way and turns nothing, wherever the slab lies."""
    pull = np.array([2.0, -1.0, -GRAVITY])
    model, data = settled(pull, place=".3 -.2 .7", turned=".8 .3 -.4 .2", slab_first=slab_first)
    contacts = ContactReader(model, site="frame", geom="top").read(data)
    assert contacts.net_n == pytest.approx(KG * pull * (1, 1, -1), abs=SOLVED * KG * GRAVITY)
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
    assert contacts.force_n[0, 2] > 0
    assert contacts.left_out == 2


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


def test_names_that_the_model_lacks_are_refused():
    model, _ = settled()
    with pytest.raises(ArgumentError, match=r"no site 'tool'; it has frame\."):
        ContactReader(model, site="tool", geom="top")
    with pytest.raises(ArgumentError, match=r"no geom 'floor'; it has top, box\."):
        ContactReader(model, site="frame", geom="floor")
    with pytest.raises(ArgumentError, match="one of the two"):
        ContactReader(model, site="frame")
    with pytest.raises(ArgumentError, match="above 0"):
        ContactReader(model, site="frame", body="slab", mm_per_length=0.0)


def test_a_missing_simulator_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingPackageError, match=r"mujoco.*pip install 'tripillar\[simulators\]'"):
        runpy.run_path(sys.modules[ContactReader.__module__].__file__)
