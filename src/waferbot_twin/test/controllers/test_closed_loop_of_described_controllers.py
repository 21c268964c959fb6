# SPDX-License-Identifier: Apache-2.0
"""
Imported logs whose controller is described, against an exact simulation of the same loop.

The machine is J q'' = u - b q' with u held over each stretch, or what follows that with a lag, so that
scipy's matrix exponential gives its motion exactly; the controller there is a line of Python.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.plant import find_description
from waferbot_twin.controllers.closed_loop import Begin, Counting, run
from waferbot_twin.effects import find, places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.identification.named_parameters import parse
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.closed_loop_record import simulate
from waferbot_twin.residuals.controller_block import controller_block
from waferbot_twin.residuals.from_measured_log import (
    aligned_record,
    record_of_measured_log,
    sized_by,
)
from waferbot_twin.residuals.noise_free_motion import motion
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import CONTROLLER, PLANT, Cause, Problem, apply_all
from waferbot_twin.residuals.shown import shown_residual, shown_value
from waferbot_twin.validation.gain import gains

AXIS, PLACE = 'x_rotate', 1
INERTIA, DAMPING = 2.5e-4, 2e-3  # kg m2, Nm s/rad
RATE = 1000.0
COUNTS = 8192.0 / (2.0 * np.pi)
KP, KD, KI = 0.6, 0.015, 4.0

MACHINE = """
extends: {base}
dampers: {{bearing: {{coordinate: {coordinate}, damping_nm_s_rad: 2.0e-3}}}}
"""
CONTROLLER_OF_IT = """
controllers:
  x_rotate:
    kind: pid
    rate_hz: 1000
    output: Nm
    delay_ms: {delay_ms}
    output_limit: 0.4
    proportional_gain_per_rad: 0.6
    integral_gain_per_rad_s: 4.0
    derivative_gain_s_per_rad: 0.015
    derivative_of: position
"""
MAPPING = """
machine: {machine}
time: {{column: time, unit: s}}
signals:
  - {{column: angle, kind: position, axis: x_rotate, unit: rad}}
  - {{column: torque, kind: torque, axis: x_rotate, unit: Nm}}
"""
COMMANDED = '  - {column: commanded, kind: commanded_position, axis: x_rotate, unit: rad}\n'

SEED = 8


def exact_loop(commanded, delay_s=0.0, counts=0.0, stretches=8, lag_s=1e-9):
    """
    Return angle and torque (n,) at every cycle of the loop that begins at rest at zero.

    `counts` per rad that angles are rounded to the nearest of, 0: not at all.
    """
    step_s = 1.0 / RATE / stretches
    late = round(delay_s / step_s)
    system = np.zeros((4, 4))
    system[0, 1], system[1, 1], system[1, 2] = 1.0, -DAMPING / INERTIA, 1.0 / INERTIA
    system[2, 2], system[2, 3] = -1.0 / lag_s, 1.0 / lag_s
    moves = expm(system * step_s)
    state, integral, before = np.zeros(3), 0.0, 0.0
    given = np.zeros(len(commanded) * stretches + late)
    angles, torques = np.zeros(len(commanded)), np.zeros(len(commanded))
    for cycle, wanted in enumerate(commanded):
        angle = np.round(state[0] * counts) / counts if counts else state[0]
        error = wanted - angle
        more = KI * error / RATE
        others = KP * error - KD * (angle - before) * RATE
        if abs(others + integral + more) > 0.4 and (others + integral + more) * more > 0.0:
            more = 0.0  # conditional integration
        integral += more
        torque, before = np.clip(others + integral, -0.4, 0.4), angle
        angles[cycle], torques[cycle] = angle, torque
        first = cycle * stretches
        given[first + late : first + late + stretches] = torque
        for stretch in range(first, first + stretches):
            state = moves[:3] @ [*state, given[stretch]]
    return angles, torques


def path(random, seconds):
    """Return a smooth path that begins at rest at zero."""
    time_s = np.arange(int(seconds * RATE)) / RATE
    wave = 2.0 * np.pi * random.uniform(0.5, 4.0, 4)
    swing = np.sum(random.uniform(0.3, 1.0, 4) * (1.0 - np.cos(np.outer(time_s, wave))), axis=1)
    return time_s, swing


def machine_file(folder, controller=True, delay_ms=0.0, lag_s=0.0):
    base = find_description('direct_drive_motor')
    text = MACHINE.format(base=base, coordinate=coordinate_of(base))
    if lag_s:
        text += f'motors: {{x_rotate: {{lag_s: {lag_s}}}}}\n'
    if controller:
        text += CONTROLLER_OF_IT.format(delay_ms=delay_ms)
    file = folder / ('described.yaml' if controller else 'alone.yaml')
    file.write_text(text, 'utf-8')
    return file


def coordinate_of(file: Path) -> str:
    return Variant.of(load_model_or_machine(str(file))).description.axes[AXIS]


def imported(folder, time_s, commanded, angles, torques, machine, more=COMMANDED):
    columns = np.column_stack([time_s, commanded, angles, torques])
    np.savetxt(folder / 'log.csv', columns, delimiter=',', comments='', fmt='%.12g',
               header='time,commanded,angle,torque')  # fmt: skip
    (folder / 'map.yaml').write_text(MAPPING.format(machine=machine) + more, 'utf-8')
    return load_log(folder / 'log.csv', str(folder / 'map.yaml'))


def rounded(log):
    """Return the log as the mapping's `counting: round` would have it."""
    signals = (
        replace(one, counting='round') if one.kind == 'position' else one for one in log.signals
    )
    return replace(log, signals=tuple(signals))


