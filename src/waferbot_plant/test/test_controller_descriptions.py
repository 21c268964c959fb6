# SPDX-License-Identifier: Apache-2.0
"""Controllers in a description: what is read, in which unit, and what is refused where."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from waferbot_lockstep.errors import UserError
from waferbot_plant.description_controllers import DRIVE_GAINS, KEYS, _with_unit
from waferbot_plant.description_file import load_description
from waferbot_plant.plant import find_description

CASCADE = {
    'kind': 'cascade',
    'rate_hz': 2000,
    'output': 'V',
    'drive_gain_nm': 0.5,
    'output_limit': 10,
    'delay_ms': 0.25,
    'position_gain_1_s': 40,
    'velocity_limit_rad_s': 30,
    'velocity_gain_s_per_rad': 0.2,
    'velocity_integral_gain_per_rad': 3,
    'velocity_filter_hz': 400,
    'velocity_feedforward': 0.9,
    'integral_limit': 4,
}


def described(values, tmp_path, machine='direct_drive_motor', axis='x_rotate'):
    lines = [f'extends: {find_description(machine)}', 'controllers:', f'  {axis}:']
    lines += [f'    {key}: {value}' for key, value in values.items()]
    file = tmp_path / 'machine.yaml'
    file.write_text('\n'.join(lines), 'utf-8')
    return load_description(file).controllers[axis]


def test_every_key_arrives_in_si_units(tmp_path) -> None:
    found = described(CASCADE, tmp_path)
    assert (found.rate, found.output, found.drive_gain, found.drive_unit) == (2000, 'V', 0.5, 'Nm')
    assert found.delay == pytest.approx(0.25e-3)
    assert (found.position_gain, found.velocity_gain) == (40.0, 0.2)
    assert (found.velocity_integral, found.velocity_filter) == (3.0, 400.0)
    assert (found.velocity_limit, found.output_limit, found.integral_limit) == (30.0, 10.0, 4.0)
    assert found.velocity_feedforward == 0.9
    assert found.position_integral_limit == math.inf
    assert found.anti_windup == 'conditional'
    assert found.integrates
    pid = {
        'kind': 'pid', 'rate_hz': 1000, 'output': 'N', 'proportional_gain_per_m': 5.0,
        'integral_gain_per_m_s': 6.0, 'derivative_gain_s_per_m': 7.0, 'derivative_filter_hz': 90,
        'derivative_of': 'position', 'anti_windup': 'back_calculation', 'tracking_time_ms': 20,
        'velocity_feedforward_s_per_m': 8.0, 'acceleration_feedforward_s2_per_m': 9.0,
    }  # fmt: skip
    found = described(pid, tmp_path, 'single_mass', 'y_linear')
    assert (found.proportional, found.integral, found.derivative) == (5.0, 6.0, 7.0)
    assert (found.derivative_filter, found.derivative_of) == (90.0, 'position')
    assert (found.velocity_feedforward, found.acceleration_feedforward) == (8.0, 9.0)
    assert found.tracking_time == pytest.approx(0.02)
    assert (found.drive_gain, found.drive_unit) == (1.0, 'N')


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'velocity_gain_s_per_m': 1.0}, r'line 17.*wrong unit.*velocity_gain_s_per_rad'),
        ({'proportional_gain_per_rad': 1.0}, 'kind cascade has no such key'),
        ({'velocity_gian': 1.0}, 'did you mean'),
        ({'kind': 'lqg'}, 'must be one of p, pi, pid, cascade'),
        ({'position_gain_1_s': None}, 'position_gain_1_s missing'),
        ({'drive_gain_nm': None}, 'what the drive makes of 1 V'),
        ({'drive_gain_a': 1.0}, 'give one of drive_gain_a'),
        ({'drive_gain_nm': None, 'drive_gain_n': 1.0}, 'the axis turns; give Nm'),
        ({'output': 'A'}, 'drives the axis by itself'),
        ({'output': 'N', 'drive_gain_nm': None}, 'the axis turns; give Nm'),
        ({'rate_hz': 2.0e6}, 'at most'),
        ({'rate_hz': 0}, 'greater than 0'),
        ({'anti_windup': 'back_calculation'}, 'tracking_time_ms go together'),
        ({'tracking_time_ms': 5}, 'tracking_time_ms go together'),
        ({'output_limit': -1}, 'greater than 0'),
    ],
)
def test_what_is_wrong_is_said_with_its_place(changes, message, tmp_path) -> None:
    values = {key: value for key, value in (CASCADE | changes).items() if value is not None}
    with pytest.raises(UserError, match=message) as error:
        described(values, tmp_path)
    assert 'machine.yaml' in str(error.value)
    assert 'controllers.x_rotate' in str(error.value)


def test_a_controller_needs_its_axis_and_its_motor(tmp_path) -> None:
    with pytest.raises(UserError, match="no axis 'y_rotate'"):
        described(CASCADE, tmp_path, axis='y_rotate')


def test_how_an_encoder_counts_is_read(tmp_path) -> None:
    file = tmp_path / 'machine.yaml'
    text = f'extends: {find_description("direct_drive_motor")}\n'
    text += 'encoders: {x_rotate: {counting: floor}}\n'
    file.write_text(text, 'utf-8')
    assert load_description(file).encoders['x_rotate'].counting == 'floor'
    file.write_text(text.replace('floor', 'truncate'), 'utf-8')
    with pytest.raises(UserError, match='floor, round, average'):
        load_description(file)


def test_the_page_has_every_key() -> None:
    page = (Path(__file__).parents[3] / 'docs' / 'controllers.md').read_text('utf-8')
    for name in {name for keys in KEYS.values() for name in keys} - {*DRIVE_GAINS}:
        assert f'`{_with_unit(name, False)}`' in page, name
