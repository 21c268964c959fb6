# SPDX-License-Identifier: Apache-2.0
"""I-variables, and settings from YAML and from listings."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.package_data import package_data
from waferbot_pmac.i_variables import (
    I_VARIABLES,
    axis_parameters,
    change_parameter,
    servo_parameters,
)
from waferbot_pmac.settings import load_settings, parse_listing, parse_yaml

SHIPPED = package_data('waferbot_pmac', 'config', 'pmac.yaml')

TABLE_3_2 = (3, 4, 7, 8, 9, 16, 17, *range(30, 40), 63, 65, 68, 69)


def test_every_variable_of_the_thesis_table_is_declared_once():
    names = [parameter.name for parameter in I_VARIABLES]
    assert len(names) == len(set(names))
    assert {f'Ixx{number:02d}' for number in TABLE_3_2} <= set(names)
    assert names == sorted(names)


@pytest.mark.parametrize('axis', AXES)
def test_declarations_are_consistent(axis):
    for parameter in axis_parameters(axis):
        assert parameter.low <= parameter.default <= parameter.high
        assert parameter.description
        if parameter.integer:
            assert parameter.default == int(parameter.default)


def test_defaults_fill_what_is_not_given():
    parameters = servo_parameters({'x_rotate': {'Ixx30': 5}})
    assert parameters['Ixx30'][0].tolist() == [2000, 5, 2000]
    assert parameters['Ixx03'][0].tolist() == [0, 1, 2]
    assert parameters['Ixx04'][0].tolist() == [0, 1, 3]


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'z_linear': {}}, ['z_linear', 'y_linear']),
        ({'y_linear': {'Ixx99': 1}}, ['y_linear', 'Ixx99']),
        ({'y_linear': {'Ixx30': 2**23}}, ['y_linear', 'Ixx30', '8388608']),
        ({'y_linear': {'Ixx30': 1.5}}, ['Ixx30', 'whole']),
        ({'y_linear': {'Ixx08': 0}}, ['Ixx08', '0']),
        ({'y_linear': {'Ixx36': 2.0}}, ['Ixx36', '-2']),
        ({'y_linear': {'Ixx16': '3'}}, ['Ixx16', "'3'"]),
    ],
)
def test_wrong_settings_are_refused_by_axis_and_name(values, words):
    with pytest.raises(UserError) as caught:
        servo_parameters(values, 'my file')
    for word in ['my file', *words]:
        assert word in str(caught.value)


def test_notch_coefficients_are_held_with_22_fractional_bits():
    for value, held in ((1000.7, 1001), (-1000.7, -1001), (1000.3, 1000)):
        parameters = servo_parameters({'y_linear': {'Ixx36': value / 2**22}})
        assert parameters['Ixx36'][0, 0] * 2**22 == held


def test_variables_change_at_run_time_but_fixed_ones_only_with_the_loop_open():
    parameters = servo_parameters({})
    change_parameter(parameters, 'x_rotate', 'Ixx30', 77, loop_closed=True)
    assert parameters['Ixx30'][0].tolist() == [2000, 77, 2000]
    for name, value in (('Ixx08', 192), ('Ixx03', 0), ('Ixx60', 1), ('counts_per_unit', 2.0)):
        before = parameters.copy()
        with pytest.raises(UserError, match=name):
            change_parameter(parameters, 'x_rotate', name, value, loop_closed=True)
        assert parameters == before
        change_parameter(parameters, 'x_rotate', name, value, loop_closed=False)
        assert parameters[name][0, 1] == value
    for axis, name, value in (
        ('x', 'Ixx30', 1),
        ('x_rotate', 'I30', 1),
        ('x_rotate', 'Ixx69', -1),
    ):
        with pytest.raises(UserError):
            change_parameter(parameters, axis, name, value, loop_closed=False)


def test_shipped_settings_are_valid_and_scale_both_encoders_of_y_rotate_alike():
    """Ixx09 times the velocity encoder's counts equals Ixx08 times the position encoder's."""
    listing = load_settings(SHIPPED)
    assert set(listing.settings) == set(AXES)
    parameters = servo_parameters(listing.settings)
    velocity_counts_per_position_count = {'y_linear': 1, 'x_rotate': 1, 'y_rotate': 3}
    for place, axis in enumerate(AXES):
        ratio = velocity_counts_per_position_count[axis]
        assert parameters['Ixx09'][0, place] * ratio == parameters['Ixx08'][0, place]
        assert parameters['Ixx30'][0, place] > 0


def test_yaml_takes_other_nodes_and_node_parameters_in_its_stride():
    text = """
/**/plant:
  ros__parameters: {connections: rigid}
/twin/pmac:
  ros__parameters:
    experiment: step
    y_linear: {Ixx30: 6, Ixx16: 1e3}