@pytest.mark.parametrize(
    ('delay_ms', 'lag_s'), [(0, 0), (0.5, 0), (1.25, 0), (0, 7e-4), (0.5, 2e-4)]
)
def test_the_loop_of_a_described_machine_is_the_exact_one(
    random, tmp_path, delay_ms, lag_s
) -> None:
    _, commanded = path(random, 1.0)
    commanded[300:] += 1.0  # into the limit
    angles, torques = exact_loop(commanded, 1e-3 * delay_ms, lag_s=lag_s or 1e-9)
    assert np.abs(torques).max() == pytest.approx(0.4)
    described = machine_file(tmp_path, delay_ms=delay_ms, lag_s=lag_s)
    variant = Variant.of(load_model_or_machine(str(described)))
    paths = np.zeros((len(commanded), 3))
    paths[:, PLACE] = commanded
    rest = Begin(*np.zeros((4, 3)))
    found = run(variant, Timing(8000, 1, 8), paths, rest, Counting(np.zeros(4), np.zeros(4)))
    assert found.seen[::8, PLACE] / COUNTS == pytest.approx(angles, abs=1e-5 * np.ptp(angles))
    constant = places.force_per_ampere(variant, AXIS)
    assert found.command[:, PLACE] * constant == pytest.approx(torques, abs=1e-5)


def test_an_imported_log_is_done_again(random, tmp_path) -> None:
    """From its first readings alone, so not to the last digit."""
    time_s, commanded = path(random, 1.0)
    angles, torques = exact_loop(commanded)
    machine = machine_file(tmp_path)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine)
    variant = Variant.of(load_model_or_machine(str(machine)))
    record = record_of_measured_log(log, variant)
    assert record.closes_loop
    found = simulate(variant, record)
    known = np.isfinite(record.reading[:, PLACE])
    assert np.array_equal(known, np.isfinite(found.reading[:, PLACE]))
    apart = (found.reading - record.reading)[known, PLACE] / COUNTS
    assert np.abs(apart).max() < 1e-3 * np.ptp(angles)
    assert np.abs(apart[-300:]).max() < 1e-5 * np.ptp(angles)


@pytest.mark.parametrize('delay_ms', [0.0, 1.25])
def test_the_controller_alone_leaves_nothing_if_it_is_right(random, tmp_path, delay_ms) -> None:
    time_s, commanded = path(random, 1.0)
    angles, torques = exact_loop(commanded, 1e-3 * delay_ms, COUNTS)
    machine = machine_file(tmp_path, delay_ms=delay_ms)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine)
    variant = Variant.of(load_model_or_machine(str(machine)))
    record = record_of_measured_log(log, variant)
    assert record.has_controller
    block = controller_block(record, variant)
    (left,) = block.residuals(variant)
    assert block.channels == [AXIS]
    assert len(left) > 900
    assert len(block.times_s(AXIS)) == len(left)
    output = np.std(record.command[:, PLACE])
    assert np.std(left) < 1e-6 * output
    settings = dict(variant.machine['controllers'][AXIS], derivative_gain_s_per_rad=0.018)
    wrong = replace(variant, machine={**variant.machine, 'controllers': {AXIS: settings}})
    (left,) = block.residuals(wrong)
    assert np.std(left) > 0.02 * output


