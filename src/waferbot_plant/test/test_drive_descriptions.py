# SPDX-License-Identifier: Apache-2.0
"""Descriptions of imperfect motors, encoders and sensors: mistakes are said with line and key."""

from __future__ import annotations

import copy

import numpy as np
import plant_machines as machines
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_plant import motors, plant
from waferbot_plant.description_file import load_description
from waferbot_plant.plant import load_machine


def sound() -> dict:
    return machines.single_mass(
        encoders={'y_linear': {'coordinate': 'travel', 'counts_per_m': 1000}},
        motors={
            'y_linear': {
                'coordinate': 'travel',
                'winding': 'delta',
                'resistance_lead_to_lead_ohm': 2.0,
                'inductance_lead_to_lead_h': 0.01,
                'back_emf_lead_to_lead_v_s_m': 50.0,
                'electrical_cycle_m': 0.03,
            }
        },
        current_sensors={'y_linear': {'gain_1': 0.01}},
    )


MOTOR = ('motors', 'y_linear')
ENCODER = ('encoders', 'y_linear')
SENSORS = ('current_sensors', 'y_linear')


@pytest.mark.parametrize(
    ('where', 'value', 'words'),
    [
        ((*MOTOR, 'saturation_current_a'), -1.0, ['at least 0']),
        ((*MOTOR, 'saturation_curent_a'), 1.0, ["did you mean 'saturation_current_a'"]),
        ((*MOTOR, 'phase_imbalance'), [0.1], ['phase_imbalance', 'at least 2']),
        ((*MOTOR, 'phase_imbalance'), [0.1, -1.0], ['greater than -1']),
        ((*MOTOR, 'ripple'), [{'cosine': 0.1}], ['order missing']),
        ((*MOTOR, 'ripple'), [{'order': 0}], ['order', 'greater than 0']),
        ((*MOTOR, 'ripple'), [{'order': 6, 'cosine': 0.1}] * 5, ['at most 4']),
        (
            (*MOTOR, 'ripple'),
            [{'order': 6, 'cosine': 0.6}, {'order': 2, 'sine': 0.6}],
            ['ripple', '1.2', 'below 1'],
        ),
        ((*ENCODER, 'scale_error'), -1, ['greater than -1']),
        (
            (*ENCODER, 'eccentricity'),
            {'amplitude_rad': 0.1, 'period_m': 1.0},
            ['amplitude_rad', 'wrong unit', 'amplitude_m'],
        ),
        ((*ENCODER, 'eccentricity'), {'amplitude_m': 0.1}, ['period_m missing']),
        ((*ENCODER, 'eccentricity'), {'amplitude_m': 0.1, 'period_m': 0}, ['greater than 0']),
        ((*ENCODER, 'interpolation'), {'amplitude_counts': 1}, ['period_counts missing']),
        ((*ENCODER, 'coarseness_counts'), 0.5, ['at least 1']),
        ((*ENCODER, 'extra_delay_cycles'), 1.5, ['integer']),
        ((*ENCODER, 'extra_delay_cycles'), 15, ['16 cycles late', 'longest delay is 15']),
        ((*ENCODER, 'delay_fraction'), 1.5, ['at most 1']),
        ((*ENCODER, 'delay_s'), 0.03, ['at most 0.02']),
        ((*ENCODER, 'noise_counts'), -1, ['at least 0']),
        ((*ENCODER, 'noise_seed'), 1.5, ['integer']),
        ((*ENCODER, 'lost_counts'), {'counts': 3}, ['every_m missing']),
        ((*ENCODER, 'lost_counts'), {'counts': 3, 'every_rad': 1}, ['wrong unit', 'every_m']),
        ((*SENSORS, 'gain_1'), -1.0, ['greater than -1']),
        ((*SENSORS, 'offset_a'), 1.0, ['unknown key', "did you mean 'offset_"]),
        (('current_sensors', 'x_rotate'), {}, ["no motor 'x_rotate'"]),
        (('current_sensors', 'z_rotate'), {}, ['current_sensors.z_rotate', "no axis 'z_rotate'"]),
    ],
)
def test_mistakes_are_explained(where, value, words) -> None:
    data = sound()
    load_description(machines.write(copy.deepcopy(data)))
    section = data
    for key in where[:-1]:
        section = section[key]
    section[where[-1]] = value
    path = machines.write(data)
    with pytest.raises(UserError) as caught:
        load_description(path)
    message = str(caught.value)
    assert message.startswith(f'{path}, line ')
    for word in (*where[:2], *words):
        assert word in message


