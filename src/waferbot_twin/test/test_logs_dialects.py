# SPDX-License-Identifier: Apache-2.0
"""
What loggers of motion write: a sample of each, made here in the documented form, reads back.

halscope: `src/hal/utils/scope_files.c` of LinuxCNC. TwinCAT Scope: Beckhoff Information System, export
to CSV. moteus and ODrive: what their Python interfaces name their values. candump: its brackets around
times, and a row for each decoded value.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs import parquet
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.mapping import mapping_text
from waferbot_twin.logs.measured import MeasuredLog

AXIS = 'x_rotate'
COUNT = 60
TIME = np.arange(COUNT) * 1e-3
ANGLE, CURRENT = np.sin(40.0 * TIME), 0.5 * np.cos(33.0 * TIME)  # rad, A


def read(tmp_path, text, mapping, name='log.csv') -> MeasuredLog:
    path = tmp_path / name
    path.write_text(text, 'utf-8')
    return load_log(path, mapping_text(mapping))


def is_the_motion(log, time_s=TIME, within=1e-9) -> None:
    for kind, value in (('position', ANGLE), ('current', CURRENT)):
        signal = log[AXIS, kind]
        assert signal.time_s == pytest.approx(time_s, abs=1e-9)
        assert signal.value == pytest.approx(value, abs=within)


def signals(position='position', current='current', angle='rad', more=''):
    return (
        'signals:\n'
        f'  - {{column: {position}, kind: position, axis: x_rotate, unit: {angle}{more}}}\n'
        f'  - {{column: {current}, kind: current, axis: x_rotate, unit: A{more}}}\n'
    )


# ---- scopes --------------------------------------------------------------------------------------


def halscope(period_ns=1_000_000):
    """Return what halscope writes: names and values by turns, and how long a sample is."""
    lines = [f'Sampling period is {period_ns} ns ', '']
    for angle, current in zip(ANGLE, CURRENT, strict=True):
        lines.append(f'joint.0.pos-fb {angle:+.14f} hm2_7i92.0.cur {current:+.14f} ')
    return '\n'.join(lines) + '\n'


def test_halscope_tells_its_names_and_its_time(tmp_path) -> None:
    mapping = signals('joint.0.pos-fb', 'hm2_7i92.0.cur')
    is_the_motion(read(tmp_path, halscope(), mapping))
    log = read(tmp_path, halscope(2_000_000), mapping)
    assert log[AXIS, 'position'].time_s == pytest.approx(2.0 * TIME)
    log = read(tmp_path, halscope(), 'time: {sample_time_s: 0.002}\n' + mapping)
    assert log[AXIS, 'position'].time_s == pytest.approx(2.0 * TIME)
    assert any('the mapping says 0.002 s' in str(finding) for finding in log.findings)


def test_a_line_of_halscope_that_is_cut_off_is_left_out(tmp_path) -> None:
    text = halscope().replace(f'{ANGLE[30]:+.14f} hm2', f'{ANGLE[30]:+.14f}\nhm2')
    log = read(tmp_path, text, signals('joint.0.pos-fb', 'hm2_7i92.0.cur'))
    assert len(log[AXIS, 'position'].value) == COUNT - 1


def twincat(separator='\t', decimal=',', one_time=False, every=1, end=True):
    """Return an export of TwinCAT Scope: a head, a head of each channel, values with their times."""

    def text(number):
        return f'{number:.9f}'.replace('.', decimal)

    heads = ('Name', 'File', 'Starttime of export', 'Endtime of export')
    lines = [f'{head}{separator}Axis 1' for head in heads] + ['']
    for name, own in (
        ('Name', ('ActPos', 'ActCurrent')),
        ('SymbolName', ('MAIN.fPos', 'MAIN.fCur')),
        ('Data-Type', ('REAL64', 'REAL64')),
        ('SampleTime[ms]', ('1', str(every))),
        ('VariableSize', ('8', '8')),
        ('Unit', ('', '')),
    ):
        cells = [name, *own] if one_time else [name, own[0], name, own[1]]
        lines.append(separator.join(cells))
    lines.append('')
    slow = range(0, COUNT, every)
    for row in range(COUNT):
        time = text(row)
        if one_time:
            cells = [time, text(ANGLE[row]), text(CURRENT[row])]
        elif row < len(slow):
            cells = [time, text(ANGLE[row]), text(slow[row]), text(CURRENT[slow[row]])]
        else:
            cells = [time, text(ANGLE[row]), '', '']
        lines.append(separator.join(cells))
    return '\n'.join([*lines, 'EOF'] if end else lines) + '\n'


@pytest.mark.parametrize(('separator', 'decimal'), [('\t', ','), (';', ','), (',', '.')])
def test_twincat_scope_names_its_channels_above_what_describes_them(
    tmp_path, separator, decimal
) -> None:
    mapping = (
        'time: {column: ActPos time, unit: ms}\n'
        f'options: {{decimal: "{decimal}"}}\n' + signals('ActPos', 'ActCurrent')
    )
    is_the_motion(read(tmp_path, twincat(separator, decimal), mapping))
    shared = mapping.replace('ActPos time', '1')
    is_the_motion(read(tmp_path, twincat(separator, decimal, one_time=True), shared))


def test_twincat_scope_with_a_channel_that_is_sampled_less_often(tmp_path) -> None:
    mapping = """
