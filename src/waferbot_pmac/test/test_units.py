# SPDX-License-Identifier: Apache-2.0
"""What an axis is measured in is told by who knows the machine; its name decides nothing."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.contract import AXES, USUAL_UNITS, usual_axis
from waferbot_lockstep.errors import UserError
from waferbot_pmac.compensation import load_tables, offsets, parse_tables
from waferbot_pmac.experiments import check_units, commanded_positions, load_experiment, suits
from waferbot_pmac.i_variables import servo_parameters
from waferbot_pmac.user_units import parse_units, units_text

RATE = 2250.0
SLIDING = dict.fromkeys(AXES, 'm')
COUNTS = 5e5
PARAMETERS = servo_parameters({'x_rotate': {'counts_per_unit': COUNTS}})
STEP = """name: slide
duration_s: 0.1
motion:
  x_rotate: {kind: step, start_s: 0.02, amplitude_m: 2.0e-4}
"""
MOVE = """name: move
duration_s: 4.0
program:
  - {dwell_s: 0.1}
  - {rapid: {x_rotate_m: 0.01, y_linear_m: 0.01}}
"""


def test_an_axis_that_slides_is_commanded_in_metres():
    path = commanded_positions(load_experiment(STEP), PARAMETERS, RATE, SLIDING)
    assert path[-1].tolist() == [0.0, 2e-4 * COUNTS, 0.0]
    path = commanded_positions(load_experiment(MOVE), PARAMETERS, RATE, SLIDING)
    assert path[-1, 1] == 0.01 * COUNTS


@pytest.mark.parametrize(
    ('text', 'place'),
    [(STEP, 'line 4: motion.x_rotate.amplitude_m'), (MOVE, 'line 5: program[1].rapid.x_rotate_m')],
)
def test_the_wrong_unit_is_refused_with_its_place(text, place):
    experiment = load_experiment(text)
    assert suits(experiment, SLIDING)
    assert not suits(experiment, USUAL_UNITS)
    for refused in (
        lambda: check_units(experiment, USUAL_UNITS),
        lambda: commanded_positions(experiment, PARAMETERS, RATE),
    ):
        with pytest.raises(UserError) as caught:
            refused()
        assert place in str(caught.value)
        assert 'x_rotate is measured in rad or counts' in str(caught.value)


def test_speeds_and_counts_are_told_apart_from_lengths():
    text = (
        'name: a\nduration_s: 1\nmotion:\n'
        '  x_rotate: {kind: jog, distance_counts: 100, speed_m_per_s: 0.1}\n'
    )
    assert suits(load_experiment(text), SLIDING)
    assert not suits(load_experiment(text), USUAL_UNITS)
    assert suits(load_experiment(text.replace('m_per_s', 'rad_per_s')), USUAL_UNITS)


def test_tables_are_over_metres_of_an_axis_that_slides():
    text = 'axis,over,at,current_a\nx_rotate,position_m,0,0\nx_rotate,position_m,0.1,4\n'
    tables = parse_tables(text, 'tables.csv', SLIDING)
    at = np.zeros((3, 3))
    at[:, 1] = COUNTS * np.array([0.0, 0.025, 0.1])
    found = offsets(tables, 'any', at, PARAMETERS, RATE)[:, 1]
    assert found == pytest.approx(32768 / 40 * np.array([0.0, 1.0, 4.0]), rel=1e-6)
    with pytest.raises(UserError, match="x_rotate cannot be over 'position_m'"):
        load_tables(text)


def test_the_node_is_told_by_text():
    assert units_text() == 'm rad rad'
    assert parse_units(units_text(SLIDING)) == SLIDING
    assert parse_units('m rad rad') == USUAL_UNITS
    for wrong in ('', 'm rad', 'm rad deg', 'm rad rad m'):
        with pytest.raises(UserError, match='m or rad of y_linear, x_rotate, y_rotate'):
            parse_units(wrong)


def test_numbers_of_the_shipped_machine_are_those_of_the_axis_with_the_unit():
    assert [usual_axis(axis, 'm') for axis in AXES] == ['y_linear'] * 3
    assert [usual_axis(axis, 'rad') for axis in AXES] == ['x_rotate', 'x_rotate', 'y_rotate']
