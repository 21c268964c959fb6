# SPDX-License-Identifier: Apache-2.0
"""Times out of order, doubled, with gaps; grids; and signals that do not fit one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.build import lattice_step
from waferbot_twin.logs.checks import check_signals
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.logs.timebase import in_order, longest_step_s, unwrap


def place(row):
    return f'log, line {row + 1}'


def ordered(time, values=None):
    table = None if values is None else np.asarray(values, float)[:, None]
    rows, findings = in_order(np.asarray(time, float), table, 'log', place)
    return rows.tolist(), '\n'.join(map(str, findings))


@settings(deadline=None)
@given(st.permutations(list(range(7))), st.integers(0, 50))
def test_rows_that_came_a_little_late_are_sorted(order, begin) -> None:
    time = np.arange(60.0)
    time[begin : begin + 7] = begin + np.array(order)
    rows, said = ordered(time)
    assert time[rows].tolist() == np.arange(60.0).tolist()
    assert bool(said) == (order != sorted(order))


@given(st.integers(1, 98))
def test_a_buffer_that_rolled_over_is_turned_back(start) -> None:
    rows, said = ordered(np.roll(np.arange(99.0), start))
    assert rows == np.roll(np.arange(99), -start).tolist()
    assert f'line {start + 1}: time goes back' in said


def test_of_a_clock_that_was_set_back_only_the_longest_stretch_is_used() -> None:
    rows, said = ordered([*range(20), *range(50), *range(30)])
    assert rows == list(range(20, 70))
    assert '50 rows claim times that longer stretches have already' in said


def test_doubled_and_contradicting_times() -> None:
    rows, said = ordered(
        [0, 1, 1, 2, 3, 3, 4, 5, 6, 7, 8, 9], [0, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]
    )
    assert rows == [0, 1, 3, 4, 6, 7, 8, 9, 10, 11]
    assert 'line 6: 1 rows have the time of the row before and other values' in said
    assert 'the same time as the row before' in said


def test_a_coarse_time_column_is_told() -> None:
    _, said = ordered(np.floor(np.arange(100) * 0.44))
    assert 'coarser than the sampling; give time.sample_time_s' in said


def test_missing_times() -> None:
    rows, said = ordered([0.0, np.nan, 2.0, np.inf])
    assert rows == [0, 2]
    assert 'line 2 and 1 more up to log, line 4: time is missing' in said


def test_a_counter_of_24_bits_runs_on() -> None:
    true = np.arange(16777200.0, 16777300.0, 4.0)
    assert unwrap(true % 2**24, 2**24).tolist() == true.tolist()


@settings(deadline=None)
@given(st.sets(st.integers(1, 198), min_size=1, max_size=4), st.floats(1e-5, 1e-1))
def test_every_missing_sample_of_even_sampling_is_a_gap(missing, step_s) -> None:
    kept = np.array([k for k in range(200) if k not in missing])
    signal = Signal('position', 'x_rotate', 'rad', kept * step_s, kept * 1.0)
    inside = {
        k
        for begin, end in signal.gaps()
        for k in range(round(begin / step_s) + 1, round(end / step_s))
    }
    assert inside == missing
    grid = MeasuredLog('log', (signal,)).on_grid(1.0 / step_s)
    known = grid.valid['x_rotate', 'position']
    assert set(np.flatnonzero(~known)) == missing
    value = grid.value['x_rotate', 'position']
    assert np.isnan(value[~known]).all()
    assert value[known] == pytest.approx(kept)


def test_jitter_is_no_gap() -> None:
    seed = 5
    print('seed', seed)
    random = np.random.default_rng(seed)
    time = np.cumsum(2.3e-3 + random.normal(0.0, 3e-4, 4000).clip(-9e-4, 9e-4))
    assert longest_step_s(time) > np.diff(time).max()


def test_grid_interpolates_positions_and_holds_commands() -> None:
    time = np.array([0.0, 1.0, 2.0, 3.0])
    position = Signal('position', 'y_linear', 'm', time, np.array([0.0, 2.0, 2.0, 6.0]))
    command = Signal(
        'commanded_position', 'y_linear', 'm', time + 0.5, np.array([1.0, 2.0, 3.0, 4.0])
    )
    grid = MeasuredLog('log', (position, command)).on_grid(4.0)
    assert grid.time_s.tolist() == (np.arange(15) / 4).tolist()
    held = grid.value['y_linear', 'commanded_position']
    assert grid.value['y_linear', 'position'][:13].tolist() == [
        0, 0.5, 1, 1.5, 2, 2, 2, 2, 2, 3, 4, 5, 6
    ]  # fmt: skip
    assert not grid.valid['y_linear', 'position'][13:].any()
    assert np.isnan(held[:2]).all()
    assert held[2:].tolist() == [1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4]
    assert grid.all_valid().tolist() == [False] * 2 + [True] * 11 + [False] * 2
    # The last command stands for one step, not for ever.
    later = command.at(np.array([4.4, 4.5, 9.0]))
    assert later[1].tolist() == [True, False, False]


def test_grid_falls_on_servo_ticks() -> None:
    """Times of ticks, as recordings have them, are grid points to the bit."""
    ticks = np.arange(3, 3000) * 8
    signal = Signal('current', 'x_rotate', 'A', ticks / 18000, np.sin(ticks * 0.01))
    grid = MeasuredLog('log', (signal,)).on_grid(2250.0)
    assert grid.time_s.tobytes() == signal.time_s.tobytes()
    assert grid.value['x_rotate', 'current'].tobytes() == signal.value.tobytes()
    assert grid.valid['x_rotate', 'current'].all()


def test_a_signal_twice_is_refused() -> None:
    signal = Signal('current', 'x_rotate', 'A', np.arange(3.0), np.arange(3.0))
    with pytest.raises(UserError, match=r'x_rotate\.current is given twice'):
        MeasuredLog('log', (signal, signal))


TIME = np.arange(4000) / 2000.0
PLACE = 0.3 * np.sin(9.0 * TIME) + 0.1 * np.sin(31.0 * TIME)
SPEED = 2.7 * np.cos(9.0 * TIME) + 3.1 * np.cos(31.0 * TIME)


def suspects(peak=None, **values):
    signals = [
        Signal(kind, 'x_rotate', unit, TIME, value, step)
        for kind, (unit, value, step) in values.items()
    ]
    found = check_signals(signals, {'x_rotate': peak} if peak else {})
    return '\n'.join(map(str, found))


def test_signals_that_fit_raise_no_suspicion() -> None:
    seed = 3
    print('seed', seed)
    noise = np.random.default_rng(seed).normal(0.0, 0.3, len(TIME))
    command = PLACE + 0.01 * np.sin(40.0 * TIME)
    assert (
        suspects(
            peak=40.0,
            position=('rad', np.floor(PLACE / 1e-4) * 1e-4, 1e-4),
            velocity=('rad/s', SPEED + noise, 0.0),
            commanded_position=('rad', command, 0.0),
            following_error=('rad', command - PLACE, 0.0),
            current=('A', 3.0 * np.sin(50.0 * TIME), 0.0),
            current_command=('A', 3.1 * np.sin(50.0 * TIME), 0.0),
        )
        == ''
    )


@pytest.mark.parametrize(
    ('factor', 'hint'),
    [
        (60.0 / (2.0 * np.pi), 'as if rpm had been taken for rad/s'),
        (-1.0, 'its sign is the other way round'),
        (0.001, 'a thousand times too small'),
        (1.3, 'velocity is 1.3 times'),
    ],
)
def test_a_wrong_velocity_is_told_with_its_factor(factor, hint) -> None:
    said = suspects(position=('rad', PLACE, 0.0), velocity=('rad/s', factor * SPEED, 0.0))
    assert hint in said
    assert 'suspect' in said


def test_other_things_that_do_not_fit() -> None:
    assert 'rms' not in suspects(current=('A', np.sin(TIME), 0.0))
    said = suspects(
        current=('A', np.sin(50.0 * TIME), 0.0),
        current_command=('A', np.sqrt(2.0) * np.sin(50.0 * TIME), 0.0),
    )
    assert 'root mean square had been taken for the peak' in said
    assert 'the drive gives 40 A at most' in suspects(40.0, current=('A', 3e3 * PLACE, 0.0))
    assert 'throughout: it tells nothing' in suspects(current=('A', 0.0 * TIME, 0.0))
    assert 'no multiples of its step' in suspects(position=('rad', PLACE, 0.01))
    flipped = suspects(
        position=('rad', PLACE, 0.0),
        commanded_position=('rad', 1.1 * PLACE, 0.0),
        following_error=('rad', -0.1 * PLACE, 0.0),
    )
    assert 'following_error is -1 times commanded minus actual position' in flipped


@settings(deadline=None, max_examples=60)
@given(
    step=st.floats(1e-7, 1e2),
    shift=st.floats(-0.5, 0.5),
    span=st.integers(20, 5000),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_step_of_quantised_values_is_found(step, shift, span, seed) -> None:
    random = np.random.default_rng(seed)
    counts = np.cumsum(random.integers(-1, 2, span))
    counts = np.append(counts, np.arange(12))
    assert lattice_step((counts + shift) * step) == pytest.approx(step, rel=1e-6)


@settings(deadline=None, max_examples=60)
@given(count=st.integers(20, 3000), seed=st.integers(0, 2**32 - 1))
def test_values_without_a_step_have_none(count, seed) -> None:
    random = np.random.default_rng(seed)
    assert lattice_step(random.normal(size=count)) == 0.0
    assert lattice_step(np.sin(np.arange(count) * 0.0137)) == 0.0
    assert lattice_step(np.zeros(count)) == 0.0


def test_the_mean_of_what_is_held_is_that_of_its_steps() -> None:
    held = Signal(
        'current',
        'x_rotate',
        'A',
        np.arange(5.0),
        np.array([1.0, 3.0, 2.0, 5.0, 4.0]),
        hold='zero_order',
    )
    straight = replace(held, hold='linear')
    edges_s = np.array([-1.0, 0.0, 0.5, 1.25, 3.5, 4.0, 9.0])
    means = held.means(edges_s)
    assert means[1:5] == pytest.approx(
        [1.0, (0.5 * 1 + 0.25 * 3) / 0.75, (2.25 + 2.0 + 2.5) / 2.25, 5.0]
    )
    assert np.isnan(means[[0, 5]]).all()
    assert straight.means(edges_s)[1:5] == pytest.approx(
        straight.at(0.5 * (edges_s[1:5] + edges_s[2:6]))[0]
    )