def test_a_log_faster_than_its_controller_shows_its_cycles(random, tmp_path) -> None:
    """Two and a half samples a cycle, from the middle of one on: the cycles are found in the command."""
    time_s, commanded = path(random, 1.0)
    angles, torques = exact_loop(commanded)
    fine_s = np.arange(0.0103, 0.9, 0.4e-3)
    cycle = np.floor(fine_s * RATE + 1e-9).astype(int)
    machine = machine_file(tmp_path)
    log = imported(
        tmp_path, fine_s, commanded[cycle], np.interp(fine_s, time_s, angles), torques[cycle],
        machine,
    )  # fmt: skip
    variant = Variant.of(load_model_or_machine(str(machine)))
    record = record_of_measured_log(log, variant)
    block = controller_block(record, variant)
    (left,) = block.residuals(variant)
    assert np.std(left) < 0.2 * np.std(record.command[:, PLACE])


def test_the_gain_is_that_of_the_closed_loop(random, tmp_path) -> None:
    time_s, commanded = path(random, 1.0)
    angles, torques = exact_loop(commanded, counts=COUNTS)
    machine = machine_file(tmp_path)
    log = rounded(imported(tmp_path, time_s, commanded, angles, torques, machine))
    right = Variant.of(load_model_or_machine(str(machine)))
    wrong = find('wrong_inertia').apply(right, AXIS, {'inertia': 0.5 * INERTIA})
    (gain,) = gains(wrong, right, [aligned_record(log, right)])
    assert gain.closed_loop
    assert gain.rms_after < 1.0 / COUNTS
    assert gain.improvement_percent > 50.0


@pytest.mark.parametrize('missing', [0, 30])
def test_the_noise_free_log_is_there_to_be_asked(random, tmp_path, missing) -> None:
    time_s, commanded = path(random, 0.6)
    angles, torques = exact_loop(commanded, counts=COUNTS)
    machine = machine_file(tmp_path)
    kept = (np.arange(600) < 300) | (np.arange(600) >= 300 + missing)
    log = imported(tmp_path, time_s[kept], commanded[kept], angles[kept], torques[kept], machine)
    variant = Variant.of(load_model_or_machine(str(machine)))
    problem = Problem(variant, [aligned_record(log, variant)])
    ideal = problem.ideal(())
    assert ideal is not None
    for block, parts in problem.blocks.items():
        for part, other in zip(parts, ideal.blocks[block], strict=True):
            assert part.channels == other.channels
            measured, noise_free = part.residuals(variant), other.residuals(variant)
            assert [len(one) for one in measured] == [len(one) for one in noise_free]
            assert all(np.isfinite(one).all() for one in noise_free)
    assert len(problem.blocks[CONTROLLER]) == 1
    assert not any('weaker' in note for record in problem.records for note in record.notes)


def test_readings_stand_at_encoder_ticks_whatever_their_divider(random, tmp_path) -> None:
    _, commanded = path(random, 0.6)
    machine = machine_file(tmp_path)
    variant = Variant.of(load_model_or_machine(str(machine)))
    asked = np.zeros((len(commanded), 3))
    asked[:, AXES.index(AXIS)] = commanded
    still = Begin(*np.zeros((4, 3)))
    finest, every_fourth = (
        run(variant, Timing(8000, divider, 8), asked, still, Counting(np.zeros(4), np.zeros(4)))
        for divider in (1, 4)
    )
    assert np.array_equal(every_fourth.seen, finest.seen[::4])
    assert np.array_equal(every_fourth.speed, finest.speed[::4])
    assert np.array_equal(every_fourth.current, finest.current)


