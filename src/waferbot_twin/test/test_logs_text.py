# SPDX-License-Identifier: Apache-2.0
"""Text logs: any dialect reads back to the bit; what is damaged is left out with its place."""

from __future__ import annotations

import csv
import gzip
import io
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.mapping import mapping_text
from waferbot_twin.logs.text import read_text

MAPPING = """
time: {column: t, unit: s}
signals:
  - {column: pos, kind: position, axis: x_rotate, unit: rad}
  - {column: cur, kind: current, axis: x_rotate, unit: A}
"""

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


def written(rows, delimiter=',', header=('t', 'pos', 'cur'), decimal='.', before=()):
    """Return rows as the csv module writes them."""
    text = io.StringIO()
    writer = csv.writer(text, delimiter=delimiter, lineterminator='\n')
    if header:
        writer.writerow(header)
    for row in rows:
        writer.writerow([repr(float(value)).replace('.', decimal) for value in row])
    return ''.join(f'{line}\n' for line in before) + text.getvalue()


def motion(count=50, step_s=0.001):
    time = np.arange(count) * step_s
    return np.column_stack([time, np.sin(40.0 * time), 0.5 * np.cos(33.0 * time)])


def load(tmp_path, text, mapping=MAPPING):
    path = tmp_path / 'log.csv'
    path.write_text(text, 'utf-8')
    return load_log(path, mapping_text(mapping))


def said(log):
    return '\n'.join(str(finding) for finding in log.findings)


@settings(deadline=None, max_examples=60)
@given(
    values=st.lists(st.tuples(numbers, numbers), min_size=20, max_size=60),
    start=st.floats(-100.0, 100.0),
    dialect=st.sampled_from(
        [(',', '.'), (';', '.'), (';', ','), ('\t', '.'), ('\t', ','), ('|', ','), (' ', '.')]
    ),
    told=st.booleans(),
    named=st.booleans(),
    before=st.lists(
        st.sampled_from(['Trace export', 'Sample Time: 0.0625 ms', '# 1 2 3', '', '1000']),
        max_size=4,
    ),
)
def test_any_dialect_reads_back_to_the_bit(
    tmp_path_factory, values, start, dialect, told, named, before
) -> None:
    delimiter, decimal = dialect
    time = start + np.arange(len(values)) / 1024.0
    rows = np.column_stack([time, np.array(values)])
    header = ('t', 'pos', 'cur') if named else None
    path = tmp_path_factory.mktemp('dialect') / 'log.txt'
    path.write_text(written(rows, delimiter, header, decimal, before))
    options = {'decimal': decimal}
    if told:
        options['delimiter'] = delimiter
    table = read_text(path, options)
    assert table.values.tobytes() == rows.tobytes()
    assert table.names == (['t', 'pos', 'cur'] if named else ['', '', ''])
    assert not table.findings


@settings(deadline=None, max_examples=60)
@given(cut=st.integers(0, 3000))
def test_a_cut_off_file_gives_what_was_whole_and_nothing_else(tmp_path_factory, cut) -> None:
    rows = motion()
    text = written(rows)
    path = tmp_path_factory.mktemp('cut') / 'log.csv'
    path.write_text(text[:cut])
    whole = text[:cut].count('\n') - 1
    if whole < 16:
        with pytest.raises(UserError):
            load_log(path, mapping_text(MAPPING))
        return
    log = load_log(path, mapping_text(MAPPING))
    position = log['x_rotate', 'position']
    assert position.time_s.tobytes() == rows[:whole, 0].tobytes()
    assert position.value.tobytes() == rows[:whole, 1].tobytes()
    if cut < len(text) and text[cut - 1] != '\n':
        assert f'line {whole + 2}' in said(log)


@settings(deadline=None, max_examples=150)
@given(
    places=st.lists(st.tuples(st.integers(0, 3000), st.binary(min_size=0, max_size=6)), max_size=8)
)
def test_a_corrupt_file_is_no_crash_and_keeps_the_rules(tmp_path_factory, places) -> None:
    data = bytearray(written(motion()).encode())
    for place, junk in places:
        data[place : place + 3] = junk
    path = tmp_path_factory.mktemp('corrupt') / 'log.csv'
    path.write_bytes(bytes(data))
    try:
        log = load_log(path, mapping_text(MAPPING))
    except UserError:
        return  # a message for the user; anything else fails the test
    for signal in log.signals:
        assert len(signal.time_s) >= 16
        assert np.all(np.diff(signal.time_s) > 0.0)
        assert np.all(np.isfinite(signal.value))


