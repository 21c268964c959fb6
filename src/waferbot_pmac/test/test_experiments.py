# SPDX-License-Identifier: Apache-2.0
"""Experiments: the shipped ones, what the forms mean, and what is said about mistakes."""

import contextlib
import json
from importlib import resources

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.package_data import package_data
from waferbot_pmac import experiments
from waferbot_pmac.experiments import (
    commanded_positions,
    load_experiment,
    shipped_experiments,
)
from waferbot_pmac.i_variables import servo_parameters
from waferbot_pmac.settings import load_settings

RATE = 2250.0
PARAMETERS = servo_parameters(
    load_settings(package_data('waferbot_pmac', 'config', 'pmac.yaml')).settings
)


def positions(text, parameters=PARAMETERS):
    return commanded_positions(load_experiment(text), parameters, RATE)


def motion(duration_s, axis, content):
    return f'name: a\nduration_s: {duration_s}\nmotion:\n  {axis}: {{{content}}}\n'


def test_the_schema_is_a_schema():
    text = resources.files(experiments).joinpath('experiment.schema.json').read_text()
    jsonschema.Draft202012Validator.check_schema(json.loads(text))


def test_what_must_be_shipped_is_shipped():
    wanted = {'step', 'constant', 'wafer_exchange'}
    for axis in AXES:
        for kind in ('step', 'full_stroke', 'swept_sine', 'multisine', 'slow_velocity', 'random'):
            wanted.add(f'{kind}_{axis}')
    assert wanted <= set(shipped_experiments())


@pytest.mark.parametrize('name', shipped_experiments())
def test_shipped_experiment_runs_within_the_limits_of_the_machine(name):
    experiment = load_experiment(name)
    assert experiment.name == name
    assert experiment.description
    commanded = commanded_positions(experiment, PARAMETERS, RATE)
    assert commanded.shape == (round(experiment.duration_s * RATE), 3)
    assert commanded.dtype == np.float64
    assert np.isfinite(commanded).all()
    assert not commanded[:45].any()  # at rest for the first 20 ms
    moved = {axis for place, axis in enumerate(AXES) if commanded[:, place].any()}
    named = [axis for axis in AXES if name.endswith(axis)]
    if named:
        assert moved == set(named)
    if name.startswith(('full_stroke', 'slow_velocity', 'wafer', 'swept', 'multisine')):
        velocity = np.abs(np.diff(commanded, axis=0)).max(axis=0) * RATE
        assert (velocity <= PARAMETERS['Ixx16'][0] * 1e3 * (1 + 1e-9)).all()
    if name.startswith(('full_stroke', 'slow_velocity', 'wafer', 'swept')):
        assert not commanded[-1].any()
    if name.startswith(('full_stroke', 'wafer')):
        acceleration = np.abs(np.diff(commanded, 2, axis=0)).max(axis=0) * RATE**2
        limit = np.maximum(PARAMETERS['Ixx17'], PARAMETERS['Ixx19'])[0] * 1e6
        assert (acceleration <= limit * (1 + 1e-6)).all()
        assert (acceleration[[place for place in range(3) if AXES[place] in moved]] > 0).all()


def test_the_step_of_the_thesis_in_whole_counts():
    commanded = positions('step')
    assert not commanded[:45].any()
    assert (commanded[45:] == [2500, 800, 1000]).all()


def test_amplitudes_in_radians_become_whole_counts():
    commanded = positions(motion(0.1, 'x_rotate', 'kind: step, amplitude_rad: 4.794e-3'))
    assert set(commanded[:, 1]) == {800.0}


def test_an_axis_that_is_not_named_holds():
    commanded = positions(motion(0.1, 'x_rotate', 'kind: constant, position_counts: 5'))
    assert commanded.tolist() == [[0.0, 5.0, 0.0]] * 225


