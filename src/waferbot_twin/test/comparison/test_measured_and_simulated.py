# SPDX-License-Identifier: Apache-2.0
"""Measured logs replayed, compared and laid over simulations; overlays read back by other libraries."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.linalg import expm

from waferbot_lockstep.errors import UserError
from waferbot_plant.plant import find_description
from waferbot_twin.cli.main import main
from waferbot_twin.comparison.blocks import replay_blocks
from waferbot_twin.comparison.log_time import beginning_s
from waferbot_twin.comparison.overlay import write_overlay
from waferbot_twin.comparison.pairs import in_closed_loop, later_s, traces_of
from waferbot_twin.comparison.traces import Trace, trace
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.archive import write_archive
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.recording.reader import recording_file
from waferbot_twin.residuals.from_measured_log import aligned_record, record_of_measured_log

AXIS = 'x_rotate'
CHANGES = {
    'pmac': {'pmac': {AXIS: {'Ixx30': 150000}}},
    'copley': {'copley': {AXIS: {'proportional_gain': 5000}}},
}

SEED = 33


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """A log as a machine would give it, the same imported, and a run of the rigid model."""
    folder = tmp_path_factory.mktemp('measured')
    quiet = ['--experiment', 'step', '--model', 'rigid', '--noise', '0', '--seed', '1']
    assert main(['synthesize', *quiet, '--out', str(folder / 'machine')]) == 0
    out = ['--out', str(folder / 'imported')]
    assert main(['import', str(folder / 'machine'), '--model', 'rigid', *out]) == 0
    arguments = ['--engine', 'inprocess', '--experiment', 'step', '--model', 'rigid']
    assert main(['run', *arguments, '--out', str(folder / 'run')]) == 0
    return folder


def changed(tmp_path, node):
    sections = {'plant': {'description': 'rigid'}, **CHANGES[node]}
    path = tmp_path / f'{node}.yaml'
    path.write_text(
        yaml.safe_dump({f'/**/{n}': {'ros__parameters': p} for n, p in sections.items()})
    )
    return str(path)


def told(capsys, *arguments):
    """Run a command; return its exit code, and its standard output as JSON."""
    capsys.readouterr()
    code = main([str(argument) for argument in arguments])
    return code, json.loads(capsys.readouterr().out)


def residuals(result):
    return {
        (row['block'], row['axis'], row['signal']): row['rms_residual']
        for row in result['signals']
    }


# ---- replay --------------------------------------------------------------------------------------


@pytest.mark.parametrize('log', ['machine', 'imported'])
def test_the_right_controller_and_amplifier_leave_nothing_on_a_measured_log(
    folder, capsys, log
) -> None:
    code, result = told(capsys, 'replay', folder / log, '--model', 'rigid', '--json')
    assert code == 0
    left = residuals(result)
    exact = [value for (block, *_), value in left.items() if block in ('controller', 'amplifier')]
    assert len(exact) == (9 if log == 'machine' else 3)
    assert max(exact) == 0.0
    positions = {key for key in left if key[0] == 'plant'}
    assert {axis for _, axis, _ in positions} == {'y_linear', 'x_rotate', 'y_rotate'}
    for row in result['signals']:
        if row['signal'] == 'position':
            assert row['rms_residual'] < 1e-3 * row['rms_measured']
        if row['block'] in ('current loop', 'windings'):
            # Of an imported log, means over servo cycles on either side of a jump; else quiet sensors.
            assert row['rms_residual'] < 0.03 * max(row['rms_measured'], 0.1)


@pytest.mark.parametrize(('log', 'node'), [('machine', 'copley'), ('imported', 'pmac')])
def test_the_block_that_is_wrong_is_told_and_no_other_and_that_is_no_failure(
    folder, tmp_path, capsys, log, node
) -> None:
    code, result = told(
        capsys, 'replay', folder / log, '--model', changed(tmp_path, node), '--json'
    )
    assert code == 0
    wrong = {
        (block, axis)
        for (block, axis, _), value in residuals(result).items()
        if block in ('controller', 'amplifier') and value > 0.0
    }
    assert wrong == {('controller' if node == 'pmac' else 'amplifier', AXIS)}
    code, result = told(
        capsys, 'replay', folder / log, '--model', 'rigid', '--node', 'plant', '--json'
    )
    assert {row['block'] for row in result['signals']} == {'plant'}


def test_a_log_that_is_slower_than_the_servo_is_told_so(folder, capsys) -> None:
    log = load_log(folder / 'imported')
    slow = replace(
        log,
        signals=tuple(
            replace(one, time_s=one.time_s[::4], value=one.value[::4]) for one in log.signals
        ),
    )
    write_archive(slow, folder / 'slow')
    code, result = told(capsys, 'replay', folder / 'slow', '--model', 'rigid', '--json')
    assert code == 0
    assert {row['block'] for row in result['signals']} == {'plant'}
    assert any('562.5 Hz' in note and '2250 Hz' in note for note in result['notes'])


def test_a_run_is_replayed_bit_by_bit_as_ever(folder, capsys) -> None:
    code, result = told(capsys, 'replay', folder / 'run', '--node', 'pmac', '--json')
    assert (code, result['identical']) == (0, True)
    assert main(['replay', str(folder / 'run')]) == 1
    assert 'give --node' in capsys.readouterr().err
    assert main(['replay', str(folder / 'imported')]) == 1
    assert '--model' in capsys.readouterr().err


def test_a_text_is_told_to_be_imported_first(tmp_path, capsys) -> None:
    path = tmp_path / 'log.csv'
    path.write_text('t,a\n0,1\n')
    for command in (['info'], ['plot'], ['metrics'], ['replay', '--model', 'rigid']):
        assert main([command[0], str(path), *command[1:]]) == 1
        assert f'waferbot import {path}' in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    'command',
    [
        'info LOG',
        'info RUN',
        'plot LOG --out PLOT',
        'metrics LOG',
        'compare RUN LOG --out NEW',
        'compare LOG --model rigid',
        'replay LOG --model rigid --out NEW',
        'replay RUN --node copley',
        'frf LOG --model rigid --axis x_rotate --response drive --out NEW',
        'identify LOG --method least-squares --model rigid --out NEW',
    ],
)
def test_with_json_nothing_else_is_on_standard_output(folder, tmp_path, capsys, command) -> None:
    names = {
        'LOG': folder / 'imported',
        'RUN': folder / 'run',
        'PLOT': tmp_path / 'picture.png',
        'NEW': tmp_path / 'new',
    }
    code, result = told(capsys, *(names.get(word, word) for word in command.split()), '--json')
    assert code == 0
    assert result


def test_with_json_an_error_is_on_standard_error(folder, tmp_path, capsys) -> None:
    capsys.readouterr()
    for command in ('info', 'metrics', 'plot'):
        assert main([command, str(tmp_path / 'nothing'), '--json']) == 1
        said = capsys.readouterr()
        assert said.out == ''
        assert said.err.startswith('waferbot: error: ')


# ---- compare, metrics ----------------------------------------------------------------------------


def test_figures_of_an_imported_log_are_those_of_the_recording(folder, capsys) -> None:
    _, of_run = told(capsys, 'metrics', folder / 'run', '--json')
    _, of_log = told(capsys, 'metrics', folder / 'imported', '--json')
    assert set(of_log) == set(of_run)
    # What parts had to bear is in no log: no sensor shows it.
    assert of_log.pop('loads') == []
    assert of_run.pop('loads')
    for axis, figures in of_run.items():
        for name, value in figures.items():
            # The current of an imported log is the mean over a servo cycle.
            within = 0.4 if name == 'peak_current' else 1e-3
            assert of_log[axis][name] == (
                value if isinstance(value, str) else pytest.approx(value, rel=within)
            )


@pytest.mark.slow
def test_a_run_compared_with_the_log_of_the_same_machine_differs_by_nothing(
    folder, capsys
) -> None:
    code, result = told(
        capsys, 'compare', folder / 'run', folder / 'imported', '--json', '--out', folder / 'same'
    )
    assert code == 0
    assert all(rows['RMS error']['simulated'] == 0.0 for rows in result.values())
    _, overlay = told(capsys, 'info', folder / 'same', '--json')
    positions = [row for row in overlay['signals'] if row['signal'] == 'position']
    assert [row['rms_residual'] for row in positions] == [0.0] * 3
    assert (folder / 'same' / 'overlay.png').read_bytes().startswith(b'\x89PNG')


def test_the_closed_loop_of_the_model_does_what_the_log_was_told(folder, capsys) -> None:
    code, result = told(capsys, 'compare', folder / 'imported', '--model', 'rigid', '--json')
    assert code == 0
    for rows in result.values():
        assert rows['RMS error']['difference_percent'] < 1e-3
    _, other = told(capsys, 'compare', folder / 'imported', '--model', 'flexible', '--json')
    assert max(rows['RMS error']['difference_percent'] for rows in other.values()) > 0.1


def test_motions_that_begin_at_other_times_are_laid_over_one_another(folder) -> None:
    log = load_log(folder / 'imported')
    moved = replace(
        log, signals=tuple(replace(one, time_s=one.time_s + 3.25) for one in log.signals)
    )
    assert later_s(log, moved) == pytest.approx(3.25, abs=1e-9)
    for one in traces_of(log, moved, later_s(log, moved)):
        assert np.abs(one.residual).max() == pytest.approx(0.0, abs=1e-9)
        assert one.time_s[0] > 3.2
    without = replace(
        log, signals=tuple(one for one in log.signals if one.kind != 'commanded_position')
    )
    assert later_s(without, moved) == 0.0


def test_without_commands_nobody_closes_a_loop(folder, tmp_path, capsys) -> None:
    log = load_log(folder / 'imported')
    without = replace(
        log, signals=tuple(one for one in log.signals if one.kind != 'commanded_position')
    )
    write_archive(without, tmp_path / 'log')
    assert main(['compare', str(tmp_path / 'log'), '--model', 'rigid']) == 1
    assert f'waferbot replay {tmp_path / "log"} --model rigid' in capsys.readouterr().err
    assert main(['compare', str(tmp_path / 'log')]) == 1
    assert 'one log and --model' in capsys.readouterr().err


# ---- a described controller, against the exact loop ----------------------------------------------

INERTIA, KP, KD, RATE = 2.5e-4, 0.6, 0.015, 1000.0
MACHINE = """
extends: {base}
controllers:
  x_rotate:
    kind: pid
    rate_hz: 1000
    output: Nm
    output_limit: 5.0
    proportional_gain_per_rad: 0.6
    derivative_gain_s_per_rad: 0.015
    derivative_of: position
