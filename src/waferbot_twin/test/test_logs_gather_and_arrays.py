# SPDX-License-Identifier: Apache-2.0
"""PMAC gathers, by hand and by an independent packer; NumPy and MATLAB arrays."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.gather import read_gather
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.mapping import mapping_text


def gathered(tmp_path, text, **gather):
    path = tmp_path / 'gather.txt'
    path.write_text(text)
    return read_gather(path, gather)


def test_a_gather_by_hand(tmp_path) -> None:
    """Position 3072 = one count at Ixx08 = 96; two words in a long, the last six digits first."""
    table = gathered(
        tmp_path,
        '000000000C00 FFFFFF000200\nFFFFFFFFF400 000001FFFE00',
        sources=['$80008B', '$4000BF', '$400123'],
    )
    assert table.column('$80008B').value.tolist() == [1.0, -1.0]
    assert table.column('$4000bf').value.tolist() == [2.0, -2.0]  # 512 / 256 DAC bits
    assert table.column('$400123').value.tolist() == [-1.0, 1.0]  # no known register: raw
    assert not table.findings


def test_the_dummy_word_of_an_odd_number(tmp_path) -> None:
    table = gathered(tmp_path, 'ABCDEF000001 123456000002 000000000003', sources=['$000001'])
    assert table.column('$000001').value.tolist() == [1.0, 2.0, 3.0]


@settings(deadline=None, max_examples=50)
@given(
    widths=st.lists(st.sampled_from([24, 48]), min_size=1, max_size=6),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_list_of_sources(tmp_path_factory, widths, seed) -> None:
    """Packed here as one big integer per sample, which is another way than that of the reader."""
    random = np.random.default_rng(seed)
    samples = [
        [int(random.integers(-(2 ** (width - 1)), 2 ** (width - 1))) for width in widths]
        for _ in range(5)
    ]
    text = ''
    for sample in samples:
        packed, at = 0, 0
        for value, width in zip(sample, widths, strict=True):
            packed |= (value % 2**width) << at
            at += width
        for first in range(0, at, 48):
            text += f'{packed >> first & (2**48 - 1):012X} '
        text += '\n'
    # Addresses in no motor's memory, so that nothing is scaled.
    sources = [f'${"8" if width == 48 else "4"}{0x2000 + k:05X}' for k, width in enumerate(widths)]
    table = gathered(tmp_path_factory.mktemp('gather'), text, sources=sources)
    assert table.values.tolist() == [[float(value) for value in sample] for sample in samples]


def test_a_broken_and_a_cut_off_gather(tmp_path) -> None:
    text = '000000000C00\n00000000180\n000000002400\n'
    table = gathered(tmp_path, text, sources=['$80008B'])
    assert np.array_equal(table.column('$80008B').value, [1.0, np.nan, 3.0], equal_nan=True)
    assert "line 2: '00000000180' is no gathered long" in str(table.findings[0])
    cut = gathered(
        tmp_path, '000000000C00 000000000001 000000001800', sources=['$80008B', '$800200']
    )
    assert len(cut.values) == 1
    assert 'the last sample is not whole' in str(cut.findings[0])
    with pytest.raises(UserError, match='floating point of 48 bits'):
        gathered(tmp_path, '0' * 12, sources=['$C00001'])


def test_a_gather_as_a_log(tmp_path) -> None:
    """Servo cycle from I10, a rolled-over buffer put right by the servo counter."""
    count = 40
    rows = np.roll(np.arange(count), 15)
    text = ''.join(
        f'{3072 * 8192 * k // 100:012X} {(256 * k) % 2**24:06X}{(k + 2**24 - 20) % 2**24:06X}\n'
        for k in rows
    )
    path = tmp_path / 'gather.txt'
    path.write_text(text)
    mapping = mapping_text("""
machine: direct_drive_motor
gather: {sources: [$80008B, $400000, $4000BF]}
time: {column: $400000, unit: servo_cycle, wraps_at: 16777216, I10: 3713991}
signals:
  - {column: $80008B, kind: position, axis: x_rotate, unit: counts}
  - {column: $4000BF, kind: drive_command, axis: x_rotate, unit: DAC_bits}
