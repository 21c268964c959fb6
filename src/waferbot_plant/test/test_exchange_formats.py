# SPDX-License-Identifier: Apache-2.0
"""MJCF against MuJoCo, URDF in against pinocchio, both ways against our own mechanics."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import yaml

from waferbot_lockstep.errors import UserError
from waferbot_plant import plant
from waferbot_plant.assembly import assemble
from waferbot_plant.description_file import load_description
from waferbot_plant.inverse_dynamics import InverseDynamics
from waferbot_plant.mjcf import joint_dynamics, mjcf
from waferbot_plant.motors import force_constant
from waferbot_plant.plant import Machine, load_machine
from waferbot_plant.urdf import urdf
from waferbot_plant.urdf_reader import read_urdf

ROBOT = """
<robot name="Bent arm">
  <link name="world"/>
  <link name="rail"><inertial><origin xyz="0.1 0 0.02" rpy="0.1 0.2 0.3"/><mass value="3"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial></link>
  <link name="Upper-Arm"><inertial><origin xyz="0 0.2 0"/><mass value="2"/>
    <inertia ixx="0.03" iyy="0.01" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="plate"><inertial><origin xyz="0 0 0.05" rpy="0 0 1"/><mass value="0.5"/>
    <inertia ixx="0.002" iyy="0.001" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"><inertial><origin xyz="0.05 0.1 0"/><mass value="1.2"/>
    <inertia ixx="0.004" iyy="0.002" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="world"/><child link="rail"/>
    <origin xyz="0 0 0.5" rpy="0 0 0.4"/><axis xyz="0 0 1"/><dynamics damping="30" friction="12"/>
    <limit lower="-2" upper="2" effort="500" velocity="2"/></joint>
  <joint name="Shoulder" type="revolute"><parent link="rail"/><child link="Upper-Arm"/>
    <origin xyz="0.3 0 0.1" rpy="0.5 0 0"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-2" upper="2" effort="500" velocity="2"/></joint>
  <joint name="bolt" type="fixed"><parent link="Upper-Arm"/><child link="plate"/>
    <origin xyz="0 0.3 0" rpy="0 0.7 0"/></joint>
  <joint name="wrist" type="continuous"><parent link="plate"/><child link="hand"/>
    <origin xyz="0.1 0 0" rpy="0 0 0.2"/><axis xyz="1 0 0"/><dynamics damping="0.2"/></joint>
</robot>
"""


def reduced_to_axes(description):
    """Return the rigid machine, and its axes' rows and ratios."""
    rigid = InverseDynamics(description)
    machine = rigid.machine
    placing = [machine.assembly.placing[name] for name in description.axes.values()]
    return machine, placing


def mass_and_gravity(description, pose):
    """Return M over the axes, and the generalised gravity there, of our own mechanics."""
    machine, placing = reduced_to_axes(description)
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    for (row, ratio), value in zip(placing, pose, strict=True):
        state[0]['position'][row] = value / ratio
    size = len(machine.coordinates)
    mass, force = np.zeros((size, size)), np.zeros(size)
    plant.mass_matrix(state, parameters, mass)
    plant.generalised_forces(state, parameters, force)
    rows = [row for row, _ in placing]
    per = np.array([1.0 / ratio for _, ratio in placing])
    return mass[np.ix_(rows, rows)] * np.outer(per, per), force[rows] * per