def test_what_the_command_causes_is_that_motion(random, tmp_path) -> None:
    """Finding 1: what asks by the command gets position, speed and current of an imported log."""
    time_s, commanded = path(random, 0.6)
    angles, torques = exact_loop(commanded)
    machine = machine_file(tmp_path)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine)
    variant = Variant.of(load_model_or_machine(str(machine)))
    record = aligned_record(log, variant)
    found = motion(variant, simulate(variant, record), AXIS)
    middle = slice(len(found.clock_s) // 4, -len(found.clock_s) // 8)
    delay_s = variant.description.encoder_delay / record.timing.encoder_hz
    angle = np.interp(found.clock_s - delay_s, time_s, angles)
    speed = np.interp(found.clock_s - delay_s, time_s, np.gradient(angles, time_s))
    assert found.position[middle] / COUNTS == pytest.approx(angle[middle], abs=0.01)
    assert found.speed[middle] / COUNTS == pytest.approx(speed[middle], abs=0.3)
    current = np.abs(np.interp(found.clock_s, time_s, torques))
    current /= places.force_per_ampere(variant, AXIS)
    assert found.amplitude[middle] == pytest.approx(current[middle], abs=0.15)


def test_an_imported_log_is_told_in_its_own_units(random, tmp_path) -> None:
    time_s, commanded = path(random, 0.6)
    angles, torques = exact_loop(commanded)
    machine = machine_file(tmp_path)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine)
    variant = Variant.of(load_model_or_machine(str(machine)))
    record = aligned_record(log, variant)
    factor, unit = shown_residual(record, variant, PLANT, AXIS)
    assert (factor, unit) == (pytest.approx(1.0 / COUNTS), 'rad')
    factor, unit = shown_residual(record, variant, CONTROLLER, AXIS)
    assert (factor, unit) == (pytest.approx(places.force_per_ampere(variant, AXIS)), 'Nm')
    (delay,) = find('encoder_delay').parameters(variant, AXIS)
    factor, unit = shown_value(record, variant, AXIS, delay)
    assert (factor, unit) == (1.0, 'ms')
    assert not any(word in note for note in record.notes for word in ('cycle', 'count'))


def test_gains_of_a_controller_are_parameters_with_a_name(random, tmp_path) -> None:
    time_s, commanded = path(random, 1.0)
    angles, torques = exact_loop(commanded, counts=COUNTS)
    machine = machine_file(tmp_path)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine)
    right = Variant.of(load_model_or_machine(str(machine)))
    settings = dict(right.machine['controllers'][AXIS], derivative_gain_s_per_rad=0.02)
    wrong = replace(right, machine={**right.machine, 'controllers': {AXIS: settings}})
    named = parse('controllers.x_rotate.derivative_gain_s_per_rad', wrong)
    problem = Problem(wrong, [aligned_record(log, wrong)])
    cause = named.cause(0.0)
    assert problem.touched(cause.effect, cause.axis) == (CONTROLLER,)
    before, after = (
        np.std(problem.residuals(named.cause(named.scaled(v)).effect.apply(
            wrong, cause.axis, named.cause(named.scaled(v)).values), CONTROLLER)[0])
        for v in (0.02, KD)
    )  # fmt: skip
    assert after < 1e-3 * before


def test_a_commanded_position_alone_is_kept_and_claims_no_controller(random, tmp_path) -> None:
    time_s, commanded = path(random, 0.6)
    angles, torques = exact_loop(commanded, counts=COUNTS)
    machine = machine_file(tmp_path, controller=False)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine)
    variant = Variant.of(load_model_or_machine(str(machine)))
    record = aligned_record(log, variant)
    assert record.has_commanded
    assert not record.has_controller
    assert not record.closes_loop
    path_ = record.path_commanded(AXIS)
    assert path_ is not None
    assert path_.max() == pytest.approx(commanded.max() * COUNTS, rel=1e-3)
    assert record.path_commanded('y_linear') is None
    assert any('no controller of x_rotate' in note for note in record.notes)
    problem = Problem(variant, [record])
    assert not problem.blocks[CONTROLLER]
    assert problem.ideal(()) is None
    (gain,) = gains(variant, variant, [record])
    assert not gain.closed_loop


def test_without_a_commanded_position_the_log_says_that_it_is_weaker(random, tmp_path) -> None:
    time_s, commanded = path(random, 0.6)
    angles, torques = exact_loop(commanded, counts=COUNTS)
    machine = machine_file(tmp_path)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine, more='')
    record = aligned_record(log, Variant.of(load_model_or_machine(str(machine))))
    assert not record.has_commanded
    assert not record.closes_loop
    assert any('no commanded position' in note and 'weaker' in note for note in record.notes)


def test_nobody_knows_what_was_commanded_in_a_long_gap(random, tmp_path) -> None:
    time_s, commanded = path(random, 0.6)
    angles, torques = exact_loop(commanded, counts=COUNTS)
    machine = machine_file(tmp_path)
    kept = (np.arange(600) < 300) | (np.arange(600) >= 400)
    log = imported(tmp_path, time_s[kept], commanded[kept], angles[kept], torques[kept], machine)
    variant = Variant.of(load_model_or_machine(str(machine)))
    record = aligned_record(log, variant)
    assert not record.closes_loop
    assert any('no commanded position throughout' in note for note in record.notes)
    assert Problem(variant, [record]).ideal(()) is None


