# SPDX-License-Identifier: Apache-2.0
"""Frames of a robot against MuJoCo's kinematics of the same URDF."""

from __future__ import annotations

import struct

import mujoco
import numpy as np
import pytest

from waferbot_plant import plant
from waferbot_plant.frames import Frames
from waferbot_plant.urdf import urdf

ODD = """
<robot name="odd">
  <link name="floor"/>
  <link name="base">{mass}</link><link name="arm">{mass}</link><link name="slider">{mass}</link>
  <joint name="foot" type="fixed">
    <parent link="floor"/><child link="base"/><origin xyz="0.1 -0.2 0.3" rpy="0.3 -0.5 1.1"/>
  </joint>
  <joint name="turn" type="continuous">
    <parent link="base"/><child link="arm"/>
    <origin xyz="0 0.4 0" rpy="-0.7 0.2 0.4"/><axis xyz="1 2 -2"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="arm"/><child link="slider"/><origin rpy="0 1.3 0"/>
    <axis xyz="0.6 0 0.8"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>""".format(
    mass='<inertial><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
"""Origins and axes that point nowhere in particular."""

EXTENSION = (
    '<mujoco><compiler fusestatic="false" balanceinertia="true" discardvisual="true"/></mujoco>'
)


def decoded(message):
    """Return {child: (parent, translation, rotation x y z w)} of a TFMessage in CDR, and its stamps."""
    place, found, stamps = 4, {}, set()

    def take(kind, align):
        nonlocal place
        place += -(place - 4) % align
        values = struct.unpack_from('<' + kind, message, place)
        place += struct.calcsize('<' + kind)
        return values

    def text():
        (length,) = take('I', 4)
        return take(f'{length}s', 1)[0][:-1].decode()

    (count,) = take('I', 4)
    for _ in range(count):
        stamps.add(take('iI', 4))
        parent, child = text(), text()
        numbers = np.array(take('7d', 8))
        found[child] = (parent, numbers[:3], numbers[3:])
    assert place == len(message)
    return found, stamps


def matrix(rotation):
    """Return the rotation matrix of a quaternion x y z w."""
    x, y, z, w = rotation
    found = np.zeros(9)
    mujoco.mju_quat2Mat(found, np.array([w, x, y, z]))
    return found.reshape(3, 3)


def placed(frames, positions):
    """Return {link: (where, rotation matrix)} in the root's frame, by both messages together."""
    fixed, _ = decoded(frames.fixed_message())
    moving, _ = decoded(frames.message(0, positions))
    edges = {**fixed, **moving}
    (root,) = {parent for parent, _, _ in edges.values()} - set(edges)
    found = {root: (np.zeros(3), np.eye(3))}
    while len(found) <= len(edges):
        for child, (parent, translation, rotation) in edges.items():
            if parent in found and child not in found:
                at, turned = found[parent]
                found[child] = (at + turned @ translation, turned @ matrix(rotation))
    return found


def check(text, names, without=()):
    seed = 30
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(text.replace('</robot>', EXTENSION + '</robot>'))
    data = mujoco.MjData(model)
    frames = Frames.of(text)
    for _ in range(20):
        positions = dict(zip(names, rng.uniform(-1.0, 1.0, len(names)), strict=True))
        for name in names:
            data.joint(name).qpos[0] = positions[name]
        for follower, leader, multiplier in without:
            data.joint(follower).qpos[0] = multiplier * positions[leader]
        mujoco.mj_forward(model, data)
        found = placed(frames, positions)
        for link, (at, turned) in found.items():
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link) < 0:
                continue  # the root is MuJoCo's world
            body = data.body(link)
            np.testing.assert_allclose(at, body.xpos, atol=1e-12, err_msg=f'{seed=} {link}')
            np.testing.assert_allclose(turned, body.xmat.reshape(3, 3), atol=1e-12)
        assert len(found) > 3


@pytest.mark.parametrize('model', ['rigid', 'as_built'])
def test_the_machine_stands_as_mujoco_has_it(model):
    """MuJoCo takes the counterweight's joint for a free one; it is put where its mimic says."""
    text = urdf(plant.load_machine(model).description)
    follower = [('counterweight', 'y_linear', -1.0)]
    check(text, ['y_linear', 'x_rotate', 'y_rotate'], follower)


def test_origins_and_axes_may_point_anywhere():
    check(ODD, ['turn', 'slide'])


def test_the_moving_have_their_stamp_and_joints_that_are_not_told_are_left_out():
    frames = Frames.of(ODD)
    moving, stamps = decoded(frames.message(3_000_000_007, {'turn': 0.5, 'stranger': 1.0}))
    assert set(moving) == {'arm'}
    assert stamps == {(3, 7)}
    assert set(decoded(frames.fixed_message())[0]) == {'base'}