""")
    log = load_log(path, mapping)
    position = log['x_rotate', 'position']
    cycle_s = 3713991 / 8388608 * 1e-3
    assert np.diff(position.time_s) == pytest.approx(cycle_s, rel=1e-6)
    wanted = np.arange(count) * 2.0 * np.pi / 100
    last_bit = 2.0 * np.pi / 8192 / 3072
    assert position.value == pytest.approx(wanted, abs=last_bit)
    assert log['x_rotate', 'drive_command'].value == pytest.approx(np.arange(count) / 32768)
    assert any('time goes back' in str(finding) for finding in log.findings)


TIME = np.arange(100) / 500.0
ROWS = np.array([TIME, np.sin(TIME * 30.0), np.cos(TIME * 30.0)])
BY_NUMBER = """
time: {column: 1, unit: s}
signals:
  - {column: 2, kind: position, axis: x_rotate, unit: rad}
  - {column: 3, kind: current, axis: x_rotate, unit: A}
"""


@pytest.mark.parametrize('array', [ROWS, ROWS.T])
def test_numpy_arrays_of_either_orientation(tmp_path, array) -> None:
    np.save(tmp_path / 'log.npy', array)
    log = load_log(tmp_path / 'log.npy', mapping_text(BY_NUMBER))
    assert log['x_rotate', 'position'].value.tobytes() == ROWS[1].tobytes()
    assert log['x_rotate', 'current'].time_s.tobytes() == TIME.tobytes()


def test_matlab_matrices_cells_and_structs(tmp_path) -> None:
    cells = np.empty((3, 4), object)
    for run in range(4):
        for row in range(3):
            cells[row, run] = (1.0 + run if row else 1.0) * ROWS[row]
    content = {'data': cells, 'matrix': ROWS.T, 'log': {'pos': ROWS[1], 'inner': {'cur': ROWS[2]}}}
    path = tmp_path / 'log.mat'
    scipy.io.savemat(path, content)
    mapping = """
part: 1
time: {column: 'data{1,$part}', unit: s}
signals:
  - {column: 'data{2,$part}', kind: position, axis: x_rotate, unit: rad}
  - {column: 'data{3,$part}', kind: current, axis: x_rotate, unit: A}
"""
    for part in (1, 3):
        log = load_log(path, mapping_text(mapping), part=part)
        assert log['x_rotate', 'position'].value.tobytes() == (part * ROWS[1]).tobytes()
    others = """
time: {column: 'matrix(:,1)', unit: s}
signals:
  - {column: log.pos, kind: position, axis: x_rotate, unit: rad}
  - {column: log.inner.cur, kind: current, axis: x_rotate, unit: A}
"""
    log = load_log(path, mapping_text(others))
    assert log['x_rotate', 'position'].value.tobytes() == ROWS[1].tobytes()
    assert log['x_rotate', 'current'].value.tobytes() == ROWS[2].tobytes()
    with pytest.raises(UserError, match=r'data\{2,9\}.*is not in 3 x 4'):
        load_log(path, mapping_text(mapping), part=9)
    with pytest.raises(UserError, match=r"no variable 'dat'; did you mean 'data'"):
        load_log(path, mapping_text(mapping.replace("'data{2", "'dat{2")))


@pytest.mark.parametrize('suffix', ['.npy', '.npz', '.mat'])
def test_damaged_arrays_are_the_users_error(tmp_path, suffix) -> None:
    path = tmp_path / f'log{suffix}'
    if suffix == '.npy':
        np.save(path, ROWS)
    elif suffix == '.npz':
        np.savez(path, data=ROWS)
    else:
        scipy.io.savemat(path, {'data': ROWS})
    path.write_bytes(path.read_bytes()[:150])
    with pytest.raises(UserError, match=str(path.name)):
        load_log(path, mapping_text(BY_NUMBER))