def test_slow_velocity_goes_there_waits_and_comes_back_at_the_same_speed():
    commanded = positions('slow_velocity_y_linear')[:, 0] / 1e7
    velocity = np.diff(commanded) * RATE
    assert commanded.max() == pytest.approx(0.064)
    assert (commanded == commanded.max()).sum() == pytest.approx(0.2 * RATE, abs=2)
    steady = np.isclose(np.abs(velocity), 0.02, rtol=1e-9, atol=0.0)
    assert steady.mean() > 0.8
    assert (velocity[steady] > 0).sum() == pytest.approx((velocity[steady] < 0).sum(), abs=2)


def test_program_blends_linear_moves_and_stops_at_a_dwell():
    text = """
name: a
duration_s: 3
program:
  - {linear: {y_linear_m: 0.1}, move_time_s: 0.5}
  - {linear: {y_linear_m: 0.2, x_rotate_rad: 0.1}, move_time_s: 0.5}
  - {dwell_s: 0.1}
  - {linear: {y_linear_m: 0.3}, move_time_s: 0.5}
"""
    commanded = positions(text)
    y = commanded[:, 0] / 1e7
    velocity = np.diff(y) * RATE
    # one blended sequence of 0.5 + 0.5 + 0.1 s (TA = 2 * 50 ms) at 0.2 m/s, then 0.1 s of rest
    assert velocity[int(0.11 * RATE) : int(0.99 * RATE)] == pytest.approx(0.2, rel=1e-6)
    rest = slice(int(1.1 * RATE) + 1, int(1.2 * RATE) - 1)
    assert (y[rest] == 0.2).all()
    assert y[int(1.8 * RATE) + 1] == pytest.approx(0.3)
    counts = 0.1 * PARAMETERS['counts_per_unit'][0, 1]
    assert not commanded[: int(0.5 * RATE), 1].any()
    assert (commanded[int(1.1 * RATE) + 1 :, 1] == counts).all()


def test_rapid_program_arrives_together_and_stays():
    text = """
name: a
duration_s: 2
program:
  - {dwell_s: 0.1}
  - {rapid: {y_linear_m: 0.2, y_rotate_rad: 0.5}}
"""
    commanded = positions(text)
    units = PARAMETERS['counts_per_unit'][0]
    assert commanded[-1] / units == pytest.approx([0.2, 0.0, 0.5])
    assert not commanded[: int(0.1 * RATE) + 1].any()
    velocity = np.abs(np.diff(commanded, axis=0)).max(axis=0) * RATE / units
    assert velocity[0] == pytest.approx(0.5, rel=1e-6)  # Ixx16 of the axis that takes longest
    assert velocity[2] == pytest.approx(0.5 / 0.4, rel=1e-6)


def test_jog_takes_speed_and_times_from_the_i_variables():
    commanded = positions(motion(2, 'y_linear', 'kind: jog, distance_m: 0.1'))
    velocity = np.diff(commanded[:, 0]) * RATE
    assert velocity.max() == pytest.approx(2500e3, rel=1e-9)
    acceleration = np.diff(velocity) * RATE
    assert acceleration.max() == pytest.approx(2500e3 / 0.08, rel=1e-2)  # Ixx20 - Ixx21 = 80 ms


