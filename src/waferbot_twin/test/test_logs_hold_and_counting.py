# SPDX-License-Identifier: Apache-2.0
"""
How drive signals go between samples, and how positions count: findings that once were taken for causes.

A drive that holds its current between samples, taken straight, is half a sample late; two encoders that
both round down differ by half a step. The motions are exact, so that nothing else is left over.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from waferbot_lockstep.errors import UserError
from waferbot_plant.plant import find_description
from waferbot_twin.cli.main import main
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.archive import write_archive
from waferbot_twin.logs.hold import evidence
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.mapping import mapping_text
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.from_measured_log import aligned_record, record_of_measured_log
from waferbot_twin.residuals.plant_block import PlantBlock

INERTIA = 2.5e-4  # kg m2, of the direct-drive motor
MAPPING = """
machine: direct_drive_motor
time: {column: time, unit: s}
signals:
  - {column: angle, kind: position, axis: x_rotate, unit: rad, resolution: 1.0e-6}
  - {column: torque, kind: torque, axis: x_rotate, unit: Nm}
"""

SEED = 7


@pytest.fixture(scope='module')
def motor():
    return Variant.of(load_model_or_machine('direct_drive_motor'))


def held_drive(random, folder, samples_per_cycle=1, cycles=1200, cycle_s=4e-3):
    """Write the log of a rotor on a torque that is held over each cycle; return the file."""
    step_s = cycle_s / samples_per_cycle
    moves = expm(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / INERTIA], [0.0] * 3]) * step_s)
    torques = 0.02 * random.standard_normal(cycles)
    state, rows = np.zeros(2), []
    for cycle, torque in enumerate(torques):
        torque -= 4e-3 * state[1] + 0.02 * state[0]
        for sample in range(samples_per_cycle):
            rows.append(((cycle * samples_per_cycle + sample) * step_s, state[0], torque))
            state = moves[:2] @ [*state, torque]
    file = folder / 'log.csv'
    np.savetxt(file, rows, delimiter=',', comments='', header='time,angle,torque', fmt='%.12g')
    return file


def smooth_motion(random, step_s, axis, length, kind, unit, mass=1.0):
    """Return the log of a mass that a sum of sines moves, 4000 samples."""
    time_s = step_s * np.arange(4000)
    wave = 2.0 * np.pi * random.uniform(2.0, 25.0, 12)
    phase = np.outer(time_s, wave) + random.uniform(0.0, 2.0 * np.pi, 12)
    moved = np.sum(-np.sin(phase) / wave**2, axis=1)
    pushed = mass * np.sum(np.sin(phase), axis=1)
    position = Signal('position', axis, length, time_s, moved)
    return MeasuredLog('smooth', (position, Signal(kind, axis, unit, time_s, pushed)))


def left_over(log, variant):
    (found,) = PlantBlock(record_of_measured_log(log, variant), variant).residuals(variant)
    return float(np.std(found))


def mapped(file, more=''):
    text = MAPPING.replace('unit: Nm}', f'unit: Nm{more}}}')
    return load_log(file, mapping_text(text))


def test_a_held_drive_is_held_if_the_mapping_says_so(random, motor, tmp_path) -> None:
    file = held_drive(random, tmp_path)
    straight, held = mapped(file), mapped(file, ', hold: zero_order')
    assert not straight['x_rotate', 'force'].held
    assert held['x_rotate', 'force'].held
    assert left_over(held, motor) < 0.02 * left_over(straight, motor)
    notes = aligned_record(held, motor).notes
    assert any('not significant' in note for note in notes)


def test_a_held_drive_is_found_by_its_half_sample(random, motor, tmp_path) -> None:
    file = held_drive(random, tmp_path)
    found = aligned_record(mapped(file), motor)
    assert any('taken as held' in note for note in found.notes)
    said = aligned_record(mapped(file, ', hold: zero_order'), motor)
    assert found.current.tobytes() == said.current.tobytes()
    straight = aligned_record(mapped(file, ', hold: linear'), motor)
    assert not any('taken as held' in note for note in straight.notes)
    assert any('moved by that' in note for note in straight.notes)


def test_a_described_controller_holds_its_force_unless_the_mapping_says_no(random) -> None:
    """A force that goes straight is half a sample late as a held one: the note says how to say so."""
    stage = Variant.of(load_model_or_machine('emps'))
    log = smooth_motion(random, 1e-3, 'y_linear', 'm', 'force', 'N', 95.0)
    (late, why, *_) = aligned_record(log, stage).notes
    assert 'late, moved by that' in late
    assert 'taken as held, as the output of the described controller' in why
    assert 'hold: linear in the mapping' in why
    straight = log.with_signal(replace(log['y_linear', 'force'], hold='linear'))
    (early, *_) = aligned_record(straight, stage).notes
    assert 'not significant' in early


def test_a_log_that_is_faster_than_its_drive_tells_it_itself(random, motor, tmp_path) -> None:
    file = held_drive(random, tmp_path, samples_per_cycle=3, cycles=400)
    log = mapped(file)
    assert log['x_rotate', 'force'].held
    assert any('stands for 3 samples' in str(finding) for finding in log.findings)
    linear = mapped(file, ', hold: linear')
    assert not linear['x_rotate', 'force'].held
    assert left_over(log, motor) < 0.1 * left_over(linear, motor)


def test_the_import_says_how_a_drive_was_taken_and_what_the_log_speaks_for(
    random, tmp_path, capsys
) -> None:
    """A held drive, taken both ways; one that goes straight, of a smooth motion; one at rest."""
    file = held_drive(random, tmp_path)
    for hold, more in (
        ('linear', ''),
        ('linear', ', hold: linear'),
        ('zero_order', ', hold: zero_order'),
    ):
        (one,) = evidence(mapped(file, more))
        assert (one.taken, one.speaks_for) == (hold, 'zero_order')
        assert one.told_by == ('mapping' if more else 'kind')
        assert one.against == (hold == 'linear')
        assert one.late['linear'][0] == pytest.approx(-0.5, abs=0.1)
        assert one.late['zero_order'][0] == pytest.approx(0.0, abs=0.1)
    (one,) = evidence(mapped(held_drive(random, tmp_path, 3, 400)))
    assert (one.taken, one.told_by, one.speaks_for) == ('zero_order', 'samples', 'zero_order')
    assert 'each value stands for 3 samples' in str(one)

    smooth = smooth_motion(random, 4e-3, 'x_rotate', 'rad', 'current', 'A')
    (one,) = evidence(smooth)
    assert (one.taken, one.speaks_for, one.against) == ('linear', 'linear', False)
    still = replace(smooth['x_rotate', 'position'], value=np.zeros(4000))
    (one,) = evidence(smooth.with_signal(still))
    assert one.speaks_for == ''
    assert 'does not tell' in str(one)

    write_archive(mapped(held_drive(random, tmp_path)), tmp_path / 'kept')
    arguments = ['import', str(tmp_path / 'kept'), '--out', str(tmp_path / 'new')]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert 'x_rotate.force: taken as straight between samples (by its kind)' in said
    assert 'the log speaks for another way, held' in said
    assert 'hold: zero_order in the mapping' in said
    assert main([*arguments, '--force', '--json']) == 0
    (told,) = json.loads(capsys.readouterr().out)['between_samples']
    assert told['speaks_for'] == 'zero_order'


def test_a_measured_current_with_steps_is_not_taken_for_held(random, tmp_path) -> None:
    time_s = 1e-3 * np.arange(4000)
    smooth = np.cumsum(random.standard_normal(4000)) * 0.02
    coarse = np.round(smooth / 0.05) * 0.05
    rows = np.column_stack([time_s, np.sin(time_s), coarse])
    file = tmp_path / 'log.csv'
    np.savetxt(file, rows, delimiter=',', comments='', header='time,angle,torque', fmt='%.9g')
    assert np.median(np.diff(np.flatnonzero(np.diff(coarse)))) > 1
    assert not mapped(file)['x_rotate', 'force'].held


def test_how_a_signal_goes_survives_the_archive_and_is_printed(tmp_path, capsys) -> None:
    time_s = 1e-3 * np.arange(100)
    signals = (
        Signal('position', 'x_rotate', 'rad', time_s, time_s, 1e-4, counting='floor', half_step=5e-5),
        Signal('current', 'x_rotate', 'A', time_s, time_s, hold='zero_order'),
        Signal('current_command', 'x_rotate', 'A', time_s, time_s),
    )  # fmt: skip
    log = MeasuredLog('log', signals)
    write_archive(log, tmp_path / 'kept')
    back = load_log(tmp_path / 'kept')
    for one, other in zip(log.signals, back.signals, strict=True):
        assert (one.hold, one.held, one.counting, one.half_step) == (
            other.hold, other.held, other.counting, other.half_step,
        )  # fmt: skip
    assert main(['import', str(tmp_path / 'kept'), '--out', str(tmp_path / 'again')]) == 0
    printed = capsys.readouterr().out
    assert 'held between samples: x_rotate.current_command, x_rotate.current' in printed
    assert 'straight between samples: x_rotate.position' in printed
    assert 'rounded down: x_rotate.position' in printed


def test_words_that_do_not_fit_are_refused() -> None:
    with pytest.raises(UserError, match=r'hold.*zero_order, linear'):
        mapping_text(MAPPING.replace('unit: Nm}', 'unit: Nm, hold: cubic}'))
    with pytest.raises(UserError, match=r'counting.*is not counted'):
        mapping_text(MAPPING.replace('unit: Nm}', 'unit: Nm, counting: floor}'))


TWO_ENCODERS = """
extends: {base}
feedback: {{delay_cycles: 0}}
gravity_m_s2: [0, 0, 0]
encoders:
  y_rotate_load: {{counts_per_revolution: 2000}}
  y_rotate_motor: {{coordinate: motor_angle, counts_per_revolution: 1024}}
