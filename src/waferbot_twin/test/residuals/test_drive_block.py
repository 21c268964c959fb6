# SPDX-License-Identifier: Apache-2.0
"""The drive alone: quiet with the true model whatever the mechanism is, loud with a wrong drive."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.diagnosis.inference.nuisance import nuisance, prior_groups
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.residuals.drive_block import AmplifierBlock, CurrentLoopBlock, WindingsBlock
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import (
    AMPLIFIER,
    CONTROLLER,
    CURRENT_LOOP,
    PLANT,
    PRIOR,
    WINDINGS,
    Problem,
)
from waferbot_twin.synthesis import CURRENT_NOISE_A, noise

SEED = 20261121
DURATION_S = 0.4
AXES = ('y_linear', 'x_rotate', 'y_rotate')


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def with_effect(variant, name, axis):
    effect = find(name)
    return effect.apply(variant, axis, effect.typical(variant, axis))


def log(variant, level=1.0, model_of_noise=None):
    """Return what a machine like `variant` logs of a wafer exchange, with noise."""
    random = np.random.default_rng(SEED)
    noisy = variant.with_overlay(noise(model_of_noise or variant, level, SEED, random))
    twin = Twin.of(noisy.model(), Timing(), load_experiment('wafer_exchange'))
    return record_of_signals('log', twin.advance(Timing().ticks(DURATION_S)))


def without_voltages(record):
    return replace(record, terminals=replace(record.terminals, voltage=None))


def residuals(block, record, nominal, variant):
    """Return the residuals of `variant` by channel."""
    part = block(record if block is not CurrentLoopBlock else without_voltages(record), nominal)
    return dict(zip(part.channels, part.residuals(variant), strict=True))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def means(values, timing):
    """Return the means over servo cycles of values by ticks."""
    whole = len(values) // timing.servo_divider * timing.servo_divider
    return values[:whole].reshape(-1, timing.servo_divider).mean(axis=1)


@pytest.mark.parametrize('hidden', [None, 'coulomb_friction', 'wrong_inertia', 'cogging'])
def test_a_drive_that_is_right_is_quiet_whatever_the_mechanism_is(nominal, hidden):
    machine = with_effect(nominal, hidden, 'x_rotate') if hidden else nominal
    record = log(machine)
    amplifiers = residuals(AmplifierBlock, record, nominal, nominal)
    assert len(amplifiers) == 6
    assert max(np.abs(left).max() for left in amplifiers.values()) < 1e-9
    cycle = record.timing.servo_divider
    for channel, left in residuals(WindingsBlock, record, nominal, nominal).items():
        # Y-Rotate's motor has coarse counts and little inductance: half as much again.
        allowed = 1.5 if channel.startswith('y_rotate') else 1.1
        assert 0.9 < rms(left) / CURRENT_NOISE_A < allowed, channel
    for channel, left in residuals(CurrentLoopBlock, record, nominal, nominal).items():
        assert rms(left) < CURRENT_NOISE_A / np.sqrt(cycle), channel


def test_readings_that_are_late_are_not_missed_at_the_end_of_a_log(nominal):
    """Where X-Rotate was in the last ticks, an encoder this late would show behind the log's end."""
    late = find('encoder_delay').apply(nominal, 'x_rotate', {'delay': 8e3 / Timing().encoder_hz})
    record = log(late)
    speed = np.diff(record.reading[-20:, AXES.index('x_rotate')])
    assert abs(speed.mean()) > 1.0  # it moves there
    models = (late, nominal)
    true, wrong = (residuals(WindingsBlock, record, nominal, model) for model in models)
    for line in ('x_rotate line 1', 'x_rotate line 2'):
        assert rms(true[line]) < 1.1 * CURRENT_NOISE_A
        assert np.abs(true[line][-64:]).max() < 5.0 * CURRENT_NOISE_A
        late_by, none = (means(one[line], record.timing) for one in (wrong, true))
        assert rms(late_by) > 1.5 * rms(none)


@pytest.mark.parametrize('block', [WindingsBlock, CurrentLoopBlock])
def test_windings_are_not_moved_by_an_encoder_with_large_steps(nominal, block):
    """Steps of the position would be errors k dx / L of the current that other causes explain."""
    record = log(nominal)
    coarse = record.reading.copy()
    coarse[:, AXES.index('x_rotate')] //= 24.0
    coarse[:, AXES.index('x_rotate')] *= 24.0
    rougher = replace(record, reading=coarse)
    fine = residuals(block, record, nominal, nominal)
    left = residuals(block, rougher, nominal, nominal)
    assert left.keys() == {name for name in fine if not name.startswith('x_rotate')}
    for name, channel in left.items():
        np.testing.assert_array_equal(channel, fine[name])