"""
    assert parse_yaml(text, 'a.yaml') == {'y_linear': {'Ixx30': 6, 'Ixx16': 1000.0}}


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('y_linear: {Ixx30: 6}', ['a.yaml', 'pmac']),
        ('pmac:\n  ros__parameters:\n    y_linear:\n      Ixx3O: 6', ['line 4', 'Ixx3O']),
        ('pmac:\n  ros__parameters:\n    y_linear:\n      Ixx30: 9e9', ['line 4', 'Ixx30']),
        ('pmac:\n  ros__parameters:\n    y_linear:\n\n      Ixx30: yes', ['line 5', 'Ixx30']),
        ('pmac:\n  ros__parameters:\n    y_linear: 5', ['line 3', 'y_linear']),
        ('pmac: {y_linear: {Ixx30: 1}}', ['line 1', 'ros__parameters']),
        ('pmac:\n  a: [', ['a.yaml', 'line 2']),
        ('- 1', ['a.yaml']),
        ('', ['a.yaml']),
    ],
)
def test_mistakes_in_yaml_are_located(text, words):
    with pytest.raises(UserError) as caught:
        parse_yaml(text, 'a.yaml')
    for word in words:
        assert word in str(caught.value)


def test_missing_settings_file():
    with pytest.raises(UserError, match='nowhere'):
        load_settings('nowhere/pmac.yaml')


def test_listing_understands_the_forms_of_the_manual():
    listing = parse_listing("""
        ; a comment
        I130=2000 i131 = $7D0   // hexadecimal
        I133..135=1
        I136=-1.25I137=.5
        I230,2,100=3000
        I134=*  I139 = -$1
        I130=2100
    """)
    assert listing.problems == []
    assert listing.settings == {
        'y_linear': {
            'Ixx30': 2100,
            'Ixx31': 2000,
            'Ixx33': 1,
            'Ixx34': 1,
            'Ixx35': 1,
            'Ixx36': -1.25,
            'Ixx37': 0.5,
            'Ixx39': -1.0,
        },
        'x_rotate': {'Ixx30': 3000},
        'y_rotate': {'Ixx30': 3000},
    }


@pytest.mark.parametrize(
    ('statement', 'reason'),
    [
        ('I130=8388608', 'range'),
        ('I134=2', 'range'),
        ('I130=1.5', 'whole'),
        ('I199=1', 'Ixx99'),
        ('I5=1', 'I5 belongs to no motor'),
        ('I430=1', 'motor 4'),
        ('I6800=1', 'belongs to no motor'),
        ('I130=I131*2', 'expressions'),
        ('I103=$3501', '$3501'),
        ('I135..133=0', 'I-variables'),
        ('I130,3,0=0', 'distance'),
        ('P1=3', 'no assignment'),
        ('OPEN PLC 1 CLEAR', 'no assignment'),
        ('I138..141=0', 'Ixx40 is not part of this servo; it is not used here (and 1 more'),
    ],
)
def test_what_a_listing_cannot_set_is_reported_with_its_line_and_the_rest_holds(statement, reason):
    listing = parse_listing(f'I131=7\n\n  {statement} ; why\nI132=8')
    (problem,) = listing.problems
    assert problem.line == 3
    assert problem.text == statement
    assert reason in problem.reason
    assert str(problem).startswith('line 3: ')
    expected = {'Ixx31': 7, 'Ixx32': 8}
    if '..141' in statement:
        expected |= {'Ixx38': 0.0, 'Ixx39': 0.0}
    assert listing.settings == {'y_linear': expected}


def test_addresses_of_the_conversion_table_become_encoders():
    listing = parse_listing('I303=$3503 I304=$3504', {0x3503: 2, 0x3504: 3})
    assert listing.settings == {'y_rotate': {'Ixx03': 2, 'Ixx04': 3}}


def test_listing_and_yaml_give_the_same_settings(tmp_path):
    lines = []
    for motor, (_, values) in enumerate(load_settings(SHIPPED).settings.items(), start=1):
        for name, value in values.items():
            if name.startswith('Ixx'):
                lines.append(f'I{motor}{name[3:]}={value}')
    path = tmp_path / 'machine.cfg'
    path.write_text('\n'.join(lines))
    listing = load_settings(path)
    assert listing.problems == []
    for axis, values in load_settings(SHIPPED).settings.items():
        expected = {name: value for name, value in values.items() if name.startswith('Ixx')}
        assert listing.settings[axis] == expected


@settings(max_examples=100, deadline=None)
@given(st.text(alphabet='I0123456789.,=$*+- ;/\nAP%', max_size=60))
def test_any_text_is_a_listing_with_its_problems_told(text):
    listing = parse_listing(text)
    servo_parameters(listing.settings)
    lines = text.splitlines()
    for problem in listing.problems:
        assert problem.text in lines[problem.line - 1]


FOUR = Layout(
    ('lift', 'shoulder', 'elbow', 'wrist'),
    ('lift', 'shoulder_load', 'shoulder_motor', 'elbow', 'wrist'),
)


def test_motors_are_the_axes_of_the_machine_and_encoders_its_own():
    p = servo_parameters({'wrist': {'Ixx30': 7}}, 'arm', FOUR)[0]
    assert p['Ixx30'].tolist() == [2000, 2000, 2000, 7]
    assert p['Ixx03'].tolist() == [0, 1, 3, 4]  # position by the load's encoder
    assert p['Ixx04'].tolist() == [0, 2, 3, 4]  # velocity by the motor's
    listing = parse_listing('I430=9 I530=1 I203=4 I204=5', layout=FOUR)
    assert listing.settings == {'wrist': {'Ixx30': 9}, 'shoulder': {'Ixx03': 4}}
    reasons = [problem.reason for problem in listing.problems]
    assert reasons[0] == 'motor 5 is not used here; motors 1 to 4 are lift, shoulder, elbow, wrist'
    assert '4 wrist' in reasons[1]
    yaml = '/**/pmac: {ros__parameters: {wrist: {Ixx30: 3}, experiment: step}}'
    assert parse_yaml(yaml, 'arm.yaml', FOUR) == {'wrist': {'Ixx30': 3}}


@pytest.mark.parametrize('name', ['Ixx03', 'Ixx04'])
def test_an_encoder_that_the_machine_lacks_is_refused(name):
    """The servo reads it unchecked."""
    with pytest.raises(UserError, match=f'{name} is 5; the range is 0 to 4'):
        servo_parameters({'lift': {name: 5}}, 'arm', FOUR)
    with pytest.raises(UserError, match="'y_linear' is no axis; the axes are lift, shoulder"):
        servo_parameters({'y_linear': {name: 0}}, 'arm', FOUR)