"""
RATIO = 6.0
LOAD, MOTOR = 2.0 * np.pi / 2000.0, 2.0 * np.pi / 1024.0  # rad, a count of each


@pytest.fixture
def geared(tmp_path):
    file = tmp_path / 'geared.yaml'
    file.write_text(TWO_ENCODERS.format(base=find_description('geared_pendulum')), 'utf-8')
    return Variant.of(load_model_or_machine(str(file)))


def two_encoders(random, variant, count, **how):
    """Return a log of a geared axis; `count(value, step)` makes steps of both its encoders."""
    time_s = 1e-3 * np.arange(4000)
    wave = 2.0 * np.pi * random.uniform(0.3, 2.0, 5)
    phase = random.uniform(0.0, 2.0 * np.pi, 5)
    angle = np.sin(np.outer(time_s, wave) + phase) @ (1.0 / wave)
    rate = -np.sin(np.outer(time_s, wave) + phase) @ wave
    inertia = places.moving_inertia(variant, 'y_rotate')
    return MeasuredLog(
        'log',
        (
            Signal('position', 'y_rotate', 'rad', time_s, count(angle, LOAD), LOAD, **how),
            Signal(
                'motor_position', 'y_rotate', 'rad', time_s, count(RATIO * angle, MOTOR), MOTOR
            ),
            Signal('force', 'y_rotate', 'Nm', time_s, inertia * rate),
        ),
    )


def floor(value, step):
    return step * np.floor(value / step)


def nearest(value, step):
    return step * np.round(value / step)


def mean_of_load(record, variant):
    """Return the mean innovation of the load's encoder, in its steps: the motor's finer one holds."""
    block = PlantBlock(record, variant)
    (found,) = (
        left
        for name, left in zip(block.channels, block.residuals(variant), strict=True)
        if name == 'y_rotate_load'
    )
    return float(np.mean(found))


@pytest.mark.parametrize('count', [floor, nearest])
def test_two_encoders_tell_how_they_count_and_leave_nothing(random, geared, count) -> None:
    log = two_encoders(random, geared, count)
    record = aligned_record(log, geared)
    assert abs(mean_of_load(record, geared)) < 0.05
    word = 'rounded down' if count is floor else 'rounded to the nearest'
    assert any(word in note for note in record.notes)
    raw = mean_of_load(record_of_measured_log(log, geared), geared)
    half = 0.5 * (
        MOTOR / (LOAD * RATIO) - 1.0
    )  # by which floored counts differ, in the load's steps
    assert raw == pytest.approx(half if count is floor else 0.0, abs=0.05)


def test_what_the_description_says_of_counting_is_used(random, geared) -> None:
    log = two_encoders(random, geared, floor)
    encoders = {
        place: {**values, 'counting': 'floor'} for place, values in geared.machine['encoders'].items()
    }  # fmt: skip
    said = replace(geared, machine={**geared.machine, 'encoders': encoders})
    record = aligned_record(log, said)
    assert record.half_step[2:] == pytest.approx((0.5, 0.5))
    assert not any('as they differ' in note for note in record.notes)
    assert abs(mean_of_load(record, said)) < 0.05


@pytest.mark.parametrize(('sign', 'half'), [(1, 0.5), (-1, -0.5)])
def test_a_reversed_column_is_rounded_the_other_way(tmp_path, sign, half) -> None:
    rows = [(1e-3 * k, k // 3, 0.01 * (k % 7)) for k in range(100)]
    file = tmp_path / 'log.csv'
    np.savetxt(file, rows, delimiter=',', comments='', header='time,angle,torque', fmt='%.9g')
    counting = f'unit: counts, counting: floor, sign: {sign}'
    text = MAPPING.replace('unit: rad, resolution: 1.0e-6', counting)
    position = load_log(file, mapping_text(text))['x_rotate', 'position']
    assert position.counting == 'floor'
    assert position.half_step == pytest.approx(half * 2.0 * np.pi / 8192.0)


def test_averaged_counts_are_half_a_count_low_and_no_lattice(tmp_path) -> None:
    rows = [
        (1e-3 * k, np.floor(0.37 * k + np.arange(4) / 10.0).mean(), 0.01 * (k % 7))
        for k in range(200)
    ]
    file = tmp_path / 'log.csv'
    np.savetxt(file, rows, delimiter=',', comments='', header='time,angle,torque', fmt='%.9g')
    text = MAPPING.replace('unit: rad, resolution: 1.0e-6', 'unit: counts, counting: average')
    log = load_log(file, mapping_text(text))
    assert log['x_rotate', 'position'].half_step == pytest.approx(np.pi / 8192.0)
    assert not [finding for finding in log.findings if finding.action == 'suspect']