def test_acceleration_times_are_whole_milliseconds():
    content = 'kind: linear, distance_m: 0.01, move_time_s: 0.2, s_curve_time_s: 0'
    exact = positions(motion(1, 'y_linear', f'{content}, acceleration_time_s: 0.05'))
    rounded = positions(motion(1, 'y_linear', f'{content}, acceleration_time_s: 0.0503'))
    assert (exact == rounded).all()


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('duration_s: 1\nmotion: {y_linear: {kind: constant}}', ['name is missing']),
        ('name: a\nduration_s: 0\nmotion: {y_linear: {kind: constant}}', ['line 2', 'duration_s']),
        ('name: a\nduration_s: 1\n', ['motion or program']),
        ('name: a\nduraton_s: 1\nmotion: {}', ['line 2', 'duraton_s', "'duration_s'"]),
        ('name: a\nduration_s: 1\nmotoin: {}', ['line 3', 'motoin', "'motion'"]),
        ('name: a\nduration_s: 1\nmotion:\n  z: {kind: constant}', ['line 4', 'z']),
        ('name: a\nduration_s: 1\nmotion:\n  y_linear:\n    kind: stp', ['line 5', 'stp', 'step']),
        ('name: a\nduration_s: 1\nmotion:\n  y_linear: {start_s: 1}', ['line 4', 'kind']),
        (motion(1, 'y_linear', 'kind: step'), ['line 4', 'amplitude_m']),
        (
            motion(1, 'y_linear', 'kind: step, amplitude_m: 1, amplitude_counts: 2'),
            ['amplitude_counts', 'amplitude_m'],
        ),
        (motion(1, 'y_linear', 'kind: step, amplitude_rad: 1'), ['amplitude_rad', 'm or counts']),
        (motion(1, 'x_rotate', 'kind: step, amplitude_m: 1'), ['amplitude_m', 'rad or counts']),
        (motion(1, 'y_linear', 'kind: step, amplitude: 1'), ['amplitude', 'amplitude_m']),
        (motion(1, 'y_linear', "kind: step, amplitude_m: '1'"), ['amplitude_m', 'number']),
        (motion(1, 'y_linear', 'kind: step, amplitude_m: .nan'), ['amplitude_m', 'finite']),
        (motion(1, 'y_linear', 'kind: step, amplitude_m: 1, start_s: -1'), ['start_s', '-1']),
        (
            motion(
                1,
                'y_linear',
                'kind: bidirectional_step, amplitude_m: 1, return_s: 0.1, start_s: 1',
            ),
            ['return_s', 'start_s'],
        ),
        (
            motion(1, 'y_linear', 'kind: random, amplitude_m: 1, hold_s: 0.1'),
            ['seed is missing'],
        ),
        (
            motion(
                1,
                'y_linear',
                'kind: jog, distance_m: 0.1, speed_m_per_s: 1, speed_counts_per_s: 1',
            ),
            ['speed_counts_per_s'],
        ),
        (
            motion(1, 'y_linear', 'kind: linear, distance_m: 0.1'),
            ['speed_m_per_s', 'move_time_s'],
        ),
        ('name: a\nname: b', ['line 2', 'line 1', 'name']),
        ('name: a\n  b: [', ['line 2']),
        ('- a\n- b', ['mapping']),
        ('name: a\nduration_s: 1\nprogram:\n  - {dwell_s: 1, rapid: {y_linear_m: 1}}', ['line 4']),
        ('name: a\nduration_s: 1\nprogram:\n  - {rapid: {y_linear_rad: 1}}', ['y_linear_rad']),
        (
            'name: a\nduration_s: 1\nprogram:\n  - {rapid: {y_linear_m: 1, y_linear_counts: 1}}',
            ['line 4', 'y_linear_counts'],
        ),
        (
            'name: a\nduration_s: 1\nprogram:\n  - {dwell_s: 1}\n  - {dwell_s: 1, move_time_s: 1}',
            ['line 5', 'move_time_s', 'linear'],
        ),
    ],
)
def test_mistakes_are_located(text, words):
    with pytest.raises(UserError) as caught:
        positions(text + '\n')
    assert '\n' not in str(caught.value)
    for word in ['experiment text', *words]:
        assert word in str(caught.value)


def test_motions_in_a_list_are_added():
    one = (
        'kind: linear, start_s: 0.1, distance_m: 0.01, move_time_s: 0.2, acceleration_time_s: 0.1'
    )
    other = 'kind: swept_sine, amplitude_m: 1.0e-4, first_frequency_hz: 1, last_frequency_hz: 50'
    both = f'name: a\nduration_s: 0.6\nmotion:\n  y_linear: [{{{one}}}, {{{other}}}]\n'
    alone = [positions(motion(0.6, 'y_linear', text)) for text in (one, other)]
    assert alone[1].any()
    assert positions(both) == pytest.approx(alone[0] + alone[1], abs=1e-9)