"""


def exact_log(random, seconds=1.5, begin_s=12.5):
    """Return the log of J q'' = u, u held, with u = KP (r - q) - KD q' of differences, from rest."""
    time_s = np.arange(int(seconds * RATE)) / RATE
    wave = 2.0 * np.pi * random.uniform(0.5, 4.0, 4)
    wanted = np.sum(random.uniform(0.3, 1.0, 4) * (1.0 - np.cos(np.outer(time_s, wave))), axis=1)
    system = np.zeros((3, 3))
    system[0, 1], system[1, 2] = 1.0, 1.0 / INERTIA
    moves = expm(system / RATE)
    state, before = np.zeros(2), 0.0
    angles, torques = np.zeros(len(wanted)), np.zeros(len(wanted))
    for cycle, target in enumerate(wanted):
        angles[cycle] = state[0]
        torques[cycle] = KP * (target - state[0]) - KD * (state[0] - before) * RATE
        before = state[0]
        state = moves[:2] @ [*state, torques[cycle]]
    clock_s = begin_s + time_s
    return MeasuredLog(
        'exact',
        (
            Signal('position', AXIS, 'rad', clock_s, angles),
            Signal('commanded_position', AXIS, 'rad', clock_s, wanted),
            Signal('force', AXIS, 'Nm', clock_s, torques, hold='zero_order'),
        ),
    )