def test_broken_lines_are_left_out_and_named(tmp_path) -> None:
    rows = motion()
    lines = written(rows).splitlines()
    lines[10] = '0.009,0.35'
    lines[20] = '0.019,oops,0.1'
    lines[30] = 'end of part one'
    log = load(tmp_path, '\n'.join(lines) + '\n')
    position, current = log['x_rotate', 'position'], log['x_rotate', 'current']
    assert len(position.time_s) == 50 - 3
    assert len(current.time_s) == 50 - 2
    text = said(log)
    assert "line 21: 'oops' in column 2 is no number" in text
    assert 'line 11 and 1 more up to ' in text
    assert 'line 31: 2 cells instead of 3' in text


def test_a_packed_file_is_unpacked_and_a_broken_one_told(tmp_path) -> None:
    text = written(motion())
    packed = gzip.compress(text.encode())
    path = tmp_path / 'log.csv.gz'
    path.write_bytes(packed)
    plain, unpacked = load(tmp_path, text), load_log(path, mapping_text(MAPPING))
    for signal in plain.signals:
        assert unpacked[signal.axis, signal.kind].value.tobytes() == signal.value.tobytes()
    for broken in (packed[: len(packed) // 2], packed[:20] + b'nonsense' + packed[28:]):
        path.write_bytes(broken)
        with pytest.raises(UserError, match=r'broken \.gz'):
            load_log(path, mapping_text(MAPPING))


def test_missing_numbers_leave_only_their_signal(tmp_path) -> None:
    lines = written(motion()).splitlines()
    lines[5] = '0.004,,0.5'
    lines[6] = '0.005,NaN,0.5'
    lines[7] = '0.006,inf,0.5'
    log = load(tmp_path, '\n'.join(lines) + '\n')
    assert len(log['x_rotate', 'position'].time_s) == 47
    assert len(log['x_rotate', 'current'].time_s) == 50
    assert 'line 6 and 2 more up to' in said(log)
    assert log['x_rotate', 'position'].gaps() == [(0.003, 0.007)]


def test_a_left_out_line_does_not_move_what_follows(tmp_path) -> None:
    """With a sample time, a broken line is a gap; blank lines and remarks are not samples."""
    rows = motion()
    lines = written(rows[:, 1:], header=('pos', 'cur')).splitlines()
    lines[10] = 'broken'
    lines.insert(20, '# remark')
    lines.insert(30, '')
    mapping = MAPPING.replace('column: t, unit: s', 'sample_time_s: 0.001')
    log = load(tmp_path, '\n'.join(lines) + '\n', mapping)
    position = log['x_rotate', 'position']
    kept = np.delete(np.arange(50), 9)
    assert position.time_s == pytest.approx(kept * 0.001, abs=1e-15)
    assert position.value.tobytes() == rows[kept, 1].tobytes()


def test_header_block_of_a_drive_export(tmp_path) -> None:
    text = 'Drive Trace\r\nSample Time (us): 62.5\r\n\r\n'
    text += '"Time (ms)","Motor Position, (counts)","Actual Current (A)"\r\n'
    rows = motion()
    text += ''.join(f'{1e3 * t},{round(1000 * p)},{c}\r\n' for t, p, c in rows)
    mapping = """
machine: direct_drive_motor
time: {column: Time (ms), unit: ms}
signals:
  - {column: 'Motor Position, (counts)', kind: position, axis: x_rotate, unit: counts, sign: -1}
  - {column: actual current (a), kind: current, axis: x_rotate, unit: A_rms}
"""
    log = load(tmp_path, text, mapping)
    position = log['x_rotate', 'position']
    assert position.value == pytest.approx(-np.round(1000 * rows[:, 1]) * 2 * np.pi / 8192)
    assert position.resolution == pytest.approx(2 * np.pi / 8192)
    assert log['x_rotate', 'current'].value == pytest.approx(rows[:, 2] * np.sqrt(2.0))
    assert not log.findings


def test_pmac_control_csv_with_its_trailing_comma(tmp_path) -> None:
    text = (
        'point,CH0 Axis1 Motor present desired position,CH1 Axis1 Motor present actual position,\n'
    )
    text += ''.join(f'{k},{100 + k}.000000,{99 + k}.500000,\n' for k in range(40))
    path = tmp_path / 'gather.csv'
    path.write_text(text)
    table = read_text(path)
    assert table.values.shape == (40, 3)
    assert table.column('CH1 Axis1 Motor present actual position').value[3] == 102.5


@pytest.mark.parametrize('encoding', ['utf-8-sig', 'utf-16', 'latin-1'])
def test_encodings_of_windows_programs(tmp_path, encoding) -> None:
    path = tmp_path / 'log.csv'
    path.write_bytes(written(motion(), header=('t', 'µm', 'cur')).encode(encoding))
    table = read_text(path)
    assert table.names == ['t', 'µm', 'cur']
    assert len(table.values) == 50


@pytest.mark.parametrize(
    ('text', 'wanted'),
    [
        ('', 'is empty'),
        ('no numbers here\nat all\n', 'no line of numbers'),
        ('1,5;2,5;3,5\n' * 30, 'options.decimal'),
    ],
)
def test_files_without_numbers(tmp_path, text, wanted) -> None:
    with pytest.raises(UserError, match=wanted):
        load(tmp_path, text)


def test_column_that_is_not_there(tmp_path) -> None:
    mapping = MAPPING.replace('column: pos', 'column: poss')
    with pytest.raises(UserError, match=r"no column 'poss'; did you mean 'pos'"):
        load(tmp_path, written(motion()), mapping)
    with pytest.raises(UserError, match='has no column 7; it has 3'):
        load(tmp_path, written(motion()), MAPPING.replace('column: pos', 'column: 7'))


def test_too_short(tmp_path) -> None:
    with pytest.raises(UserError, match='10 samples; fewer than 16'):
        load(tmp_path, written(motion(10)))


def test_window(tmp_path) -> None:
    log = load(tmp_path, written(motion()), MAPPING + 'options: {start_s: 0.01, end_s: 0.03}\n')
    position = log['x_rotate', 'position']
    assert (position.time_s[0], position.time_s[-1], len(position.time_s)) == (0.01, 0.03, 21)
    with pytest.raises(UserError, match=r'the signal goes from 0 to 0\.049 s'):
        load(tmp_path, written(motion()), MAPPING + 'options: {start_s: 7.0}\n')


def test_other_ends_than_those_of_the_mapping(tmp_path) -> None:
    path = tmp_path / 'log.csv'
    path.write_text(written(motion()), 'utf-8')
    mapping = mapping_text(MAPPING + 'options: {start_s: 0.01, end_s: 0.03}\n')
    position = load_log(path, mapping, span_s=(None, 0.04))['x_rotate', 'position']
    assert (position.time_s[0], position.time_s[-1]) == (0.01, 0.04)
    for span_s, said in (((0.05, None), 'later than --start'), ((math.nan, None), 'be a time')):
        with pytest.raises(UserError, match=said):
            load_log(path, mapping, span_s=span_s)


def test_calendar_times_start_at_zero(tmp_path) -> None:
    rows = motion()
    rows[:, 0] = 1.7e9 + 0.25 + np.arange(50) / 64.0
    log = load(tmp_path, written(rows))
    assert log.origin_ns == 1_700_000_000 * 10**9
    assert log['x_rotate', 'position'].time_s[0] == 0.25


def test_companion_file(tmp_path) -> None:
    (tmp_path / 'axis_measured.csv').write_text(written(motion()))
    mapping = mapping_text(
        MAPPING
        + '  - {column: pos, kind: commanded_position, axis: x_rotate, unit: rad, in: companion}\n'
        + 'companion: {replace: measured, by: desired}\n'
    )
    alone = load_log(tmp_path / 'axis_measured.csv', mapping)
    assert alone.get('x_rotate', 'commanded_position') is None
    assert 'axis_desired.csv' in said(alone)
    assert 'without x_rotate.commanded_position' in said(alone)
    (tmp_path / 'axis_desired.csv').write_text(written(motion(30, 0.002)))
    both = load_log(tmp_path / 'axis_measured.csv', mapping)
    assert len(both['x_rotate', 'commanded_position'].time_s) == 30