def test_a_mistake_in_a_list_of_motions_is_told_with_its_line():
    text = (
        'name: a\nduration_s: 1\nmotion:\n  y_linear:\n    - {kind: constant}\n'
        '    - {kind: step, amplitude_rad: 1}\n'
    )
    with pytest.raises(UserError, match=r'line 6.*y_linear is measured in m or counts'):
        positions(text)
    with pytest.raises(UserError, match=r'line 6.*amplitude'):
        positions(text.replace('amplitude_rad', 'amplitud_m'))
    with pytest.raises(UserError, match='y_linear'):
        positions('name: a\nduration_s: 1\nmotion: {y_linear: []}\n')


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        (motion(0.1, 'y_linear', 'kind: rapid, distance_m: 0.3'), ['line 4', 'after duration_s']),
        (motion(1e-5, 'y_linear', 'kind: constant'), ['line 2', 'duration_s', 'servo cycle']),
        (
            motion(
                1,
                'y_linear',
                'kind: multisine, amplitude_m: 1, period_s: 1, '
                'first_frequency_hz: 1, last_frequency_hz: 1200',
            ),
            ['last_frequency_hz', '1125'],
        ),
        (
            motion(
                1,
                'y_linear',
                'kind: multisine, amplitude_m: 1, period_s: 0.1, '
                'first_frequency_hz: 1, last_frequency_hz: 9',
            ),
            ['period_s', 'harmonic'],
        ),
        (
            motion(
                1,
                'y_linear',
                'kind: linear, distance_m: 0.1, speed_m_per_s: 0.5, '
                'acceleration_time_s: 0.0001, s_curve_time_s: 0',
            ),
            ['zero'],
        ),
        (
            'name: a\nduration_s: 1\nprogram:\n  - {dwell_s: 0.5}\n  - {rapid: {y_linear_m: 1}}\n',
            ['line 5', 'after duration_s'],
        ),
    ],
)
def test_what_cannot_be_commanded_is_located(text, words):
    with pytest.raises(UserError) as caught:
        positions(text)
    for word in words:
        assert word in str(caught.value)


def test_a_velocity_that_overflows_the_controllers_register_is_refused():
    fast = servo_parameters({'y_linear': {'counts_per_unit': 1e7, 'Ixx16': 1e5, 'Ixx17': 1e4}})
    content = 'kind: linear, distance_m: 0.3, acceleration_time_s: 0.01, s_curve_time_s: 0'
    at_the_limit = 805306368 / 96 / 1e7
    for speed, fits in ((at_the_limit * 0.999, True), (at_the_limit * 1.001, False)):
        text = motion(1, 'y_linear', f'{content}, speed_m_per_s: {speed}')
        if fits:
            positions(text, fast)
        else:
            with pytest.raises(UserError, match='velocity register'):
                positions(text, fast)


def test_unknown_name_is_told_with_the_known_ones():
    with pytest.raises(UserError, match=r"did you mean 'step'.*wafer_exchange"):
        load_experiment('stp')


def test_experiment_from_a_file(tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text(motion(0.1, 'y_linear', 'kind: constant'))
    experiment = load_experiment(path)
    assert experiment.name == 'a'
    assert experiment.text == path.read_text()
    path.write_text('name: 3\n')
    with pytest.raises(UserError, match=r'mine\.yaml, line 1'):
        load_experiment(str(path))


_scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6)
_keys = st.sampled_from(
    ['name', 'duration_s', 'motion', 'program', 'y_linear', 'kind', 'step', 'rapid', 'linear']
)
_documents = st.recursive(
    _scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_keys, inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None)
@given(st.one_of(st.text(max_size=80), _documents.map(json.dumps)))
def test_any_text_is_an_experiment_or_an_error_of_the_user(text):
    with contextlib.suppress(UserError):
        load_experiment(text + '\n')


@pytest.mark.parametrize(
    'content',
    [
        'kind: random, start_s: 0.1, hold_s: 0.02, amplitude_counts: 100, seed: {}',
        'kind: multisine, start_s: 0.1, period_s: 0.1, first_frequency_hz: 10, '
        'last_frequency_hz: 90, amplitude_counts: 100, seed: {}',
    ],
)
def test_a_seed_may_be_written_as_a_whole_number_with_a_point(content):
    whole, with_point = (
        positions(motion(0.5, 'y_linear', content.format(seed))) for seed in ('7', '7.0')
    )
    assert whole.any()
    np.testing.assert_array_equal(whole, with_point)
