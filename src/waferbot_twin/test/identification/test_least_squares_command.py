# SPDX-License-Identifier: Apache-2.0
"""`waferbot identify --method least-squares` on logs that are formulas: values, units, mistakes."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from waferbot_twin.cli.main import main
from waferbot_twin.identification.least_squares import Options, identify_by_least_squares
from waferbot_twin.logs.archive import write_archive
from waferbot_twin.logs.measured import MeasuredLog, Signal

MASS, VISCOUS, COULOMB, OFFSET = 12.0, 30.0, 4.0, 1.5
PER_AMPERE = 35.1507  # of the description `emps`


def log_of(seed, name='log', kind='force', late_s=0.0, hole=False):
    """An axis that slides by a sum of sines, with friction; force noise of 0.2 N."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, 12.0, 1e-3)
    wave, phase = 2.0 * np.pi * random.uniform(0.3, 2.0, 5), random.uniform(0.0, 6.0, 5)

    def motion(order, at_s):
        angle = np.outer(at_s, wave) + phase + order * np.pi / 2.0
        return np.sin(angle) @ (0.08 * wave ** (order - 1.0))

    def force(at_s):
        speed = motion(1, at_s)
        return MASS * motion(2, at_s) + VISCOUS * speed + COULOMB * np.sign(speed) + OFFSET

    drive = force(time_s - late_s) + 0.2 * random.standard_normal(len(time_s))
    if kind != 'force':
        drive = drive / PER_AMPERE
    position = 1e-6 * np.round(motion(0, time_s) / 1e-6)
    keep = np.ones(len(time_s), bool)
    if hole:
        keep[5000:5600] = False
    return MeasuredLog(
        name,
        (
            Signal('position', 'y_linear', 'm', time_s[keep], position[keep], 1e-6),
            Signal(kind, 'y_linear', 'N' if kind == 'force' else 'A', time_s[keep], drive[keep]),
        ),
    )


@pytest.fixture
def logs(tmp_path):
    for name, log in (('one', log_of(1)), ('other', log_of(2))):
        write_archive(log, tmp_path / name)
    return tmp_path / 'one', tmp_path / 'other'


def coefficients(report):
    (axis,) = report['axes'].values()
    return {name: item['value'] for name, item in axis['coefficients'].items()}


EXPECTED = {'inertia': MASS, 'viscous': VISCOUS, 'coulomb': COULOMB, 'offset': OFFSET}


def test_values_intervals_and_errors_of_both_logs(logs, tmp_path, capsys) -> None:
    one, other = map(str, logs)
    out = tmp_path / 'out'
    command = ['identify', one, '--method', 'least-squares', '--validate', other]
    assert main([*command, '--out', str(out)]) == 0
    printed = capsys.readouterr().out
    for word in ('mass', 'kg', 'viscous friction', 'N s/m', 'Coulomb', 'offset', '(validation)'):
        assert word in printed
    report = json.loads((out / 'report.json').read_text('utf-8'))
    assert coefficients(report) == pytest.approx(EXPECTED, rel=0.02)
    axis = report['axes']['y_linear']
    for name, item in axis['coefficients'].items():
        assert item['low95'] < item['value'] < item['high95']
        assert item['high95'] - item['low95'] < 0.05 * EXPECTED[name]
    for entry in (*axis['errors'], *axis['validation_errors']):
        assert 0.0 < entry['relative'] < 0.02
    page = (out / 'report.html').read_text('utf-8')
    assert page.count('<img') == 1
    assert 'Coulomb friction' in page


def test_current_needs_a_model_for_newtons_and_none_for_amperes(tmp_path, capsys) -> None:
    write_archive(log_of(1, kind='current'), tmp_path / 'log')
    command = ['identify', str(tmp_path / 'log'), '--method', 'least-squares', '--json']
    assert main(command) == 0
    plain = json.loads(capsys.readouterr().out)
    in_amperes = {name: value / PER_AMPERE for name, value in EXPECTED.items()}
    assert coefficients(plain) == pytest.approx(in_amperes, rel=0.02)
    assert plain['axes']['y_linear']['coefficients']['inertia']['unit'] == 'A s²/m'
    assert main([*command, '--model', 'emps']) == 0
    assert coefficients(json.loads(capsys.readouterr().out)) == pytest.approx(EXPECTED, rel=0.02)


