# SPDX-License-Identifier: Apache-2.0
"""Settings: defaults, ranges, contradictions, and what the amplifier makes of them."""

import math

import numpy as np
import pytest
import yaml

from waferbot_copley import filters
from waferbot_copley.settings import SETTINGS, amplifier_parameters, settings_of
from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.timing import Timing


def test_defaults_are_in_range_and_described():
    """Every setting has a unique name, a description, and a default that may be set again."""
    assert len({setting.name for setting in SETTINGS}) == len(SETTINGS)
    for setting in SETTINGS:
        assert setting.low <= setting.default <= setting.high
        assert setting.description
        assert isinstance(setting.default, int) == setting.integer
    values = {setting.name: setting.default for setting in settings_of('y_rotate')}
    assert (amplifier_parameters({'y_rotate': values}) == amplifier_parameters({})).all()


def test_motor_encoder_commutates():
    """Y-Rotate is commutated by the encoder on its motor, the others by their only one."""
    assert amplifier_parameters({})['commutation_encoder'].tolist() == [[0, 1, 3]]


def test_only_the_named_axis_changes():
    """A setting belongs to one axis."""
    gain = amplifier_parameters({'x_rotate': {'proportional_gain': 1500}})['proportional'][0]
    default = amplifier_parameters({})['proportional'][0]
    assert gain.tolist() == [default[0], 1500 / 64, default[2]]


@pytest.mark.parametrize(
    ('settings', 'words'),
    [
        ({'y_linaer': {}}, ['unknown axis', "'y_linaer'", "'y_linear'"]),
        ({'y_linear': {'peak_curent': 1.0}}, ['y_linear', "'peak_curent'", "'peak_current'"]),
        ({'x_rotate': {'bus_voltage': 0.0}}, ['x_rotate', 'bus_voltage', '1 to 1000 V']),
        ({'x_rotate': {'bus_voltage': '325'}}, ['x_rotate', 'bus_voltage', 'number']),
        ({'x_rotate': {'bus_voltage': math.nan}}, ['x_rotate', 'bus_voltage', '1 to 1000 V']),
        ({'y_rotate': {'proportional_gain': 7.5}}, ['proportional_gain', 'whole']),
        ({'y_rotate': {'continuous_current': 41.0}}, ['continuous_current', '41', '40']),
        ({'y_rotate': {'user_peak_current': 50.0}}, ['user_peak_current', '50', '40']),
        ({'y_rotate': {'user_continuous_current': 30.0}}, ['user_continuous_current', '30', '20']),
        (
            {'y_rotate': {'user_peak_current': 5.0, 'user_continuous_current': 6.0}},
            ['user_continuous_current', 'user_peak_current'],
        ),
        (
            {'x_rotate': {'counts_per_electrical_cycle': 0.5}},
            ['counts_per_electrical_cycle', '0.5', 'one count'],
        ),
        ({'y_linear': {'filter_1_kind': 5}}, ['filter_1_kind', '5']),
        (
            {'y_linear': {'filter_2_kind': filters.LOW_PASS, 'filter_2_frequency': 9000.0}},
            ['filter_2_frequency', '9000'],
        ),
        (
            {'y_linear': {'filter_1_kind': filters.NOTCH, 'filter_1_width': 9500.0}},
            ['filter_1_width', '9000'],
        ),
        (
            {'y_linear': {'filter_1_kind': filters.CUSTOM, 'filter_1_a1': 1.9,
                          'filter_1_a2': -0.8}},
            ['filter_1_a1', 'unstable'],
        ),
    ],
)  # fmt: skip
def test_wrong_settings_are_explained(settings, words):
    """The error names the place, the setting and what is allowed."""
    with pytest.raises(UserError) as caught:
        amplifier_parameters(settings, where='amplifiers.yaml')
    for word in ['amplifiers.yaml', *words]:
        assert word in str(caught.value)


def test_user_limits_default_to_the_drives():
    """What the user does not limit is as in the drive, within what the user does limit."""
    ratings = {'peak_current': 18.0, 'continuous_current': 6.0, 'i2t_time': 2.0}
    parameters = amplifier_parameters({'y_linear': ratings})
    assert parameters['i2t_setpoint'][0, 0].tolist() == [576.0, 576.0]
    parameters = amplifier_parameters({'y_linear': {**ratings, 'user_peak_current': 5.0}})
    assert parameters['peak_limit'][0, 0] == 5.0
    assert parameters['continuous_limit'][0, 0].tolist() == [6.0, 5.0]


def test_rate_of_the_current_loop_enters():
    """Tick and filters follow the timing."""
    timing = Timing(current_loop_hz=16000)
    settings = {'y_linear': {'filter_1_kind': filters.LOW_PASS, 'filter_1_frequency': 2000.0}}
    parameters = amplifier_parameters(settings, timing)
    assert parameters['tick_s'][0] == 1 / 16000
    expected = filters.low_pass(2000.0, 16000, 2)
    assert np.array_equal(parameters['filter_coefficients'][0, 0, 0], expected)
    assert parameters['filter_coefficients'][0, 0, 1].tolist() == list(filters.PASS_THROUGH)
    assert parameters['filtered'].tolist() == [[1, 0, 0]]


def test_shipped_configuration_is_accepted():
    """The file in config/ holds known settings in range, for all three axes."""
    path = package_data('waferbot_copley', 'config', 'amplifiers.yaml')
    settings = yaml.safe_load(path.read_text('utf-8'))['/**/copley']['ros__parameters']
    assert tuple(settings) == AXES
    parameters = amplifier_parameters(settings, where=path.name)
    assert parameters['commutation_encoder'].tolist() == [[0, 1, 3]]


def test_amplifiers_of_another_machine_have_its_axes_and_encoders():
    arm = Layout(('lift', 'elbow'), ('lift', 'elbow_load', 'elbow_motor'))
    p = amplifier_parameters({'elbow': {'bus_voltage': 48.0}}, where='arm', layout=arm)[0]
    assert p['commutation_encoder'].tolist() == [0, 2]  # the one on the motor
    assert p['bus_voltage'][1] == 48.0
    with pytest.raises(UserError, match='commutation_encoder is 3; the range is 0 to 2'):
        amplifier_parameters({'elbow': {'commutation_encoder': 3}}, where='arm', layout=arm)
    with pytest.raises(UserError, match="unknown axis 'y_linear'"):
        amplifier_parameters({'y_linear': {}}, where='arm', layout=arm)