time: {column: ActPos time, unit: ms}
options: {decimal: ","}
signals:
  - {column: ActPos, kind: position, axis: x_rotate, unit: rad}
  - {column: ActCurrent, kind: current, axis: x_rotate, unit: A, time_column: ActCurrent time}
"""
    log = read(tmp_path, twincat(every=2), mapping)
    assert log[AXIS, 'position'].value == pytest.approx(ANGLE, abs=1e-9)
    assert log[AXIS, 'current'].time_s == pytest.approx(TIME[::2])
    assert log[AXIS, 'current'].value == pytest.approx(CURRENT[::2], abs=1e-9)


# ---- drives --------------------------------------------------------------------------------------


def test_moteus_by_its_register_names(tmp_path) -> None:
    """Turns and turns per second, torque in Nm, time in s of the computer."""
    lines = ['timestamp,mode,position,velocity,torque,q_current']
    start = 1_700_000_000.0
    for time, angle, current in zip(TIME, ANGLE, CURRENT, strict=True):
        turns = angle / (2.0 * np.pi)
        lines.append(f'{start + time:.6f},10,{turns:.12f},0.0,{0.1 * current:.12f},{current:.12f}')
    mapping = 'time: {column: timestamp, unit: s}\n' + signals('position', 'q_current', 'turn')
    log = read(tmp_path, '\n'.join(lines) + '\n', mapping)
    assert log.origin_ns == 1_700_000_000 * 10**9
    assert log[AXIS, 'position'].time_s == pytest.approx(TIME, abs=3e-7)  # float64 of 1.7e9
    assert log[AXIS, 'position'].value == pytest.approx(ANGLE, abs=1e-9)


def odrive_lines():
    return [
        json.dumps(
            {
                't': float(time),
                'axis0': {
                    'pos_estimate': angle / (2.0 * np.pi),
                    'motor': {'foc': {'Iq_measured': current, 'phases': [1.0, current]}},
                },
                'state': 'CLOSED_LOOP_CONTROL',
            }
        )
        for time, angle, current in zip(TIME, ANGLE, CURRENT, strict=True)
    ]


ODRIVE = 'time: {column: t, unit: s}\n' + signals(
    'axis0.pos_estimate', 'axis0.motor.foc.Iq_measured', 'turn'
)


@pytest.mark.parametrize('name', ['log.jsonl', 'log.ndjson', 'log.json'])
def test_odrive_as_json_lines(tmp_path, name) -> None:
    text = '\n'.join(odrive_lines()) + '\n'
    is_the_motion(read(tmp_path, text, ODRIVE, name))
    in_list = ODRIVE.replace('axis0.motor.foc.Iq_measured', "'axis0.motor.foc.phases[1]'")
    is_the_motion(read(tmp_path, text, in_list, name))


def test_json_as_one_list_and_json_that_is_damaged(tmp_path) -> None:
    lines = odrive_lines()
    is_the_motion(read(tmp_path, '[' + ',\n'.join(lines) + ']', ODRIVE, 'log.json'))
    lines[20] = lines[20][:30]
    lines[40] = '{"t": 0.04}'
    log = read(tmp_path, '\n'.join(lines), ODRIVE, 'log.jsonl')
    assert len(log[AXIS, 'position'].value) == COUNT - 2
    said = '\n'.join(str(finding) for finding in log.findings)
    assert 'line 21: no JSON' in said
    assert 'line 41' in said
    with pytest.raises(UserError, match='holds no line with a JSON object'):
        read(tmp_path, 'nothing\n', ODRIVE, 'log.jsonl')
    with pytest.raises(UserError, match=r"has no column 'axis0\.pos'; did you mean"):
        read(tmp_path, '\n'.join(odrive_lines()), ODRIVE.replace('_estimate', ''), 'log.jsonl')
    with pytest.raises(UserError, match='levels deep'):
        read(tmp_path, '{"a":' * 40 + '1' + '}' * 40, ODRIVE, 'log.jsonl')


# ---- a row for each value ------------------------------------------------------------------------


def candump_like(header=True):
    """Return decoded frames: bracketed times, identifiers in hexadecimal, semicolons."""
    lines = ['time;bus;id;signal;value'] if header else []
    for time, angle, current in zip(TIME, ANGLE, CURRENT, strict=True):
        lines.append(f'({time:.6f});can0;1A1;position;{angle:.12f}')
        lines.append(f'({time:.6f});can0;1A2;current;{current:.12f}')
        lines.append(f'({time:.6f});can0;701;state;operational')
    return '\n'.join(lines) + '\n'


@pytest.mark.parametrize('header', [True, False])
@pytest.mark.parametrize('by', ['signal', 'id'])
def test_a_row_for_each_value(tmp_path, header, by) -> None:
    column = {'signal': 'signal', 'id': 'id'}[by] if header else {'signal': 4, 'id': 3}[by]
    names = ('position', 'current') if by == 'signal' else ('1A1', '1A2')
    value, time = ('value', 'time') if header else (5, 1)
    mapping = (
        f'time: {{column: {time}, unit: s}}\n'
        'signals:\n'
        f'  - {{column: {value}, kind: position, axis: x_rotate, unit: rad, '
        f'where: {{column: {column}, is: {names[0]}}}}}\n'
        f'  - {{column: {value}, kind: current, axis: x_rotate, unit: A, '
        f'where: {{column: {column}, is: {names[1]}}}}}\n'
    )
    is_the_motion(read(tmp_path, candump_like(header), mapping))
    with pytest.raises(UserError, match=r"no row has 'nothing' in column .*\(there: "):
        read(tmp_path, candump_like(header), mapping.replace(f'is: {names[0]}', 'is: nothing'))


def test_json_with_a_line_for_each_value(tmp_path) -> None:
    lines = []
    for time, angle, current in zip(TIME, ANGLE, CURRENT, strict=True):
        lines.append(json.dumps({'t': time, 'name': 'angle', 'value': angle}))
        lines.append(json.dumps({'t': time, 'name': 'current', 'value': current}))
    mapping = """