def test_what_is_left_out_is_neutral() -> None:
    description = load_description(machines.write(sound()))
    errors = description.encoders['y_linear'].errors
    assert errors == type(errors)()
    motor = description.motors['y_linear']
    assert (motor.saturation_current, motor.ripple, motor.phase_imbalance) == (0.0, (), (0.0, 0.0))


def by_force(**more) -> dict:
    data = sound()
    data['motors'] = {'y_linear': {'coordinate': 'travel', 'force_per_ampere_n_a': 35.0, **more}}
    return data


def test_a_motor_by_its_force_per_ampere_alone() -> None:
    motor = load_description(machines.write(by_force())).motors['y_linear']
    assert motors.force_constant(motor) == pytest.approx(35.0)
    assert motor.by_force
    assert motor.electrical_gain == pytest.approx(2.0 * 3.141592653589793)  # orders per metre
    assert not motor.poles_known
    cycle = load_description(machines.write(by_force(electrical_cycle_m=0.02)))
    assert cycle.motors['y_linear'].poles_known
    assert cycle.motors['y_linear'].electrical_gain == pytest.approx(
        2.0 * 3.141592653589793 / 0.02
    )
    wound = load_description(machines.write(sound())).motors['y_linear']
    assert wound.poles_known
    assert not wound.by_force


@pytest.mark.parametrize(
    ('more', 'words'),
    [
        ({'winding': 'wye'}, ['winding', 'whole data sheet', 'force_per_ampere_n_a']),
        ({'torque_per_ampere_nm_a': 1.0}, ['torque_per_ampere_nm_a', 'wrong unit']),
        ({'pole_pairs': 7}, ['pole_pairs', 'wrong unit', 'electrical_cycle_m']),
        ({'force_per_ampere_n_a': 0.0}, ['greater than 0']),
    ],
)
def test_half_a_data_sheet_is_refused(more, words) -> None:
    with pytest.raises(UserError) as caught:
        load_description(machines.write(by_force(**more)))
    for word in words:
        assert word in str(caught.value)


def test_a_motor_of_which_nothing_is_said_is_refused() -> None:
    data = sound()
    data['motors'] = {'y_linear': {'coordinate': 'travel'}}
    with pytest.raises(UserError, match=r'winding and .* missing .*force_per_ampere_n_a'):
        load_description(machines.write(data))


def test_no_voltages_on_a_motor_without_windings() -> None:
    with pytest.raises(UserError, match='y_linear is known by its force per ampere alone'):
        motors.check_windings(load_description(machines.write(by_force())))
    data = sound()
    motors.check_windings(load_description(machines.write(data)))
    data['motors']['y_linear']['lag_s'] = 0.0
    motors.check_windings(load_description(machines.write(data)))
    data['motors']['y_linear']['lag_s'] = 5e-4
    with pytest.raises(UserError, match=r'y_linear has the lag of a drive .* 0\.0005 s'):
        motors.check_windings(load_description(machines.write(data)))


def test_viscous_damping_of_a_motor_is_a_damper_on_its_coordinate() -> None:
    """Chapter 5 of the thesis has it on the rotary axes; at the motor's shaft, before the gearbox."""
    motors = {
        'x_rotate': {'viscous_damping_nm_s_rad': 0.3},
        'y_rotate': {'viscous_damping_nm_s_rad': 2e-4},
    }
    machine = load_machine('rigid', overlays=[{'motors': motors}])
    dampers = machine.description.dampers
    assert {name: (one.coordinate, one.damping) for name, one in dampers.items()} == {
        'x_rotate_motor_viscous': ('x_rotate', 0.3),
        'y_rotate_motor_viscous': ('y_rotate_motor', 2e-4),
    }
    ratio = 1.0 / abs(machine.description.transmissions['y_rotate_drive'].ratio)
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    parameters[0]['gravity'] = 0.0
    state[0]['terminals_open'] = 1
    state[0]['velocity'][:3] = 0.0, 0.0, 1.0
    plant.advance(state, parameters, np.zeros(9))
    speed = 0.5 * (1.0 + state[0]['velocity'][2])
    place = [element.name for element in machine.assembly.springs].index('y_rotate_motor_viscous')
    power = state[0]['spring_loss'][place] / machine.timing.tick_s
    assert power == pytest.approx(2e-4 * (ratio * speed) ** 2, rel=1e-6)
    with pytest.raises(UserError, match='viscous_damping_n_s_m'):
        load_machine('rigid', overlays=[{'motors': {'x_rotate': {'viscous_damping_n_s_m': 1.0}}}])