@pytest.fixture
def described(random, tmp_path):
    """The log of an exact loop, imported, and the description of its machine."""
    machine = tmp_path / 'machine.yaml'
    machine.write_text(MACHINE.format(base=find_description('direct_drive_motor')), 'utf-8')
    write_archive(exact_log(random), tmp_path / 'exact')
    return tmp_path / 'exact', str(machine)


def test_a_described_loop_is_replayed_and_compared_on_the_clock_of_its_log(described) -> None:
    path, machine = described
    variant = Variant.of(load_model_or_machine(machine))
    log = load_log(path)
    replayed = {one.kind: one for one in replay_blocks(path, variant).traces}
    for kind, signal in (('position', 'position'), ('controller_output', 'force')):
        one = replayed[kind]
        there, known = log[AXIS, signal].at(one.time_s)
        assert known.all()
        assert one.measured == pytest.approx(there, abs=1e-4 * np.ptp(there))
        assert np.std(one.residual) < 1e-3 * np.std(one.measured)
    measured, simulated = in_closed_loop(path, variant, machine)
    by_kind = {one.kind: one for one in traces_of(simulated, measured)}
    position = by_kind['position']
    assert len(position.time_s) > 1400
    assert np.abs(position.residual).max() < 2e-3 * np.ptp(position.measured)


def test_the_beginning_of_a_record_is_found_in_its_log(random, described) -> None:
    """Where the drive is known later than the position, and not by a whole number of samples."""
    _, machine = described
    variant = Variant.of(load_model_or_machine(machine))
    log = exact_log(random)
    force, known_from = log[AXIS, 'force'], int(random.integers(5, 60))
    late = replace(force, time_s=force.time_s[known_from:], value=force.value[known_from:])
    log = log.with_signal(late)
    without = tuple(one for one in log.signals if one.kind != 'commanded_position')
    for one in (log, replace(log, signals=without)):
        record = record_of_measured_log(one, variant)
        assert beginning_s(record, one, variant) == pytest.approx(late.time_s[0], abs=2e-3)
    alone = Variant.of(load_model_or_machine('direct_drive_motor'))
    record = aligned_record(replace(log, signals=without), alone)
    first = beginning_s(record, log, alone)
    assert first == pytest.approx(late.time_s[0], abs=1.1e-3)