def test_without_noise_windings_are_right_to_a_fraction_of_the_noise(nominal):
    record = log(nominal, level=0.0)
    for channel, left in residuals(WindingsBlock, record, nominal, nominal).items():
        assert rms(left) < 0.3 * CURRENT_NOISE_A, channel  # counts of Y-Rotate's motor
        if not channel.startswith('y_rotate'):
            assert rms(left) < 0.2e-3, channel


@pytest.mark.parametrize('axis', ['y_linear', 'x_rotate'])
def test_noise_of_the_sensors_makes_no_sensor_seem_wrong(nominal, axis):
    """By means over a cycle, within which the loop answers the noise, lines 1 seem 60 to 90 % wrong."""
    print(f'seed {SEED}')
    noisy = nominal.with_overlay(noise(nominal, 1.0, SEED, np.random.default_rng(SEED)))
    twin = Twin.of(noisy.model(), Timing(), load_experiment('constant'))
    record = record_of_signals('standing', twin.advance(Timing().ticks(DURATION_S)))
    effect = find('phase_gain_mismatch')
    wrong = effect.apply(nominal, axis, {'line_1': 0.01, 'line_2': 0.01})
    right = residuals(WindingsBlock, record, nominal, nominal)
    changed = residuals(WindingsBlock, record, nominal, wrong)
    for channel in (f'{axis} line 1', f'{axis} line 2'):
        by_one_percent = changed[channel] - right[channel]
        square = by_one_percent @ by_one_percent
        estimate = -0.01 * (by_one_percent @ right[channel]) / square
        assert abs(estimate) < 4.0 * 0.01 * rms(right[channel]) / math.sqrt(square), channel


def test_without_noise_no_sensor_of_the_fastest_motor_seems_wrong(nominal):
    twin = Twin.of(nominal.model(), Timing(), load_experiment('random_y_rotate'))
    record = record_of_signals('random', twin.advance(18000))
    effect = find('phase_gain_mismatch')
    wrong = effect.apply(nominal, 'y_rotate', {'line_1': 0.01, 'line_2': 0.01})
    right = residuals(WindingsBlock, record, nominal, nominal)
    for channel, left in residuals(WindingsBlock, record, nominal, wrong).items():
        by_one_percent = left - right[channel]
        if not by_one_percent.any():
            continue
        estimate = -0.01 * (by_one_percent @ right[channel]) / (by_one_percent @ by_one_percent)
        assert abs(estimate) < 2e-4, channel  # 6e-4 if smoothed by a cubic over 1.7 ms


IN_AMPLIFIER = {
    'commutation_offset': 'y_linear',
    'current_loop_gain': 'x_rotate',
    'current_loop_integral': 'y_rotate',
    'dead_time': 'y_linear',
    'amplifier_filter': 'x_rotate',
}
IN_WINDINGS = {
    'current_offset': 'x_rotate',
    'phase_gain_mismatch': 'y_linear',
    'winding_temperature': 'x_rotate',
    'winding_imbalance': 'y_rotate',
    'force_constant': 'y_linear',
    'torque_ripple': 'y_linear',
    'motor_saturation': 'y_rotate',
}


@pytest.mark.parametrize(('name', 'axis'), [*IN_AMPLIFIER.items(), *IN_WINDINGS.items()])
def test_an_effect_of_the_drive_shows_in_its_part_on_its_axis_alone(nominal, name, axis):
    true = with_effect(nominal, name, axis)
    record = log(true, model_of_noise=nominal)
    loud, quiet = (
        (AmplifierBlock, WindingsBlock)
        if name in IN_AMPLIFIER
        else (WindingsBlock, AmplifierBlock)
    )
    before, after = (residuals(loud, record, nominal, one) for one in (nominal, true))
    for channel in before:
        if channel.startswith(axis):
            assert rms(before[channel]) > 2.0 * rms(after[channel]), channel
            assert loud is WindingsBlock or np.abs(after[channel]).max() < 1e-6
        else:
            assert rms(before[channel]) == pytest.approx(rms(after[channel]), rel=1e-6, abs=1e-12)
    before, after = (residuals(quiet, record, nominal, one) for one in (nominal, true))
    for channel in before:
        assert rms(before[channel]) == pytest.approx(rms(after[channel]), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize('name', ['encoder_scale', 'motor_encoder_delay'])
def test_the_motion_is_seen_through_the_encoders_of_the_model(nominal, name):
    axis = 'y_rotate' if name.startswith('motor') else 'y_linear'
    true = with_effect(nominal, name, axis)
    record = log(true, model_of_noise=nominal)
    before, after = (residuals(WindingsBlock, record, nominal, one) for one in (nominal, true))
    assert rms(before[f'{axis} line 1']) > 2.0 * rms(after[f'{axis} line 1'])


def test_a_log_that_begins_in_the_middle_is_followed(nominal):
    record = log(nominal)
    middle = round(0.15 * record.timing.servo_hz) * record.timing.servo_divider
    rows = middle // record.timing.encoder_divider
    cycles = middle // record.timing.servo_divider
    later = replace(
        record,
        line_current=record.line_current[middle:],
        reading=record.reading[rows:],
        commanded=record.commanded[cycles:],
        command=record.command[cycles:],
        terminals=record.terminals.part(slice(middle, None)),
    )
    for left in residuals(AmplifierBlock, later, nominal, nominal).values():
        assert np.abs(left).max() < 1e-6
    for channel, left in residuals(WindingsBlock, later, nominal, nominal).items():
        assert rms(left) < 1.1 * CURRENT_NOISE_A, channel


def test_bridges_that_were_off_are_off_in_the_replay(nominal):
    """A drive that was switched off for a while puts out nothing, and goes on as the logged one."""
    twin = Twin.of(nominal.model(), Timing(), load_experiment('constant'))
    ticks = Timing().ticks(0.1)
    parts = []
    for off in (0, 1, 0):
        twin.amplifier_state['safe_torque_off'][0, 1] = off
        parts.append(record_of_signals('part', twin.advance(ticks)))
    whole = replace(
        parts[0],
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ('line_current', 'reading', 'commanded', 'command')
        },
        terminals=replace(
            parts[0].terminals,
            **{
                name: np.concatenate([getattr(part.terminals, name) for part in parts])
                for name in ('current', 'voltage', 'off')
            },
        ),
    )
    assert set(whole.terminals.off) == {0, 2}
    for left in residuals(AmplifierBlock, whole, nominal, nominal).values():
        assert np.abs(left).max() < 1e-9
    for left in residuals(WindingsBlock, whole, nominal, nominal).values():
        assert rms(left) < 1e-3


