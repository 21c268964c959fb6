# SPDX-License-Identifier: Apache-2.0
"""Descriptions of imperfect motors, encoders and sensors: mistakes are said with line and key."""

from __future__ import annotations

import copy

import plant_machines as machines
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_plant.description_file import load_description


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
        (('current_sensors', 'z_rotate'), {}, ['z_rotate', 'y_linear']),
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
