# SPDX-License-Identifier: Apache-2.0
"""Files that came damaged, and what the user is told; `tests/test_fuzz.py` tries many more."""

from __future__ import annotations

import json
import os
import struct

import numpy as np
import pytest
import scipy.io

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import parse
from waferbot_twin.cli.main import main
from waferbot_twin.diagnosis.report_schema import SCHEMA
from waferbot_twin.logs.archive import read_archive
from waferbot_twin.logs.isolated import isolated
from waferbot_twin.logs.load import load_log
from waferbot_twin.recording.reader import Recording, read_content, recording_files
from waferbot_twin.suggestion.rivals import read_report

MAPPING = """
time: {column: time, unit: s}
signals:
  - {column: angle, axis: x_rotate, kind: position, unit: rad}
  - {column: current, axis: x_rotate, kind: current, unit: A}
"""
ARRAYS = """
time: {sample_time_s: 0.001}
signals:
  - {column: 1, axis: x_rotate, kind: position, unit: rad}
  - {column: 2, axis: x_rotate, kind: current, unit: A}
"""


def rows(start=0.0, step=0.001):
    return [f'{start + k * step:.3f},{k * 1e-4},{k % 7}' for k in range(40)]


def loaded(tmp_path, lines, name='log.csv', header='time,angle,current'):
    file, mapping = tmp_path / name, tmp_path / 'map.yaml'
    file.write_text('\n'.join([header, *lines]) + '\n')
    mapping.write_text(MAPPING)
    return load_log(file, str(mapping))


def recording(**attachments) -> Recording:
    return Recording('run', {}, {}, {}, True, attachments)


# ---- logs ----------------------------------------------------------------------------------------


def test_one_cell_of_200_kb_costs_its_line_only(tmp_path):
    lines = rows()
    lines[20] = '0.020,"' + 'x' * 200_000 + '",6'
    log = loaded(tmp_path, lines)
    assert len(log.get('x_rotate', 'position').time_s) == 39
    assert any('line 22' in finding.place for finding in log.findings)


def test_an_array_whose_header_lies_is_refused(tmp_path):
    file, mapping = tmp_path / 'log.npy', tmp_path / 'map.yaml'
    np.save(file, np.zeros((40, 2)))
    data = file.read_bytes()
    mapping.write_text(ARRAYS)
    for shape in (b'(4000000000000, 2)', b'(-1, 2)', b'(40, 3)'):
        longer = b', }' + b' ' * (len(shape) - len(b'(40, 2)'))
        lie = data.replace(b'(40, 2)' + longer, shape + b', }')
        assert lie != data
        assert len(lie) == len(data)
        file.write_bytes(lie)
        with pytest.raises(UserError, match=r'no readable \.npy file'):
            load_log(file, str(mapping))


def test_a_header_that_is_no_python_is_refused(tmp_path):
    file, mapping = tmp_path / 'log.npy', tmp_path / 'map.yaml'
    mapping.write_text(ARRAYS)
    text = b"{'descr': '<f8', 'shape': (40, 2"
    file.write_bytes(b'\x93NUMPY\x01\x00' + struct.pack('<H', len(text)) + text)
    with pytest.raises(UserError, match=r'no readable \.npy file'):
        load_log(file, str(mapping))


@pytest.mark.slow
def test_a_matlab_file_on_which_its_reader_crashes_is_refused(tmp_path):
    """The first variable begins at byte 128: its tags, flags and dimensions, each byte made another."""
    file, mapping = tmp_path / 'log.mat', tmp_path / 'map.yaml'
    mapping.write_text(ARRAYS)
    scipy.io.savemat(file, {'data': np.zeros((40, 2))})
    whole = file.read_bytes()
    for place in range(136, 176):
        for kind in (1, 2, 5, 17):
            file.write_bytes(whole[:place] + bytes([kind]) + whole[place + 1 :])
            with pytest.raises(UserError):
                load_log(file, str(mapping))


def test_a_reader_that_crashes_is_an_error():
    assert isolated(lambda: {'a': 1}) == {'a': 1}
    with pytest.raises(ValueError, match='SIGSEGV'):
        isolated(lambda: os.kill(os.getpid(), 11))
    with pytest.raises(ValueError, match='exit code 3'):
        isolated(lambda: os._exit(3))
    with pytest.raises(ValueError, match='broken'):
        isolated(lambda: (_ for _ in ()).throw(KeyError('broken')))


def test_epoch_times_are_taken_and_a_wrong_unit_is_named(tmp_path):
    log = loaded(tmp_path, rows(1.7e9))
    assert log.origin_ns == 1_700_000_000 * 10**9
    assert log.get('x_rotate', 'position').time_s[0] == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(UserError, match=r'5\.39e\+10 years; is time\.unit right'):
        loaded(tmp_path, rows(1.7e18, 1e6))