# ---- the overlay ---------------------------------------------------------------------------------


def read_back(path):
    """Return stamps (ns) and values of every topic, by the MCAP project's own ROS 2 decoder."""
    found: dict[str, list[tuple[int, float]]] = {}
    with recording_file(path).open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        attached = {one.name: one.data for one in reader.iter_attachments()}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema.name == 'std_msgs/msg/Float64'
            found.setdefault(channel.topic, []).append((message.log_time, decoded.data))
    return {
        topic: (np.array([ns for ns, _ in rows]), np.array([value for _, value in rows]))
        for topic, rows in found.items()
    }, json.loads(attached['overlay.json'])


def test_an_overlay_holds_the_arrays_to_the_last_bit(random, tmp_path) -> None:
    time_s = np.sort(random.uniform(-1.5, 4.0, 300))
    traces = [
        Trace(AXIS, 'position', 'rad', 'plant', time_s, *random.standard_normal((2, 300))),
        Trace(AXIS, 'current', 'A', 'windings', time_s[::2], *random.standard_normal((2, 150))),
        Trace(AXIS, 'current', 'A', 'current loop', time_s[:9], *random.standard_normal((2, 9))),
    ]
    write_overlay(traces, {'log': 'here'}, tmp_path / 'overlay')
    found, about = read_back(tmp_path / 'overlay')
    ends = ['x_rotate/position', 'x_rotate/current_windings', 'x_rotate/current_current_loop']
    assert len(found) == 9
    assert [row['topic'] for row in about['signals']] == ends
    assert about['log'] == 'here'
    for one, end in zip(traces, ends, strict=True):
        wanted = {'measured': one.measured, 'simulated': one.simulated, 'residual': one.residual}
        for side, values in wanted.items():
            stamps, got = found[f'/{side}/{end}']
            np.testing.assert_array_equal(got, values)
            zero_ns = about['stamp_of_time_zero_ns']
            np.testing.assert_allclose((stamps - zero_ns) * 1e-9, one.time_s, atol=1e-9)
            assert stamps.min() >= 0
    with pytest.raises(UserError, match='exists already'):
        write_overlay(traces, {}, tmp_path / 'overlay')


def test_the_overlay_of_a_log_has_the_log_in_it(folder, capsys) -> None:
    out = folder / 'overlay'
    arguments = ['replay', str(folder / 'imported'), '--model', 'rigid', '--out', str(out)]
    assert main(arguments) == 0
    found, about = read_back(out)
    log = load_log(folder / 'imported')
    zero_ns = about['stamp_of_time_zero_ns']
    stamps, values = found[f'/measured/{AXIS}/current_command']
    there, known = log[AXIS, 'current_command'].at((stamps - zero_ns) * 1e-9 + 1e-6)
    assert known.all()
    np.testing.assert_array_equal(values, there)
    for topic, (stamps, values) in found.items():
        if topic.startswith('/residual'):
            end = topic.removeprefix('/residual')
            measured, simulated = found['/measured' + end], found['/simulated' + end]
            np.testing.assert_array_equal(stamps, measured[0])
            np.testing.assert_array_equal(stamps, simulated[0])
            np.testing.assert_array_equal(values, measured[1] - simulated[1])
    capsys.readouterr()
    assert main(['info', str(out)]) == 0
    assert 'overlay' in capsys.readouterr().out


def test_samples_that_are_not_known_on_both_sides_are_left_out() -> None:
    time_s, known = np.arange(3.0), np.array([1.0, 2.0, 3.0])
    (one,) = trace(AXIS, 'current', 'A', '', time_s, known, np.array([np.nan, 2.5, 3.0]))
    assert one.time_s.tolist() == [1.0, 2.0]
    assert one.residual.tolist() == [-0.5, 0.0]
    assert trace(AXIS, 'current', 'A', '', time_s, known, np.full(3, np.nan)) == []


def test_what_an_overlay_cannot_do_is_told_in_one_line(folder, capsys) -> None:
    out = folder / 'refused'
    assert main(['replay', str(folder / 'imported'), '--model', 'rigid', '--out', str(out)]) == 0
    capsys.readouterr()
    for command, hint in (
        (['plot', str(out), '--out', str(folder / 'no.png')], 'does not hold the model'),
        (['metrics', str(out)], 'does not hold the model'),
        (['diagnose', str(out), '--out', str(folder / 'no')], 'more)'),
    ):
        assert main(command) == 1
        said = capsys.readouterr().err
        assert said.startswith('waferbot: error: ')
        assert hint in said
        assert len(said.splitlines()) == 1
        assert len(said) < 800
    assert not (folder / 'no').exists()
