# SPDX-License-Identifier: Apache-2.0
"""Mapping files: what they turn numbers into, and errors that name file, line and key."""

from __future__ import annotations

import math

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.mapping import example_mappings, load_mapping, mapping_text

GOOD = """\
machine: geared_pendulum
time: {column: 1, unit: s}
signals:
  - column: 2
    kind: position
    axis: y_rotate
    unit: deg
  - column: 3
    kind: torque
    axis: y_rotate
    unit: mNm
"""

TORQUE = GOOD[GOOD.index('kind: torque') :]

WRONG = [
    ('kind: position', 'kind: positon', 5, "no kind 'positon'; did you mean 'position'"),
    ('unit: deg', 'unit: mm', 7, 'wrong unit: mm is for length, but position of y_rotate (which turns)'),
    ('unit: deg', 'unit: dge', 7, "no unit 'dge'; did you mean 'deg'"),
    ('unit: mNm', 'unit: A', 11, 'wrong unit: A is for current, but force'),
    ('unit: mNm', 'unit: counts', 11, 'wrong unit: force has none in counts'),
    ('axis: y_rotate', 'axis: z_rotate', 6, "no axis 'z_rotate'; did you mean 'y_rotate'"),
    ('column: 2', 'colum: 2', 4, "unknown key; did you mean 'column'"),
    ('column: 2', 'column: 0', 4, 'must be'),
    ('unit: s}', 'unit: hours}', 2, 'must be one of s, ms'),
    ('unit: s}', 'unit: servo_cycle}', 2, 'servo_cycle needs I10 or servo_cycle_s'),
    (', unit: s}', '}', 2, 'give the unit of the time column'),
    ('column: 1, unit: s', 'unit: s', 2, 'belongs to a time column'),
    ('column: 1, unit: s', 'I5049: 2', 2, 'needs I10 or servo_cycle_s'),
    ('machine: geared_pendulum', 'machine: geared_pendulm', 1, "did you mean 'geared_pendulum'"),
    (TORQUE, TORQUE.replace('torque', 'position').replace('mNm', 'rad'), 8, 'given twice'),
    ('unit: mNm', 'unit: mNm\n    in: companion', 12, 'there is no key companion'),
    ('column: 3', "column: 'data{$part}'", 8, '$part needs the key part'),
    ('unit: mNm', 'unit: mNm\n    scale: 0', 12, 'must not be zero'),
    ('unit: mNm', 'unit: mNm\noptions: {decimal: ",", delimiter: ","}', 12, 'cannot be the decimal'),
    ('unit: mNm', 'unit: mNm\noptions: {start_s: 2, end_s: 1}', 12, 'later than start_s'),
]  # fmt: skip


def test_the_good_one_is_good() -> None:
    assert [s.kind for s in mapping_text(GOOD).signals] == ['position', 'force']


@pytest.mark.parametrize(('old', 'new', 'line', 'message'), WRONG)
def test_errors_name_line_and_key(tmp_path, old, new, line, message) -> None:
    path = tmp_path / 'map.yaml'
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(UserError) as caught:
        load_mapping(path)
    assert f'{path}, line {line}' in str(caught.value)
    assert message in str(caught.value)


def test_counts_need_a_machine() -> None:
    text = GOOD.replace('unit: deg', 'unit: counts')
    assert mapping_text(text).signals[0].conversion.factor == pytest.approx(
        191.0 / 65535.0, rel=1e-6
    )
    with pytest.raises(UserError, match='counts need the machine'):
        mapping_text(text.replace('machine: geared_pendulum\n', ''))
    second = text.replace('kind: position', 'kind: motor_position')
    with pytest.raises(UserError, match='has no encoder y_rotate_motor'):
        mapping_text(second)