def test_what_a_motion_does_not_tell_is_said_with_what_would(tmp_path, capsys) -> None:
    """From rest, forwards alone: one force, of which Coulomb friction and offset may be any part."""
    time_s = np.arange(0.0, 12.0, 1e-3)
    speed = 0.1 * np.clip(np.minimum(time_s - 1.0, 11.0 - time_s), 0.0, 3.0)
    force = MASS * np.gradient(speed, time_s) + VISCOUS * speed + COULOMB * np.sign(speed) + OFFSET
    force += 0.2 * np.random.default_rng(5).standard_normal(len(time_s))
    position = 1e-6 * np.round(np.cumsum(speed) * 1e-3 / 1e-6)
    signals = (
        Signal('position', 'y_linear', 'm', time_s, position, 1e-6),
        Signal('force', 'y_linear', 'N', time_s, force),
    )
    write_archive(MeasuredLog('forwards', signals), tmp_path / 'forwards')
    assert main(['identify', str(tmp_path / 'forwards'), '--method', 'least-squares']) == 0
    said = capsys.readouterr().out
    assert len(re.findall(r'(Coulomb friction|offset) +left open', said)) == 2
    assert 'does not tell Coulomb friction and offset apart: left open; give logs that' in said


def test_an_axis_that_cannot_be_fitted_is_said_by_its_own_name_alone(tmp_path, capsys) -> None:
    """Axes of its own: the same name in table, errors and notes; what fails is no note of another."""
    moves = [replace(signal, axis='elbow') for signal in log_of(1, late_s=4e-3).signals]
    stands = [
        replace(signal, axis='wrist', value=0.0 * signal.value) for signal in log_of(2).signals
    ]
    write_archive(MeasuredLog('both', (*moves, *stands)), tmp_path / 'both')
    assert main(['identify', str(tmp_path / 'both'), '--method', 'least-squares']) == 0
    said = capsys.readouterr().out.splitlines()
    assert any(line.startswith('Elbow: Elbow force stands ') for line in said)
    assert any(line.startswith('Wrist: the axis never moves') for line in said)


def test_a_skew_of_the_logger_is_taken_out_and_gaps_are_not_bridged() -> None:
    logs = [log_of(seed, f'log {seed}', late_s=3e-3, hole=seed == 1) for seed in (1, 2)]
    result = identify_by_least_squares(logs, [], None)
    (fit,) = result.fits
    found = dict(zip(fit.estimate.names, fit.estimate.value, strict=True))
    assert found == pytest.approx(EXPECTED, rel=0.02)
    (note,) = fit.notes
    told = re.search(r'stands ([\d.]+) ± [\d.]+ ms late', note)
    assert told is not None, note
    assert float(told[1]) == pytest.approx(3.0, abs=0.15)
    used_s = {one.log: one.used_s for one in fit.fitted}
    assert used_s['log 1'] < used_s['log 2'] - 0.5


def test_a_ripple_over_position_is_told_with_its_period() -> None:
    log = log_of(3)
    position = log['y_linear', 'position']
    force = log['y_linear', 'force']
    ripple = 0.5 * np.sin(2.0 * np.pi / 4e-3 * position.value)
    ripply = MeasuredLog(
        'ripply',
        (
            position,
            Signal('force', 'y_linear', 'N', force.time_s, force.value + ripple),
        ),
    )
    (fit,) = identify_by_least_squares([ripply], [], None, Options()).fits
    assert fit.spectrum is not None
    strongest = fit.spectrum.lines[0]
    assert 1e3 / fit.spectrum.waves[strongest] == pytest.approx(4.0, rel=0.01)
    assert fit.spectrum.amplitude[strongest] == pytest.approx(0.5, rel=0.2)
    (with_sine,) = identify_by_least_squares([ripply], [], None, Options(orders=(250.0,))).fits
    found = dict(zip(with_sine.estimate.names, with_sine.estimate.value, strict=True))
    assert found['sine_1'] == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize(
    ('more', 'words'),
    [
        (['--parameter', 'bodies.carriage.mass_kg'], ['--parameter']),
        (['--with', 'directions'], ['no such term', "did you mean 'direction'"]),
        (['--with', 'sine=a'], ['no list of numbers']),
        (['--with', 'sine=-1'], ['above 0']),
        (['--cut-off', '0'], ['--cut-off', 'above 0']),
        (['--cut-off', '600'], ['--cut-off', 'half']),
        (['--dead-zone', '-1'], ['--dead-zone']),
        (['--dead-zone', '99'], ['never moves']),
        (['--model', 'nonsense'], ['nonsense']),
    ],
)
def test_mistakes_are_told(logs, capsys, more, words) -> None:
    assert main(['identify', str(logs[0]), '--method', 'least-squares', *more]) != 0
    told = capsys.readouterr().err
    assert 'Traceback' not in told
    for word in words:
        assert word in told


def test_the_other_method_wants_names(logs, capsys) -> None:
    assert main(['identify', str(logs[0])]) != 0
    assert '--method least-squares' in capsys.readouterr().err
    assert main(['identify', str(logs[0]), '--parameter', 'x', '--cut-off', '3']) != 0
    assert 'belongs to --method least-squares' in capsys.readouterr().err


def test_frequency_response_takes_a_machine_alone(logs, capsys) -> None:
    assert main(['frf', str(logs[0]), '--model', 'emps', '--highest', '50', '--json']) == 0
    result = json.loads(capsys.readouterr().out)
    assert result['sentence'] == 'There is no simulation to compare with.'
