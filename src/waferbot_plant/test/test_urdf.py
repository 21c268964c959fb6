# SPDX-License-Identifier: Apache-2.0
"""The URDF against MuJoCo's reading of it and against the plant's own mass matrix."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import plant_machines as machines

from waferbot_plant import plant
from waferbot_plant.description_file import load_description
from waferbot_plant.mjcf import mjcf
from waferbot_plant.urdf import urdf


def moving_machine(text):
    """Return MuJoCo's model of the three axes; it knows no mimic joint, so the counterweight goes."""
    robot = ElementTree.fromstring(text)
    for joint in [j for j in robot.findall('joint') if j.find('mimic') is not None]:
        robot.remove(joint)
        child = joint.find('child').get('link')
        robot.remove(next(link for link in robot.findall('link') if link.get('name') == child))
    compiler = ElementTree.SubElement(ElementTree.SubElement(robot, 'mujoco'), 'compiler')
    compiler.set('balanceinertia', 'false')
    compiler.set('fusestatic', 'false')
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, encoding='unicode'))


def test_mujoco_finds_the_same_mass_matrix_in_it():
    machine = plant.load_machine('rigid')
    model = moving_machine(urdf(machine.description))
    data = mujoco.MjData(model)
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(model.njnt)]
    assert names == ['y_linear', 'x_rotate', 'y_rotate']
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    counterweight = machine.description.bodies['counterweight'].mass
    rotors = sum(rotor.inertia for rotor in machine.description.rotors.values())
    reflected = rotors * (16 * 3) ** 2  # gearbox and belt
    seed = 20
    rng = np.random.default_rng(seed)
    for _ in range(50):
        position = rng.uniform(-1.0, 1.0, 3)
        data.qpos[:] = position
        mujoco.mj_forward(model, data)
        theirs = np.zeros((3, 3))
        mujoco.mj_fullM(model, data, theirs)
        theirs += np.diag([counterweight, 0.0, reflected])
        state['position'][0, :3] = position
        ours = np.zeros((3, 3))
        plant.mass_matrix(state, parameters, ours)
        np.testing.assert_allclose(
            ours, theirs, rtol=0, atol=2e-6 * ours.max(), err_msg=f'{seed=}'
        )


def test_counterweight_mirrors_the_carriage():
    robot = ElementTree.fromstring(urdf(plant.load_machine('rigid').description))
    mimic = robot.find("joint[@name='counterweight']/mimic")
    assert (mimic.get('joint'), mimic.get('multiplier')) == ('y_linear', '-1')


def test_the_one_transform_turns_y_up_into_z_up():
    robot = ElementTree.fromstring(urdf(plant.load_machine('rigid').description))
    roll = float(robot.find("joint[@name='machine_to_ros']/origin").get('rpy').split()[0])
    turn = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    np.testing.assert_allclose(turn @ [0, 1, 0], [0, 0, 1], atol=1e-8)


def with_second_locked():
    """Return the description of two slides, the second one locked."""
    data = machines.two_slides()
    data['joints']['second_guide']['freedoms']['second']['locked'] = True
    return load_description(machines.write(data))


def test_what_is_locked_is_fixed_in_it_and_welded_in_mjcf():
    robot = ElementTree.fromstring(urdf(with_second_locked()))
    kinds = {joint.get('name'): joint.get('type') for joint in robot.findall('joint')}
    assert kinds['y_linear'] == 'prismatic'
    assert kinds['second_guide'] == 'fixed'
    model = mujoco.MjModel.from_xml_string(mjcf(with_second_locked()))
    assert model.njnt == 1
    assert mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, model.nbody - 1) == 'second'