@settings(deadline=None, max_examples=60)
@given(
    unit=st.sampled_from(
        [('rad', 1.0), ('mrad', 1e-3), ('deg', math.pi / 180), ('arcmin', math.pi / 10800)]
    ),
    sign=st.sampled_from([1, -1]),
    scale=st.floats(0.1, 10.0) | st.floats(-10.0, -0.1),
    divide_by=st.floats(0.5, 5000.0),
    offset=st.floats(-5.0, 5.0),
    delay_s=st.floats(-0.01, 0.01),
)  # fmt: skip
def test_any_mapping_is_undone_by_writing_what_it_says(
    tmp_path_factory, unit, sign, scale, divide_by, offset, delay_s
) -> None:
    """Columns are made from SI values by the formula of the documentation, solved for the column."""
    name, factor = unit
    time = np.arange(40) / 256.0
    value = np.sin(40.0 * time)
    column = (sign * value / factor - offset) * divide_by / scale
    entry = {'column': 'p', 'kind': 'position', 'axis': 'x_rotate', 'unit': name, 'sign': sign,
             'scale': scale, 'divide_by': divide_by, 'offset': offset, 'delay_s': delay_s}  # fmt: skip
    drive = {'column': 'f', 'kind': 'drive_command', 'axis': 'x_rotate', 'unit': '%'}
    mapping = {'time': {'column': 't', 'unit': 'ms'}, 'signals': [entry, drive]}
    path = tmp_path_factory.mktemp('map') / 'log.csv'
    rows = np.column_stack([1e3 * (time + delay_s), column, 50.0 * value])
    np.savetxt(path, rows, '%.17g', ',', header='t,p,f', comments='')
    log = load_log(path, mapping_text(yaml.safe_dump(mapping)))
    position = log['x_rotate', 'position']
    assert position.value == pytest.approx(value, abs=1e-12 * (1.0 + factor * abs(offset)))
    assert position.time_s == pytest.approx(time, abs=1e-15)
    assert log['x_rotate', 'drive_command'].value == pytest.approx(0.5 * value, abs=1e-15)


def test_wrapping_positions_run_on(tmp_path) -> None:
    time = np.arange(100) / 100.0
    angle = 25.0 * time - 3.0
    path = tmp_path / 'log.csv'
    np.savetxt(
        path, np.column_stack([time, np.degrees(angle) % 360.0, np.sin(angle)]), '%.17g', ','
    )
    text = GOOD.replace('unit: deg', 'unit: deg\n    wraps_at: 360')
    log = load_log(path, mapping_text(text))
    value = log['y_rotate', 'position'].value
    assert value - value[0] == pytest.approx(angle - angle[0], abs=1e-12)


def test_sample_time_beside_a_time_column_is_checked(tmp_path) -> None:
    time = np.arange(100) / 100.0
    path = tmp_path / 'log.csv'
    np.savetxt(path, np.column_stack([time, np.sin(time), np.cos(time)]), '%.17g', ',')
    wrong = GOOD.replace('unit: s}', 'unit: s, sample_time_s: 0.005}')
    said = [str(finding) for finding in load_log(path, mapping_text(wrong)).findings]
    assert any('samples are 0.01 s apart' in text and 'says 0.005 s' in text for text in said)
    right = GOOD.replace('unit: s}', 'unit: s, sample_time_s: 0.01}')
    assert not load_log(path, mapping_text(right)).findings


def test_shipped_mappings_are_valid_and_found_by_name() -> None:
    names = list(example_mappings())
    assert {'dfki_pendulum', 'odrive_slow_velocity', 'odrive_spinup'} <= set(names)
    for name in names:
        assert load_mapping(name).signals
    with pytest.raises(UserError, match="did you mean 'dfki_pendulum'"):
        load_mapping('dfki_pendulm')


def test_nothing_usable_says_what_is_missing(tmp_path) -> None:
    path = tmp_path / 'log.csv'
    time = np.arange(100) / 100.0
    np.savetxt(path, np.column_stack([time, np.sin(time), np.cos(time)]), '%.17g', ',')
    alone = GOOD[: GOOD.index('  - column: 3')]
    with pytest.raises(UserError, match=r'needs, of one axis(.|\n)*usable is y_rotate\.position'):
        load_log(path, mapping_text(alone))


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 10**9) | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=5,
)
KEYS = ['machine', 'name', 'format', 'time', 'part', 'companion', 'options', 'gather', 'signals']


@settings(deadline=None, max_examples=200)
@given(key=st.sampled_from(KEYS), junk=JUNK)
def test_junk_in_a_mapping_is_the_users_error(key, junk) -> None:
    data = yaml.safe_load(GOOD) | {key: junk}
    try:
        mapping = mapping_text(yaml.safe_dump(data))
    except UserError:
        return  # a message for the user; anything else fails the test
    assert mapping.signals


@settings(deadline=None, max_examples=200)
@given(
    part=st.sampled_from(
        ['column', 'kind', 'axis', 'unit', 'sign', 'scale', 'wraps_at', 'delay_s']
    ),
    junk=JUNK,
)
@example(part='column', junk=1.0)
def test_junk_in_a_signal_is_the_users_error(tmp_path_factory, part, junk) -> None:
    data = yaml.safe_load(GOOD)
    data['signals'][0][part] = junk
    path = tmp_path_factory.mktemp('junk') / 'log.csv'
    time = np.arange(40) / 100.0
    np.savetxt(path, np.column_stack([time, time, time]), '%.17g', ',')
    try:
        log = load_log(path, mapping_text(yaml.safe_dump(data)))
    except UserError:
        return
    assert np.isfinite(log['y_rotate', 'position'].value).all()
