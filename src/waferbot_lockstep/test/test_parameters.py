# SPDX-License-Identifier: Apache-2.0
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import Parameter, check_settings, check_value, did_you_mean

GAIN = Parameter('gain', 2000, 'DAC bits', 0, 32767, 'a gain', integer=True)
TIME = Parameter('time', 1.0, 's', 0.0, 10.0, 'a time')


def test_a_name_that_looks_the_same_is_the_nearest() -> None:
    known = ['Ixx63', 'Ixx30', 'Ixx31', 'payload']
    assert did_you_mean('Ixx3O', known) == "; did you mean 'Ixx30'?"
    assert did_you_mean('Ixx3l', known) == "; did you mean 'Ixx31'?"
    assert did_you_mean('PAYLOAD', known) == "; did you mean 'payload'?"
    assert did_you_mean(3, known) == did_you_mean('', known) == ''


def test_whole_number_is_taken_for_a_real_one():
    value = check_value(TIME, 3, '')
    assert value == 3.0
    assert isinstance(value, float)


@pytest.mark.parametrize(
    ('parameter', 'value', 'what'),
    [
        (GAIN, 32768, '0 to 32767 DAC bits'),
        (GAIN, 2.5, 'whole number'),
        (GAIN, True, 'whole number'),
        (GAIN, '5', 'whole number'),
        (GAIN, float('inf'), '0 to 32767 DAC bits'),
        (TIME, -0.1, '0 to 10 s'),
        (TIME, float('nan'), '0 to 10 s'),
        (TIME, None, 'a number'),
    ],
)
def test_wrong_values_name_place_and_range(parameter, value, what):
    with pytest.raises(UserError, match=what) as raised:
        check_value(parameter, value, 'file.yaml: y_linear')
    assert f'file.yaml: y_linear: {parameter.name}' in str(raised.value)


def test_defaults_fill_what_is_not_given():
    assert check_settings([GAIN, TIME], {'time': 2}, '') == {'gain': 2000, 'time': 2.0}


def test_unknown_setting_is_named_with_the_nearest():
    with pytest.raises(UserError, match="unknown setting 'gian'; did you mean 'gain'"):
        check_settings([GAIN, TIME], {'gian': 1}, 'file.yaml')
