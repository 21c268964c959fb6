# SPDX-License-Identifier: Apache-2.0
"""The plant driven by a log: what its observer must not do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.contract import ENCODERS
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals import plant_block
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.synthesis import with_noise

SEED = 20


def record_of(variant, experiment, duration_s):
    """Return the noise-free log of a model."""
    timing = Timing()
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, variant.name)
    twin.commanded = commanded_positions(
        load_experiment(experiment), twin.servo_parameters, timing.servo_hz
    )
    return record_of_signals('log', twin.advance(timing.ticks(duration_s)))


@given(
    late=st.tuples(*[st.floats(-20.0, 20.0)] * 3),
    seed=st.integers(0, 2**32 - 1),
)
@settings(derandomize=True, deadline=None)
def test_a_moved_current_has_the_means_of_later_ticks(late, seed):
    """The integral over a tick that begins later, of a current that is held for each tick."""
    current = np.random.default_rng(seed).standard_normal((60, 3))
    edges = np.arange(61.0)
    found = plant_block._moved(current, np.array(late))
    for place, ticks in enumerate(late):
        total = np.concatenate([[0.0], np.cumsum(current[:, place])])
        begin = np.interp(edges[:-1] + ticks, edges, total)
        end = np.interp(edges[1:] + ticks, edges, total)
        inside = (edges[:-1] + ticks >= 0.0) & (edges[1:] + ticks <= 60.0)
        np.testing.assert_allclose(found[inside, place], (end - begin)[inside], atol=1e-9)
        outside = current[0, place] if ticks < 0.0 else current[-1, place]
        np.testing.assert_allclose(found[edges[:-1] + ticks >= 60.0, place], outside)
        np.testing.assert_allclose(found[edges[1:] + ticks <= 0.0, place], outside)


def test_a_moved_current_is_known_where_it_was():
    current = np.ones((60, 3))
    current[20:30, 1] = np.nan
    moved = plant_block._moved(current, np.array([0.0, 4.5, 0.0]))
    assert np.isfinite(moved[np.isfinite(current)]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ('name', 'experiment'),
    [
        ('cable_compliance:y_linear', 'swept_sine_y_linear'),  # gently: a cable can go slack
        ('payload_bearing_compliance:y_linear', 'step'),
        ('bearing_moment_compliance:x_rotate', 'step'),
        ('gearbox_compliance:y_rotate', 'step'),
        ('belt_compliance:y_rotate', 'step'),
    ],
)
def test_what_gives_next_to_nothing_is_seen_as_what_does_not_give(name, experiment):
    """
    Two encoders of a rigid drive, or a carriage and its counterweight, are held as one.

    If the model with a stiff connection were held by more encoders, or pulled at on one side, it would
    explain any log better or worse than the rigid one, whatever gives.
    """
    nominal = Variant.of(load_model('rigid'))
    record = record_of(nominal, experiment, 0.3)
    block = PlantBlock(record, nominal)
    effect, axis = find(name.split(':')[0]), name.split(':')[1]
    (parameter,) = effect.parameters(nominal, axis)
    stiff = effect.apply(nominal, axis, {parameter.name: 1e-6 * parameter.typical})
    for rigid, other in zip(block.residuals(nominal), block.residuals(stiff), strict=True):
        assert np.sqrt(np.mean((other - rigid) ** 2)) < 0.01 * np.sqrt(np.mean(rigid**2))


@pytest.mark.slow
@pytest.mark.parametrize('name', ['backlash', 'gearbox_compliance', 'belt_compliance'])
def test_a_motor_is_followed_through_what_joins_it_to_its_load(name):
    """
    The model with the true cause explains the motor's encoder to a count, with noise in the readings.

    Held by the load alone, its motor would bounce between the flanks of the play, dozens of counts.
    """
    seed = 7
    print(f'seed {seed}')
    nominal = Variant.of(load_model('rigid'))
    effect = find(name)
    variant = effect.apply(nominal, 'y_rotate', effect.typical(nominal, 'y_rotate'))
    record = record_of(variant, 'step', 0.6)
    noise = np.random.default_rng(seed).normal(scale=0.5, size=record.reading.shape)
    record = replace(record, reading=np.round(record.reading + noise))
    block = PlantBlock(record, nominal)
    motor = block.channels.index('y_rotate_motor')
    wrong, right = (np.std(block.residuals(model)[motor]) for model in (nominal, variant))
    assert right < 1.0
    assert wrong > 5.0


def test_the_finest_encoder_of_an_axis_holds_it():
    """
    The steps of a coarse encoder are in its own residual alone, where the model is true.

    Held by the coarse one, motor and load would be moved by its steps, and the motor's encoder would
    show them: 5.1 counts.
    """
    nominal = Variant.of(load_model('rigid'))
    record = record_of(nominal, 'random_y_rotate', 0.3)
    coarse, load = 16.0, 2
    reading = record.reading.copy()
    reading[:, load] = coarse * np.floor(reading[:, load] / coarse) + (coarse - 1.0) / 2.0
    resolution = (1.0, 1.0, coarse, 1.0)
    block = PlantBlock(replace(record, reading=reading, resolution=resolution), nominal)
    spread = dict(zip(block.channels, map(np.std, block.residuals(nominal)), strict=True))
    assert spread['y_rotate_motor'] < 0.5
    assert 2.0 < spread['y_rotate_load'] < coarse / np.sqrt(12.0)


@pytest.mark.slow
def test_noise_of_readings_does_not_set_a_true_model_ringing():
    """A gearbox that rings at 1.2 kHz, for hundreds of cycles: once the rigid model was as likely."""
    nominal = Variant.of(load_model('rigid'))
    cause = Cause(find('gearbox_compliance'), 'y_rotate', {'compliance': 2.665e-6})
    machine = apply_all(nominal, (cause,))
    gains = []
    for seed in range(1, 4):
        print(f'seed {seed}')
        noisy = with_noise(machine, nominal, 1.0, np.random.default_rng(seed))
        problem = Problem(nominal, [record_of(noisy, 'step', 0.8)])
        gains.append(evaluate(problem, (cause,)).log_likelihood - evaluate(problem).log_likelihood)
    assert 2.0 * sum(gains) > 250.0  # 162 where such a spring was corrected as one with play


@pytest.mark.slow
@pytest.mark.parametrize('name', ['backlash', 'gearbox_compliance', 'belt_compliance'])
@pytest.mark.parametrize('size', [0.01, 0.1, 1.0])
def test_what_could_give_explains_no_drive_that_is_rigid(name, size):
    """A motor that is let go must not be followed better than a rigid one just by its own encoder."""
    seed = 11
    print(f'seed {seed}')
    nominal = Variant.of(load_model('rigid'))
    record = record_of(nominal, 'random_y_rotate', 0.4)
    noise = np.random.default_rng(seed).normal(scale=0.3, size=record.reading.shape)
    problem = Problem(nominal, [replace(record, reading=np.round(record.reading + noise))])
    effect = find(name)
    typical = effect.typical(nominal, 'y_rotate')
    cause = Cause(effect, 'y_rotate', {key: size * value for key, value in typical.items()})
    assert evaluate(problem, (cause,)).log_likelihood < evaluate(problem).log_likelihood


@pytest.mark.slow
@pytest.mark.parametrize(
    'name',
    [
        'coulomb_friction:x_rotate',
        'cogging:y_linear',
        'bearing_moment_compliance:x_rotate',  # rings at 75 Hz
        'belt_compliance:y_rotate',
        'backlash:y_rotate',
        'encoder_delay:y_rotate',
        'phase_gain_mismatch:x_rotate',
    ],
)
def test_steps_as_long_as_the_encoders_cycle_show_what_a_cause_changes(name):
    """Half of the time for it; the difference from the exact change is a few percent of its power."""
    nominal = Variant.of(load_model('rigid'))
    axis = name.split(':')[1]
    block = PlantBlock(record_of(nominal, f'random_{axis}', 0.3), nominal)
    quick = block.in_encoder_ticks()
    assert quick.record.ticks * block.record.timing.encoder_divider == block.record.ticks
    effect = find(name.split(':')[0])
    values = {
        item.name: item.neutral + 0.3 * (item.typical - item.neutral)
        for item in effect.parameters(nominal, axis)
    }
    other = effect.apply(nominal, axis, values)
    exact, near = (
        np.concatenate(one.residuals(other)) - np.concatenate(one.residuals(nominal))
        for one in (block, quick)
    )
    assert np.sqrt(np.mean((near - exact) ** 2)) < 0.05 * np.sqrt(np.mean(exact**2))


@pytest.mark.parametrize('duration_s', [0.1, 0.2, 0.5])
def test_the_autoregression_reaches_back_a_hundredth_of_a_second_if_the_log_is_long(duration_s):
    """24 samples of the servo are what shakes at 94 Hz once round; twenty samples tell a coefficient."""
    nominal = Variant.of(load_model('rigid'))
    record = record_of(nominal, 'step', duration_s)
    block = PlantBlock(record, nominal)
    shortest = min(map(len, block.residuals(nominal)))
    assert block.order == min(24, shortest // 20)
    assert (block.order == 24) == (duration_s == 0.5)
    assert all(noise.order == block.order for noise in block.noises)


@pytest.mark.parametrize('rows', [2, 7])
def test_what_is_left_over_is_continuous_in_a_delay(rows):
    """Beside a whole number of rows the reading before becomes the next one, wherever each was taken."""
    nominal = Variant.of(load_model('rigid'))
    record = record_of(nominal, 'step', 0.3)
    random = np.random.default_rng(SEED)
    row_s = 1.0 / record.timing.encoder_hz
    noisy = replace(
        record,
        reading=record.reading + 3.0 * random.standard_normal(record.reading.shape),
        late_s=row_s * random.uniform(-0.5, 0.5, record.reading.shape),
    )
    block, delay = PlantBlock(noisy, nominal), find('encoder_delay')
    before, after = (
        block.innovations(delay.apply(nominal, 'x_rotate', {'delay': 1e3 * row_s * late}))
        for late in (rows - 1e-6, rows + 1e-6)
    )
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4)


@pytest.mark.parametrize('late_ms', [0.05, 0.4, 1.3])
def test_a_late_encoder_is_a_late_log(late_ms):
    """With friction, too: readings and drive, as much later as each other, leave the same over."""
    nominal = Variant.of(load_model('rigid'))
    record = record_of(nominal, 'step', 0.3)
    random = np.random.default_rng(SEED)
    reading = record.reading + 3.0 * random.standard_normal(record.reading.shape)
    reading[:, [name != 'y_linear' for name in ENCODERS]] = np.nan
    lines = record.line_current
    current = np.zeros((len(lines), 3))
    current[:, 0] = np.repeat(np.cumsum(random.standard_normal(len(lines) // 60)), 60)
    none = np.full_like(lines, np.nan)
    alone = replace(record, reading=reading, line_current=none, current=current)
    rubs = find('coulomb_friction').apply(nominal, 'y_linear', {'friction': 10.0})

    def left_over(later_ms):
        late = find('encoder_delay').apply(rubs, 'y_linear', {'delay': 0.2 + later_ms})
        both = replace(late, skew_s={'y_linear': 1e-4 + 1e-3 * later_ms})
        return PlantBlock(alone, nominal).innovations(both)[0]

    one, other = left_over(0.0), left_over(late_ms)
    np.testing.assert_allclose(other, one, atol=1e-6 * float(np.abs(one).max()))
    frictionless = find('encoder_delay').apply(nominal, 'y_linear', {'delay': 0.2})
    without = PlantBlock(alone, nominal).innovations(frictionless)[0]
    assert np.abs(one - without).max() > 0.1