time: {column: t, unit: s}
signals:
  - {column: value, kind: position, axis: x_rotate, unit: rad, where: {column: name, is: angle}}
  - {column: value, kind: current, axis: x_rotate, unit: A, where: {column: name, is: current}}
"""
    is_the_motion(read(tmp_path, '\n'.join(lines), mapping, 'log.jsonl'))


# ---- time, units, Parquet ------------------------------------------------------------------------

EPOCH_S = 1_732_500_000


@pytest.mark.parametrize(
    ('unit', 'per_s'), [('s', 1), ('ms', 10**3), ('us', 10**6), ('ns', 10**9)]
)
def test_times_since_1970_in_any_unit(tmp_path, unit, per_s) -> None:
    lines = ['t,position,current']
    for row in range(COUNT):
        whole = EPOCH_S * per_s + row * per_s // 1000
        text = str(whole) if per_s > 1 else f'{EPOCH_S}.{row:03d}'
        lines.append(f'{text},{float(ANGLE[row])!r},{float(CURRENT[row])!r}')
    text = '\n'.join(lines) + '\n'
    log = read(tmp_path, text, f'time: {{column: t, unit: {unit}}}\n' + signals())
    assert log.origin_ns == EPOCH_S * 10**9
    assert log[AXIS, 'position'].time_s == pytest.approx(TIME, abs=5e-7)  # float64 of 1.7e9
    if unit != 's':
        with pytest.raises(UserError, match=f'In {unit} it would be of the year 2024'):
            read(tmp_path, text, 'time: {column: t, unit: s}\n' + signals())


@pytest.mark.parametrize(
    ('kind', 'axis', 'unit', 'si'),
    [
        ('position', 'y_linear', 'in', 0.0254),
        ('velocity', 'y_linear', 'in/s', 0.0254),
        ('force', 'y_linear', 'lb', 4.4482216152605),
        ('force', 'y_linear', 'kip', 4448.2216152605),
        ('torque', 'x_rotate', 'oz-in', 7.061551814e-3),
        ('torque', 'x_rotate', 'lb-in', 0.112984829),
        ('torque', 'x_rotate', 'lb-ft', 1.355817948),
        ('velocity', 'x_rotate', 'rpm', 2.0 * np.pi / 60.0),
        ('velocity', 'x_rotate', 'turn/s', 2.0 * np.pi),
        ('position', 'x_rotate', 'turn', 2.0 * np.pi),
    ],
)
def test_units_of_other_countries(kind, axis, unit, si) -> None:
    mapping = mapping_text(
        f'time: {{sample_time_s: 0.001}}\n'
        f'signals: [{{column: 1, kind: {kind}, axis: {axis}, unit: {unit}}}]\n'
    )
    (source,) = mapping.signals
    assert source.conversion.factor == pytest.approx(si, rel=1e-8)


PARQUET = 'time: {column: t, unit: s}\n' + signals()


def test_parquet(tmp_path) -> None:
    pyarrow = pytest.importorskip('pyarrow')
    import pyarrow.parquet as file_format

    stamps = (EPOCH_S * 10**9 + np.arange(COUNT) * 10**6).astype('datetime64[ns]')
    table = pyarrow.table(
        {'t': TIME, 'stamp': stamps, 'position': ANGLE, 'current': CURRENT, 'x': ['a'] * COUNT}
    )
    path = tmp_path / 'log.parquet'
    file_format.write_table(table, path)
    is_the_motion(load_log(path, mapping_text(PARQUET)))
    by_stamp = load_log(path, mapping_text(PARQUET.replace('column: t,', 'column: stamp,')))
    assert by_stamp.origin_ns == EPOCH_S * 10**9
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(UserError, match='is no readable Parquet file'):
        load_log(path, mapping_text(PARQUET))


def test_without_pyarrow_it_is_said_what_to_install(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(parquet, 'find_spec', lambda name: None)
    path = tmp_path / 'log.parquet'
    path.write_bytes(b'PAR1')
    with pytest.raises(UserError, match='pip install pyarrow'):
        load_log(path, mapping_text(PARQUET))


def test_where_does_not_go_with_arrays(tmp_path) -> None:
    path = tmp_path / 'log.npz'
    np.savez(path, t=TIME, position=ANGLE, current=CURRENT)
    mapping = PARQUET.replace('unit: rad', 'unit: rad, where: {column: t, is: 1}')
    with pytest.raises(UserError, match='where belongs to text, JSON and Parquet'):
        load_log(path, mapping_text(mapping))