def test_blocks_are_those_that_the_log_has_the_signals_for(nominal):
    record = log(nominal)
    kinds = {
        'everything': record,
        'no voltages': without_voltages(record),
        'no terminals': replace(record, terminals=None),
        'no command': replace(record, command=None),
        'voltages lack': replace(
            record, terminals=replace(record.terminals, current=np.full((record.ticks, 6), np.nan))
        ),
    }
    found = {
        kind: {block for block, parts in Problem(nominal, [one]).blocks.items() if parts}
        for kind, one in kinds.items()
    }
    assert found == {
        'everything': {PLANT, CONTROLLER, AMPLIFIER, WINDINGS},
        'no voltages': {PLANT, CONTROLLER, CURRENT_LOOP},
        'no terminals': {PLANT, CONTROLLER},
        'no command': {PLANT, WINDINGS},
        'voltages lack': {PLANT, CONTROLLER},
    }


@pytest.mark.parametrize(
    ('name', 'with_voltages', 'without'),
    [
        ('coulomb_friction', {PLANT}, {PLANT}),
        ('wrong_inertia', {PLANT}, {PLANT}),
        ('winding_temperature', {PLANT, WINDINGS}, {PLANT, CURRENT_LOOP}),
        ('current_offset', {PLANT, WINDINGS}, {PLANT, CURRENT_LOOP}),
        ('dead_time', {AMPLIFIER}, {CURRENT_LOOP}),
        ('i2t_foldback', {AMPLIFIER}, {CURRENT_LOOP}),
        ('output_limit', {CONTROLLER}, {CONTROLLER}),
        ('encoder_scale', {PLANT, WINDINGS}, {PLANT, CURRENT_LOOP}),
    ],
)
def test_effects_touch_the_blocks_that_read_what_they_change(
    nominal, name, with_voltages, without
):
    record = log(nominal)
    effect = find(name)
    problem, blind = Problem(nominal, [record]), Problem(nominal, [without_voltages(record)])
    assert set(problem.touched(effect, 'x_rotate')) == with_voltages
    assert set(blind.touched(effect, 'x_rotate')) == without


def test_variants_differ_in_no_other_block_than_is_said(nominal):
    """Every number of the dense effect alone: only force constants go into the windings."""
    record = log(nominal)
    effects, numbers = nuisance(nominal, [record], Settings())
    problem = Problem(nominal, [record]).with_prior(prior_groups(numbers))
    blocks = {PLANT, CONTROLLER, AMPLIFIER, WINDINGS, PRIOR}
    for dense, item in (
        (dense, item) for dense, group in zip(effects, prior_groups(numbers), strict=True)
        for item in numbers if item.path in group
    ):  # fmt: skip
        nothing = dict.fromkeys(dense.typical(nominal, 'y_linear'), 0.0)
        before = dense.apply(nominal, 'y_linear', nothing)
        assert problem.between(before, before) == ()
        after = dense.apply(nominal, 'y_linear', {**nothing, item.path: item.spread})
        said = set(problem.between(before, after))
        assert (WINDINGS in said) == (item.section == 'motors')
        for block in blocks - said:
            pairs = zip(
                problem.residuals(before, block), problem.residuals(after, block), strict=True
            )
            assert all(one.tobytes() == two.tobytes() for one, two in pairs), (item.path, block)
