# SPDX-License-Identifier: Apache-2.0
"""`waferbot modes` and `waferbot verify`: what they print, write and refuse."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest

from waferbot_plant import verification
from waferbot_plant.plant import load_machine
from waferbot_twin.cli.main import main


def as_json(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert main([*arguments, '--json']) == 0
    return json.loads(capsys.readouterr().out)


def test_modes_has_the_thirteen_rows_of_table_6_7(capsys) -> None:
    result = as_json(capsys, 'modes')
    rows = result['first_frequencies']
    assert len(rows) == 13
    assert rows[-1]['connections'] == ['gearbox', 'belt']
    for row in rows:
        assert abs(row['difference_percent']) < 1.0
        ratio = row['frequency_hz'] / row['thesis_hz']
        assert row['difference_percent'] == pytest.approx(100.0 * (ratio - 1.0))
    frequencies = [mode['frequency_hz'] for mode in result['modes']]
    assert len(frequencies) == 12
    assert frequencies == sorted(frequencies)
    assert result['limit_hz'] == 300.0


def test_modes_as_text_names_every_connection_and_its_switch(capsys) -> None:
    assert main(['modes', '--bandwidth', '5']) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in load_machine('flexible').description.connections:
        assert any(name in line for line in lines), name
    assert any(line.startswith('cable ') and line.endswith('flexible  flexible') for line in lines)
    radial = next(line for line in lines if line.startswith('x_rotate_bearing_y '))
    assert radial.endswith('flexible     rigid')  # 77 Hz, above 10 x 5 Hz


def test_pose_and_damping_change_the_modes(capsys) -> None:
    home = as_json(capsys, 'modes')
    turned = as_json(capsys, 'modes', '--pose', 'x_rotate=0.5', 'y_rotate=-1')
    assert turned['pose'] == {'x_rotate': 0.5, 'y_rotate': -1.0}
    assert turned['first_frequencies'] == home['first_frequencies']
    changes = [
        abs(one['frequency_hz'] - other['frequency_hz'])
        for one, other in zip(home['modes'], turned['modes'], strict=True)
    ]
    assert max(changes) > 1.0
    bare = as_json(capsys, 'modes', '--damping', 'calculated')
    for one, other in zip(home['modes'], bare['modes'], strict=True):
        assert other['frequency_hz'] == pytest.approx(one['frequency_hz'], rel=1e-9)
        assert other['damping_ratio'] < 1.001 * one['damping_ratio']
    assert bare['modes'][2]['damping_ratio'] < 0.2 * home['modes'][2]['damping_ratio']


def test_simplified_machine_is_written_and_is_the_shipped_one(capsys, tmp_path: Path) -> None:
    path = tmp_path / 'simplified.yaml'
    assert main(['modes', '--write', str(path)]) == 0
    written, shipped = load_machine(path), load_machine('simplified')
    assert written.coordinates == shipped.coordinates
    assert written.parameters().tobytes() == shipped.parameters().tobytes()
    assert main(['modes', '--write', str(path)]) == 1
    assert 'exists' in capsys.readouterr().err
    assert main(['modes', '--write', str(path), '--force', '--bandwidth', '1000']) == 0
    assert all(part.flexible for part in load_machine(path).description.connections.values())


def test_modes_of_another_machine(capsys) -> None:
    result = as_json(capsys, 'modes', '--description', 'two_mass_drive')
    (row,) = result['first_frequencies']
    assert row['connections'] == ['shaft']
    assert row['thesis_hz'] is None
    assert result['modes'][0]['frequency_hz'] == pytest.approx(25.16, rel=1e-3)
    assert main(['modes', '--model', 'rigid']) == 0
    assert 'every connection is rigid' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--pose', 'x_rotat=1'], ["did you mean 'x_rotate'"]),
        (['--pose', 'x_rotate=high'], ['x_rotate=high', 'rad']),
        (['--bandwidth', '0'], ['--bandwidth', 'above 0']),
        (['--plot', 'modes.txt'], ['--plot', '.png']),
        (['--model', 'rigid', '--plot', 'modes.png'], ['nothing gives']),
        (['--description', 'nowhere'], ['nowhere', 'two_mass_drive']),
    ],
)
def test_mistakes_are_told_in_one_line(capsys, arguments: list[str], words: list[str]) -> None:
    assert main(['modes', *arguments]) == 1
    message = capsys.readouterr().err.strip()
    assert message.startswith('waferbot: error: ')
    assert '\n' not in message
    for word in words:
        assert word in message


@pytest.mark.slow
def test_pictures_are_drawn(tmp_path: Path) -> None:
    modes, mechanism = tmp_path / 'new' / 'modes.png', tmp_path / 'mechanism.svg'
    assert main(['modes', '--plot', str(modes), '--draw', str(mechanism)]) == 0
    assert modes.read_bytes()[:4] == b'\x89PNG'
    width, height = struct.unpack('>II', modes.read_bytes()[16:24])
    assert 800 <= width <= 1920, 'as wide as a screen at most'
    assert 400 <= height <= 1080
    assert '<svg' in mechanism.read_text('utf-8')


@pytest.mark.slow
def test_verify_passes_and_stands_beside_the_thesis(capsys) -> None:
    result = as_json(capsys, 'verify', '--seed', '7')
    assert result['passed'] is True
    assert result['seed'] == 7
    thesis = [check['thesis'] for check in result['checks'] if check['thesis']]
    assert thesis == [1.4e-5, 4.3e-4, 2.7e-3]
    for check in result['checks']:
        assert abs(check['found']) <= check['limit']
        if check['thesis']:
            assert check['found'] < 1e-3 * check['thesis']
    assert main(['verify']) == 0
    assert 'all checks passed' in capsys.readouterr().out


@pytest.mark.slow
def test_verify_takes_another_machine(capsys) -> None:
    """Belts that give have a drift of second order; what slides without any has none."""
    result = as_json(capsys, 'verify', '--description', 'scara')
    assert result['passed'] is True
    assert [check['name'].partition(',')[0] for check in result['checks']] == [
        'energy',
        'drift',
        'drift',
    ]
    assert 0.0 < result['checks'][1]['found'] < 1e-6
    assert 0.2 < result['checks'][2]['found'] < 0.3
    result = as_json(capsys, 'verify', '--description', 'single_mass')
    assert len(result['checks']) == 2
    assert main(['verify', '--description', 'no_such_machine']) == 1
    assert 'no_such_machine' in capsys.readouterr().err


@pytest.mark.parametrize('worst', [2e-9, float('nan')])
def test_verify_fails_loudly(capsys, monkeypatch: pytest.MonkeyPatch, worst: float) -> None:
    monkeypatch.setattr(verification, 'open_loop_differences', lambda machine: {'y_linear': 0.0})
    monkeypatch.setattr(verification, 'random_agreement', lambda seed: worst)
    monkeypatch.setattr(verification, 'energy_imbalance', lambda machine: 0.0)
    monkeypatch.setattr(verification, 'lossless_drift', lambda machine, steps: 1e-9 / steps**2)
    assert main(['verify']) == 1
    printed = capsys.readouterr().out
    assert printed.count('FAILED') == 1
    assert '1 of 11 checks failed' in printed