def test_an_unstable_loop_is_an_error_with_its_axis(random, tmp_path) -> None:
    time_s, commanded = path(random, 0.6)
    angles, torques = exact_loop(commanded, counts=COUNTS)
    machine = machine_file(tmp_path)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine)
    variant = Variant.of(load_model_or_machine(str(machine)))
    record = record_of_measured_log(log, variant)
    settings = dict(
        variant.machine['controllers'][AXIS], proportional_gain_per_rad=600.0, output_limit=1e6
    )
    wild = replace(variant, machine={**variant.machine, 'controllers': {AXIS: settings}})
    with pytest.raises(UserError, match='axis x_rotate'):
        simulate(wild, record)


def test_an_axis_without_a_controller_stands(tmp_path) -> None:
    """An elbow moves; the shoulder, which gravity would let fall, is not in the log."""
    base = find_description('planar_two_link_arm')
    text = f'extends: {base}\ncontrollers:\n  y_rotate: {{kind: pid, rate_hz: 1000, output: Nm, '
    text += 'proportional_gain_per_rad: 400, derivative_gain_s_per_rad: 8, derivative_filter_hz: 200}\n'
    file = tmp_path / 'arm.yaml'
    file.write_text(text, 'utf-8')
    variant = Variant.of(load_model_or_machine(str(file)))
    commanded = np.zeros((500, 3))
    commanded[:, 2] = 0.1 * (1.0 - np.cos(np.arange(500) * 2e-2))
    begin = Begin(*np.zeros((4, 3)))
    found = run(variant, Timing(8000, 1, 8), commanded, begin, Counting(np.zeros(4), np.zeros(4)))
    per_unit = places.counts_per_unit(variant)
    assert np.ptp(found.seen[:, 1]) == 0.0
    reached = found.seen[::8, 2] / per_unit[2]
    assert np.abs(reached - commanded[:, 2]).max() < 0.05
    assert np.ptp(reached) > 0.15


def test_rates_that_do_not_nest_are_refused(tmp_path) -> None:
    machine = find_description('planar_two_link_arm')
    axes = Variant.of(load_model_or_machine(str(machine))).description.axes
    text = f'extends: {machine}\ncontrollers:\n'
    for axis, rate_hz in zip(axes, (1000, 1500), strict=True):
        text += (
            f'  {axis}: {{kind: p, rate_hz: {rate_hz}, output: A, proportional_gain_per_rad: 1}}\n'
        )
    file = tmp_path / 'arm.yaml'
    file.write_text(text, 'utf-8')
    variant = Variant.of(load_model_or_machine(str(file)))
    time_s = np.arange(1000) * 1e-3
    log = MeasuredLog(
        'log',
        tuple(
            Signal(kind, axis, unit, time_s, np.sin(time_s))
            for axis in axes
            for kind, unit in (('position', 'rad'), ('current', 'A'))
        ),
    )
    with pytest.raises(UserError, match='whole multiple'):
        record_of_measured_log(log, variant)


def test_a_lag_of_the_drive_is_found_in_what_was_told_and_what_moved(random, tmp_path) -> None:
    """By its own value, from a model without one; with it the plant leaves next to nothing over."""
    time_s, commanded = path(random, 1.0)
    commanded[300:] += 0.5
    angles, torques = exact_loop(commanded, lag_s=7e-4)
    machine = machine_file(tmp_path)
    log = imported(tmp_path, time_s, commanded, angles, torques, machine)
    nominal = Variant.of(load_model_or_machine(str(machine)))
    record = record_of_measured_log(log, nominal)
    sized = sized_by([record], nominal)
    effect = find('drive_lag')
    assert effect.axes(sized) == (AXIS,)
    assert effect.axes(sized_by([replace(record, told_alone=())], nominal)) == ()
    assert effect.axes(nominal) == ()
    lag = Cause(effect, AXIS, {'lag': 0.0})
    found = fit_causes(Problem(sized, [record]), (lag,))
    assert found.causes[0].values['lag'] == pytest.approx(0.7, rel=1e-2)
    before, after = (
        np.std(PlantBlock(record, sized).residuals(variant)[0])
        for variant in (sized, apply_all(sized, found.causes))
    )
    assert after < 0.05 * before