@pytest.mark.parametrize(
    'name', ['as_built', 'planar_two_link_arm', 'emps', 'gantry', 'scara_four_axes']
)
def test_mujoco_has_the_same_mass_matrix_and_gravity(name):
    description = load_machine(name).description
    model = mujoco.MjModel.from_xml_string(mjcf(description))
    data = mujoco.MjData(model)
    axes = list(description.axes)
    dofs = [model.joint(axis).dofadr[0] for axis in axes]
    # What follows an axis is tied to it by an equality; here its ratio is put in by hand.
    follow = np.zeros((model.nv, len(axes)))
    for column, dof in enumerate(dofs):
        follow[dof, column] = 1.0
    for equality in range(model.neq):
        one, other = model.eq_obj1id[equality], model.eq_obj2id[equality]
        ratio = model.eq_data[equality, 1]
        follow[model.jnt_dofadr[one]] = ratio * follow[model.jnt_dofadr[other]]
    random = np.random.default_rng(1)
    for pose in random.uniform(-0.6, 0.6, (5, len(axes))):
        data.qpos[:] = follow @ pose
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        mass, force = mass_and_gravity(description, pose)
        np.testing.assert_allclose(follow.T @ full @ follow, mass, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(-follow.T @ data.qfrc_bias, force, rtol=1e-8, atol=1e-8)


def test_mujoco_has_motors_and_friction_of_the_machine_as_built():
    description = load_machine('as_built').description
    model = mujoco.MjModel.from_xml_string(mjcf(description))
    motor = description.motors['y_linear']
    assert model.actuator('y_linear_current').gear[0] == pytest.approx(force_constant(motor))
    dof = model.joint('y_linear').dofadr[0]
    # Both guides: 23.0982 N and 4.39215 N of friction, 58.0249 N s/m (config/as_built.yaml).
    assert model.dof_frictionloss[dof] == pytest.approx(27.49035, rel=1e-6)
    assert model.dof_damping[dof] == pytest.approx(58.0249, rel=1e-6)
    assert joint_dynamics(description)['y_linear'].misfit < 1e-9
    # X-Rotate's friction rises from 6.28 to 10.66 Nm: a constant and a slope cannot have that.
    assert 0.03 < joint_dynamics(description)['x_rotate'].misfit < 0.1


def test_a_robot_has_pinocchios_mass_matrix_and_gravity():
    pin = pytest.importorskip('pinocchio')
    found = read_urdf(ROBOT, 'bent.urdf')
    description = load_description(yaml.safe_dump(found.description))
    model = pin.buildModelFromXML(ROBOT)
    data = model.createData()
    random = np.random.default_rng(2)
    for lift, shoulder, wrist in random.uniform(-1.0, 1.0, (5, 3)):
        q = np.array([lift, shoulder, np.cos(wrist), np.sin(wrist)])  # continuous: on the circle
        theirs = pin.crba(model, data, q)
        theirs = np.triu(theirs) + np.triu(theirs, 1).T
        gravity = pin.computeGeneralizedGravity(model, data, q)
        machine = Machine(description, assemble(description), load_machine('rigid').timing)
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        rows = [machine.assembly.placing[name] for name in ('lift', 'shoulder', 'wrist')]
        for (row, ratio), value in zip(rows, (lift, shoulder, wrist), strict=True):
            state[0]['position'][row] = value / ratio
        mass, force = np.zeros((3, 3)), np.zeros(3)
        plant.mass_matrix(state, parameters, mass)
        plant.generalised_forces(state, parameters, force)
        order = [row for row, _ in rows]
        np.testing.assert_allclose(mass[np.ix_(order, order)], theirs, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(force[order], -gravity, rtol=1e-6, atol=1e-6)


def test_what_the_robot_says_and_lacks_is_taken_and_told():
    found = read_urdf(ROBOT, 'bent.urdf')
    assert found.description['axes'] == {
        'y_linear': 'lift', 'x_rotate': 'shoulder', 'y_rotate': 'wrist'
    }  # fmt: skip
    assert found.description['frictions']['lift_friction']['force_n'] == [12.0]
    assert found.description['dampers']['wrist_damping']['damping_nm_s_rad'] == 0.2
    assert any('friction of shoulder' in one for one in found.lacks)
    assert any('motors' in one for one in found.lacks)


def test_our_own_urdf_reads_back_as_the_same_machine():
    description = load_machine('planar_two_link_arm').description
    text = urdf(description, {'x_rotate': (0.3, 1.5), 'y_rotate': (0.1, 0.0)})
    found = read_urdf(text, 'arm.urdf')
    again = load_description(yaml.safe_dump(found.description))
    assert list(again.axes) == ['x_rotate', 'y_rotate']
    assert again.frictions['x_rotate_friction'].resistances[0] == 1.5
    for pose in ([0.0, 0.0], [0.4, -0.7]):
        mass, force = mass_and_gravity(description, pose)
        machine = Machine(again, assemble(again), load_machine('rigid').timing)
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        state[0]['position'][:2] = pose
        own, pull = np.zeros((2, 2)), np.zeros(2)
        plant.mass_matrix(state, parameters, own)
        plant.generalised_forces(state, parameters, pull)
        np.testing.assert_allclose(own, mass, rtol=1e-6)
        # The shipped machine's gravity is 9.81 as well, about another axis of the same frame.
        np.testing.assert_allclose(pull, force, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ('change', 'said'),
    [
        (('<robot name="Bent arm">', '<robot'), 'no XML'),
        (('robot', 'machine'), 'must be <robot>'),
        (('type="prismatic"', 'type="planar"'), "'lift' is planar"),
        (('<mass value="3"/>', '<mass value="heavy"/>'), "value is 'heavy'"),
        (('xyz="0 0.6 0.8"', 'xyz="0 0 0"'), 'has no direction'),
        (('xyz="0 0 0.5"', 'xyz="0 0"'), 'not three numbers'),
        (('<child link="hand"/>', '<child link="foot"/>'), 'no child of a joint'),
        (('<mass value="1.2"/>', '<mass value="0"/>'), 'hand moves without a mass'),
    ],
)
def test_what_is_wrong_is_named(change, said):
    with pytest.raises(UserError, match='bent') as raised:
        read_urdf(ROBOT.replace(*change), 'bent.urdf')
    assert said in str(raised.value)
