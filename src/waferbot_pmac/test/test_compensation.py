# SPDX-License-Identifier: Apache-2.0
"""Compensation tables: what is read, what is refused, and what the servo is given."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_pmac.compensation import load_tables, offsets, parse_tables, table_text
from waferbot_pmac.i_variables import servo_parameters

HEADER = 'axis,over,at,current_a\n'
SETTINGS = {
    'y_linear': {'counts_per_unit': 1e6, 'amplifier_peak_current': 40.0, 'Ixx08': 96},
    'x_rotate': {'counts_per_unit': 1000.0, 'amplifier_peak_current': 20.0, 'Ixx08': 96},
}


def tables(*lines):
    return parse_tables(HEADER + '\n'.join(lines) + '\n', 'tables.csv')


def amperes(made, commanded, experiment='', rate_hz=1000.0):
    """Return what the tables add, A, for commanded positions (cycles, 3) in counts."""
    parameters = servo_parameters(SETTINGS)
    added = offsets(made, experiment, np.asarray(commanded, float), parameters, rate_hz)
    return added * parameters['amplifier_peak_current'][0] / 32768.0


def test_between_two_lines_the_current_is_interpolated_and_held_outside():
    made = tables('y_linear,position_m,0,1', 'y_linear,position_m,0.1,3')
    commanded = np.zeros((4, 3))
    commanded[:, 0] = [-5e4, 2.5e4, 5e4, 2e5]  # -0.05, 0.025, 0.05, 0.2 m
    np.testing.assert_allclose(amperes(made, commanded)[:, 0], [1.0, 1.5, 2.0, 3.0])


def test_speed_is_the_change_of_the_commanded_position():
    made = tables('x_rotate,speed_rad_s,-1,-2', 'x_rotate,speed_rad_s,1,2')
    commanded = np.zeros((4, 3))
    commanded[:, 1] = [10.0, 10.5, 11.0, 10.0]  # counts; 1000 of them a rad, every millisecond
    np.testing.assert_allclose(amperes(made, commanded)[:, 1], [0.0, 1.0, 1.0, -2.0])


def test_a_jump_has_two_lines_at_one_place():
    made = tables(
        'y_linear,speed_m_s,-1,-3', 'y_linear,speed_m_s,0,-2', 'y_linear,speed_m_s,0,2',
        'y_linear,speed_m_s,1,3',
    )  # fmt: skip
    commanded = np.zeros((3, 3))
    commanded[:, 0] = [0.0, 500.0, 0.0]  # 0.5 m/s and back
    added = amperes(made, commanded)[:, 0]
    np.testing.assert_allclose(added[1:], [2.5, -2.5])


def test_tables_add_up_and_those_of_other_experiments_do_not_count():
    made = tables(
        'y_linear,position_m,0,1', 'y_linear,time_s:there,0,0', 'y_linear,time_s:there,0.01,10',
        'y_linear,time_s:elsewhere,0,99',
    )  # fmt: skip
    commanded = np.zeros((6, 3))
    np.testing.assert_allclose(amperes(made, commanded, 'there')[:, 0], 1.0 + np.arange(6))
    np.testing.assert_allclose(amperes(made, commanded)[:, 0], 1.0)


def test_text_of_tables_reads_back_alike():
    random = np.random.default_rng(4)
    made = tables(*(f'y_rotate,position_rad,{at},{random.normal()}' for at in range(20)))
    again = load_tables(table_text(made, 'a comment\nof two lines'))
    assert [(one.axis, one.over) for one in again] == [('y_rotate', 'position_rad')]
    np.testing.assert_allclose(again[0].current, made[0].current, rtol=1e-9)
    np.testing.assert_array_equal(again[0].at, made[0].at)


@pytest.mark.parametrize(
    ('text', 'named'),
    [
        ('axis,over,at\n', 'line 1: the columns are axis,over,at'),
        (HEADER + 'z_linear,position_m,0,1\n', "line 2: no axis 'z_linear'"),
        (HEADER + 'y_linear,position_rad,0,1\n', "cannot be over 'position_rad'"),
        (HEADER + 'y_linear,time_s,0,1\n', 'time_s:EXPERIMENT'),
        (HEADER + 'y_linear,position_m,zero,1\n', "at is 'zero'"),
        (HEADER + 'y_linear,position_m,0,nan\n', "current_a is 'nan'"),
        (HEADER + 'y_linear,position_m,0\n', '3 values; there must be 4'),
        (
            HEADER + 'y_linear,position_m,1,0\ny_linear,position_m,0,0\n',
            'line 3: 0 is below 1 of the line before',
        ),
        ('# nothing\n', 'no table'),
    ],
)
def test_what_is_wrong_is_named_with_its_line(text, named):
    with pytest.raises(UserError, match=r'tables\.csv') as raised:
        parse_tables(text, 'tables.csv')
    assert named in str(raised.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(UserError, match=r'gone\.csv'):
        load_tables(tmp_path / 'gone.csv')