def test_an_imported_log_without_a_sample_is_refused(tmp_path):
    loaded(tmp_path, rows())
    log, mapping = str(tmp_path / 'log.csv'), str(tmp_path / 'map.yaml')
    assert main(['import', log, '--map', mapping, '--out', str(tmp_path / 'out')]) == 0
    content = read_content(recording_files(tmp_path / 'out'))
    content.messages = {'/measured/x_rotate/velocity': [b'']}
    with pytest.raises(UserError, match='no sample of the log is left'):
        read_archive(tmp_path / 'out', content)


def test_a_dollar_in_the_name_of_a_log_is_drawn(tmp_path, capsys):
    loaded(tmp_path, rows(), 'cost_$5_^{_$.csv')
    log, out = tmp_path / 'cost_$5_^{_$.csv', tmp_path / 'cost_$5_^{_$'
    mapping = str(tmp_path / 'map.yaml')
    assert main(['import', str(log), '--map', mapping, '--out', str(out)]) == 0
    assert main(['plot', str(out)]) == 0, capsys.readouterr().err
    assert (out / 'plot.png').read_bytes().startswith(b'\x89PNG')


# ---- what is attached to a recording, and lies beside it -------------------------------------------


@pytest.mark.parametrize(
    'text',
    [
        '', '{', '[]', '"x"', 'null', '{"timing": 3}', '{"timing": {"servo_divider": 0}}',
        '{"timing": {"servo_divider": "8"}}', '{"timing": {"": 1}}', '{"model": []}', '{"ticks": 1e400}',
        '{"seed": ' + '9' * 5000 + '}', '[' * 100_000,
    ],
)  # fmt: skip
def test_a_damaged_run_json_is_named(text):
    with pytest.raises(UserError, match=r'run: run\.json is damaged'):
        recording(**{'run.json': text}).run  # noqa: B018


@pytest.mark.parametrize(
    'text',
    [
        '', '- 1', 'x: 1', '\x00', 'rosbag2_bagfile_information: 3', 'a: 2000-99-99', '\xff',
        'rosbag2_bagfile_information: {relative_file_paths: x.mcap}',
        'rosbag2_bagfile_information: {relative_file_paths: [{a: 1}]}',
        'rosbag2_bagfile_information: {relative_file_paths: [""]}',
        '[' * 5000,
    ],
)  # fmt: skip
def test_a_damaged_metadata_yaml_is_named(tmp_path, text):
    (tmp_path / 'metadata.yaml').write_text(text, 'latin-1')
    with pytest.raises(UserError, match=r'metadata\.yaml: '):
        recording_files(tmp_path)


@pytest.mark.parametrize(
    ('content', 'hint'),
    [
        ([], "is not of type 'object'"),
        ({'causes': []}, "'schema' is a required property"),
        ({'schema': 1, 'causes': []}, f'schema: {SCHEMA} was expected'),
        ({'schema': SCHEMA}, "'causes' is a required property"),
        (
            {'schema': SCHEMA, 'causes': [{'effect': 'x'}]},
            r"causes\[0\]: 'axis' is a required property",
        ),
        (
            {
                'schema': SCHEMA,
                'causes': [
                    {
                        'effect': 'x',
                        'axis': 'y',
                        'parameters': {'a': {'value': None}},
                        'credible_set': [],
                    }
                ],
            },
            r'causes\[0\]\.parameters\.a\.value: None is not of type',
        ),
    ],
)
def test_a_damaged_report_names_the_key(tmp_path, content, hint):
    (tmp_path / 'report.json').write_text(json.dumps(content))
    with pytest.raises(UserError, match=hint):
        read_report(tmp_path)


# ---- YAML ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('text', 'hint'),
    [
        ('a: {1: x}', "x, line 1: a key must be a plain word; '1' is read as 1"),
        ('\noff: 1', "x, line 2: a key must be a plain word; 'off' is read as False"),
        ('a: {2000-01-01: 1}', 'a key must be a plain word'),
        ('a: ' + '9' * 400, 'x, line 1: a: 99999999999999999999 is too large'),
        ('a: [0, 99999999999999999999]', r'a\[1\]: 99999999999999999999 is too large'),
    ],
)
def test_keys_that_are_no_words_and_numbers_beyond_all_bounds_are_refused(text, hint):
    with pytest.raises(UserError, match=hint):
        parse(text, 'x')


# ---- the command line ----------------------------------------------------------------------------


@pytest.mark.parametrize('seed', ['-1', '1.5', 'x', '', str(2**63), '9' * 5000])
@pytest.mark.parametrize('command', ['run', 'synthesize', 'suggest', 'verify'])
def test_a_seed_is_a_whole_number_from_zero_on(command, seed, capsys):
    assert main([command, f'--seed={seed}']) == 1
    told = capsys.readouterr().err
    assert told.startswith('waferbot: error: --seed is ')
    assert told.count('\n') == 1
