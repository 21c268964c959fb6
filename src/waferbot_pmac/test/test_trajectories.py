# SPDX-License-Identifier: Apache-2.0
"""Trajectories against closed forms, numeric convolution, and the manual's own examples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_pmac import trajectories

RATE = 2250.0
FINE = 1e-5


def derivatives(path, start_s=0.0, spacing_s=FINE):
    """Return times and the position, velocity, acceleration and jerk of the first motor."""
    times = np.arange(0.0, start_s + path.duration_s + 20 * spacing_s, spacing_s)
    position = path.at(times, start_s)
    velocity = np.diff(position, axis=0) / spacing_s
    acceleration = np.diff(velocity, axis=0) / spacing_s
    jerk = np.diff(acceleration, axis=0) / spacing_s
    return times, position, velocity, acceleration, jerk


def one_move(distance, move_time_s, total_s, s_curve_s, max_velocity=1e9, max_acceleration=1e12):
    return trajectories.linear(
        [[0.0], [distance]],
        [move_time_s],
        trajectories.acceleration(total_s, s_curve_s),
        [max_velocity],
        [max_acceleration],
    )


def test_step_begins_in_the_cycle_of_its_time_and_not_one_later():
    times = trajectories.cycle_times(0.5, RATE)
    assert times.size == 1125
    signal = trajectories.step(times, 0.02, 2500)
    assert signal[44] == 0
    assert signal[45] == 2500
    assert signal[-1] == 2500


@pytest.mark.parametrize('rate', [2250.0, 2222.0, 1000.0])
def test_every_decimal_time_of_a_cycle_is_in_that_cycle(rate):
    times = trajectories.cycle_times(0.5, rate)
    for cycle in range(times.size):
        signal = trajectories.step(times, round(cycle / rate, 10), 1.0)
        assert np.flatnonzero(signal)[0] == cycle


def test_bidirectional_step_returns_to_zero():
    signal = trajectories.bidirectional_step(trajectories.cycle_times(1.0, RATE), 0.1, 0.6, -7)
    assert set(signal.tolist()) == {0.0, -7.0}
    assert np.count_nonzero(signal) == 0.5 * RATE
    assert signal[0] == signal[-1] == 0


def test_random_is_the_documented_generator_and_stays_within_its_amplitude():
    times = trajectories.cycle_times(2.0, RATE)
    signal = trajectories.random(times, 0.1, 300.0, 0.02, seed=5)
    assert (signal == trajectories.random(times, 0.1, 300.0, 0.02, seed=5)).all()
    assert (signal != trajectories.random(times, 0.1, 300.0, 0.02, seed=6)).any()
    assert not signal[: int(0.1 * RATE)].any()
    draws = np.random.Generator(np.random.PCG64(5)).random(95)
    held = signal[int(0.1 * RATE) :].reshape(95, 45)
    assert (held == held[:, :1]).all()
    assert held[:, 0] == pytest.approx(300.0 * (2.0 * draws - 1.0))
    assert np.abs(signal).max() <= 300.0
    assert np.abs(signal.mean()) < 60.0


def test_the_generator_still_gives_the_numbers_it_gave_when_seeds_were_first_used():
    draws = np.random.Generator(np.random.PCG64(5)).random(3)
    assert draws.tolist() == [0.8050029237453802, 0.8079407897364937, 0.515325561042142]


def test_swept_sine_crosses_zero_where_the_integral_of_its_frequency_is_whole():
    """The frequency doubles every half second, eight times; integrated by the trapezoidal rule."""
    spacing = 1e-5
    times = np.arange(0.0, 4.2, spacing)
    signal = trajectories.swept_sine(times, 0.1, 4.1, 2.0, 1.0, 256.0)
    frequency = np.where((times > 0.1) & (times < 4.1), 2.0 ** ((times - 0.1) / 0.5), 0.0)
    cycles = np.concatenate([[0.0], np.cumsum((frequency[1:] + frequency[:-1]) / 2) * spacing])
    crossings = np.flatnonzero((signal[1:] > 0) & (signal[:-1] <= 0)) + 1
    whole = np.arange(crossings.size)
    assert crossings.size == np.ceil(cycles[-1])
    assert cycles[crossings] == pytest.approx(whole, abs=2 * 256 * spacing)
    assert np.abs(signal).max() == pytest.approx(2.0, rel=1e-3)
    assert not signal[times <= 0.1].any()
    assert not signal[times >= 4.1].any()


def test_corner_frequency_limits_the_acceleration_of_a_sweep():
    times = np.arange(0.0, 5.0, 1e-5)
    corner = 10.0
    signal = trajectories.swept_sine(times, 0.0, 5.0, 1.0, 1.0, 300.0, corner, fade_s=0.2)
    acceleration = np.abs(np.diff(signal, 2)) / 1e-10
    limit = (2 * np.pi * corner) ** 2
    assert 0.9 * limit < acceleration.max() < 1.02 * limit


@pytest.mark.parametrize('seed', [None, 4])
def test_multisine_has_equal_lines_and_nothing_between(seed):
    period = 0.5
    times = trajectories.cycle_times(2 * period, RATE)
    signal = trajectories.multisine(times, 0.0, 3.0, period, 2.0, 100.0, seed=seed)
    spectrum = np.abs(np.fft.rfft(signal)) / (signal.size / 2)
    lines = np.zeros(spectrum.size, bool)
    lines[2 * np.arange(1, 51)] = True  # 2, 4, ..., 100 Hz
    assert spectrum[lines] == pytest.approx(np.full(50, spectrum[2]))
    assert spectrum[~lines].max() < 1e-12
    assert 2.8 < np.abs(signal).max() <= 3.0 + 1e-9


def test_lines_of_a_multisine_fall_above_the_corner_as_those_of_a_sweep_do():
    times = trajectories.cycle_times(1.0, RATE)
    signal = trajectories.multisine(times, 0.0, 1.0, 1.0, 5.0, 200.0, 20.0, seed=1)
    lines = np.arange(5, 201)
    spectrum = np.abs(np.fft.rfft(signal))[lines]
    assert spectrum / spectrum[0] == pytest.approx((1 + (5 / 20) ** 2) / (1 + (lines / 20) ** 2))
    assert 0.9 < np.abs(signal).max() <= 1.0 + 1e-9


def test_schroeder_phases_keep_the_crest_factor_low():
    times = trajectories.cycle_times(1.0, RATE)
    signal = trajectories.multisine(times, 0.0, 1.0, 1.0, 1.0, 100.0)
    assert 1.0 / np.sqrt(np.mean(signal**2)) < 2.0


def test_trapezoid_has_the_times_of_the_manual():
    """TS = 0: constant acceleration d / (TM TA) for TA, then d / TM, at rest after TM + TA."""
    path = one_move(1000.0, 0.5, 0.1, 0.0)
    assert path.duration_s == pytest.approx(0.6)
    times, position, velocity, acceleration, _ = derivatives(path, 0.2)
    assert velocity.max() == pytest.approx(1000.0 / 0.5)
    assert np.abs(acceleration).max() == pytest.approx(2000.0 / 0.1, rel=1e-4)
    at = np.searchsorted(times, [0.2, 0.25, 0.3, 0.5, 0.7, 0.8])
    exact = [0.0, 0.5 * 20000 * 0.05**2, 0.5 * 20000 * 0.1**2, 100 + 2000 * 0.2, 900.0, 1000.0]
    assert position[at, 0] == pytest.approx(exact, abs=0.03)
    assert position[-1, 0] == 1000.0


def test_s_curve_has_the_peak_acceleration_and_jerk_of_its_times():
    total_s, s_curve_s, speed = 0.1, 0.02, 2000.0
    path = one_move(1000.0, 0.5, total_s, s_curve_s)
    times, _, velocity, acceleration, jerk = derivatives(path)
    peak = speed / (total_s - s_curve_s)
    assert acceleration.max() == pytest.approx(peak, rel=1e-4)
    assert acceleration.min() == pytest.approx(-peak, rel=1e-4)
    assert np.median(jerk[10:1900]) == pytest.approx(peak / s_curve_s, rel=1e-2)
    steady = (times[:-2] > 0.0202) & (times[:-2] < 0.0798)
    assert acceleration[steady, 0] == pytest.approx(peak, rel=1e-3)
    assert velocity.max() == pytest.approx(speed)


def test_acceleration_time_is_at_least_twice_the_s_curve_time():
    assert trajectories.acceleration(0.03, 0.05).total_s == 0.1
    path = one_move(1000.0, 0.5, 0.0, 0.05)
    _, _, _, acceleration, _ = derivatives(path)
    assert acceleration.max() == pytest.approx(2.0 * 2000.0 / 0.1, rel=1e-3)
    with pytest.raises(ValueError, match='zero'):
        trajectories.acceleration(0.0, 0.0)


def test_short_move_is_a_triangle_of_twice_the_acceleration_time():
    path = one_move(10.0, 0.001, 0.1, 0.0)
    assert path.duration_s == pytest.approx(0.2)
    _, _, velocity, _, _ = derivatives(path)
    assert velocity.max() == pytest.approx(10.0 / 0.1, rel=1e-3)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_blended_path_is_its_velocity_steps_convolved_with_two_boxes(seed):
    """Independent of the polynomials: velocity pulses, smoothed over TA - TS and then over TS."""
    random = np.random.default_rng(seed)
    spacing = 1e-4
    moves = int(random.integers(1, 4))
    corners = np.round(np.cumsum(random.uniform(-50, 50, (moves + 1, 1)), axis=0), 3)
    s_curve, flat = int(random.integers(1, 200)), int(random.integers(1, 300))
    total = 2 * s_curve + flat
    path = trajectories.linear(
        corners,
        (total + random.integers(1, 500, moves)) * spacing,
        trajectories.acceleration(total * spacing, s_curve * spacing),
        [1e9],
        [1e12],
    )
    segments = np.rint(path.move_times_s / spacing).astype(int)
    speed = np.concatenate(
        [np.full(n, v) for n, v in zip(segments, path.velocities[:, 0], strict=True)]
    )
    for box in (total - s_curve, s_curve):
        speed = np.convolve(speed, np.full(box, 1.0 / box))
    expected = corners[0, 0] + spacing * np.concatenate([[0.0], np.cumsum(speed)])
    times = spacing * np.arange(expected.size)
    # sums over cells of `spacing` against integrals: half a cell of speed at most
    tolerance = spacing * np.abs(path.velocities).max() * 1.01
    assert path.at(times)[:, 0] == pytest.approx(expected, abs=tolerance)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_linear_moves_end_exactly_and_never_exceed_a_limit(seed):
    random = np.random.default_rng(seed)
    motors, moves = int(random.integers(1, 4)), int(random.integers(1, 4))
    corners = random.uniform(-1000.0, 1000.0, (moves + 1, motors))
    top = random.uniform(50.0, 5000.0, motors)
    limit = random.uniform(100.0, 50000.0, motors)
    requested = trajectories.acceleration(random.uniform(0, 0.3), random.uniform(0.001, 0.2))
    path = trajectories.linear(corners, random.uniform(0.0, 0.5, moves), requested, top, limit)
    spacing = path.duration_s / 20000
    _, position, velocity, acceleration, _ = derivatives(path, 0.01, spacing)
    assert (position[0] == corners[0]).all()
    assert (position[-1] == corners[-1]).all()
    assert (np.abs(velocity).max(axis=0) <= top * (1 + 1e-6)).all()
    assert (np.abs(acceleration).max(axis=0) <= limit * (1 + 1e-3) + 1e-4).all()
    # the profile keeps its shape
    shape = path.acceleration.s_curve_s / path.acceleration.total_s
    assert shape == pytest.approx(requested.s_curve_s / requested.total_s)
    assert path.acceleration.total_s >= requested.total_s


@settings(max_examples=60, deadline=None)
@given(
    distance=st.floats(0.1, 1e6),
    limit=st.floats(1.0, 1e6),
    top=st.floats(1.0, 1e5),
    share=st.floats(0.0, 0.5),
)
def test_acceleration_limit_costs_no_more_time_than_needed(distance, limit, top, share):
    """
    Closed form for one move with TA = 1 us requested and TS = share TA.

    Trapezoid: TA (1 - share) = top / limit. Triangle, if that exceeds distance / top:
    TA^2 (1 - share) = distance / limit.
    """
    path = one_move(distance, 0.0, 1e-6, share * 1e-6, top, limit)
    trapezoid = top / limit / (1 - share)
    triangle = np.sqrt(distance / limit / (1 - share))
    expected = trapezoid if trapezoid <= distance / top else triangle
    assert path.acceleration.total_s == pytest.approx(max(expected, 1e-6), rel=1e-9)
    assert path.move_times_s[0] == pytest.approx(max(distance / top, expected), rel=1e-9)


def test_ixx16_slows_all_motors_together_so_that_the_path_stays_straight():
    path = trajectories.linear(
        [[0.0, 0.0], [100.0, 30.0]],
        [0.1],
        trajectories.acceleration(0.05, 0.0),
        [500.0, 20.0],
        [1e9, 1e9],
    )
    assert path.move_times_s[0] == pytest.approx(30.0 / 20.0)
    position = path.at(np.linspace(0, path.duration_s, 1000))
    assert position[:, 1] == pytest.approx(0.3 * position[:, 0], abs=1e-9)


def test_corner_of_the_manuals_example_is_lengthened_for_the_motor_that_turns():
    """
    X20 Y20, then X-20 Y20 at F10, TA 200 ms, 10000 counts per unit, Ixx17 = 0.25 counts/ms^2.

    Motor 1 turns from 70.7 to -70.7 counts/ms; the acceleration of 0.707 counts/ms^2 at the corner
    exceeds the limit. (The manual prints 707 ms for the new time; its own formula gives 566 ms.)
    """
    speed = 10.0 * np.sqrt(0.5) * 10000.0 / 1000.0
    assert speed == pytest.approx(70.7, rel=1e-3)
    time_s = 20.0 / (10.0 * np.sqrt(0.5))
    path = trajectories.linear(
        [[0.0, 0.0], [2e5, 2e5], [0.0, 4e5]],
        [time_s, time_s],
        trajectories.acceleration(0.2, 0.0),
        [1e9, 1e9],
        [0.25e6, 0.25e6],
    )
    assert path.acceleration.total_s == pytest.approx(0.2 * 0.7071 / 0.25, rel=1e-4)


def test_jog_of_the_manuals_example_takes_the_time_that_ixx19_asks_for():
    """50 counts/ms in 100 ms would be 0.5 counts/ms^2; Ixx19 = 0.25 makes it 200 ms."""
    path = trajectories.jog(0.0, 1e5, 50e3, trajectories.acceleration(0.1, 0.0), 0.25e6)
    assert path.acceleration.total_s == pytest.approx(0.2)
    unlimited = trajectories.jog(0.0, 1e5, 50e3, trajectories.acceleration(0.1, 0.0), 0.5e6)
    assert unlimited.acceleration.total_s == pytest.approx(0.1)


def test_rapid_slows_the_other_motors_to_the_longest_time():
    times = [trajectories.acceleration(0.05, 0.01)] * 3
    paths = trajectories.rapid(
        [0.0, 10.0, 5.0], [1000.0, -90.0, 5.0], [500.0, 1000.0, 100.0], times, [1e6] * 3
    )
    assert paths[0].velocities[0, 0] == pytest.approx(500.0)
    assert paths[1].velocities[0, 0] == pytest.approx(-50.0)
    assert paths[0].duration_s == pytest.approx(paths[1].duration_s)
    late = np.array([10.0])
    assert [path.at(late)[0, 0] for path in paths] == [1000.0, -90.0, 5.0]
    assert (paths[2].at(np.linspace(0, 1, 50)) == 5.0).all()


def test_rapid_without_motion_stays():
    times = [trajectories.acceleration(0.05, 0.01)]
    paths = trajectories.rapid([3.0], [3.0], [100.0], times, [1e6])
    assert (paths[0].at(np.linspace(0.0, 1.0, 20)) == 3.0).all()


def test_a_motor_is_brought_to_rest_evenly():
    for velocity, deceleration in ((3.0, 7.0), (-0.5, 40.0), (0.0, 1.0)):
        way = trajectories.brought_to_rest(velocity, deceleration, 1e-3)
        assert way[0] == 0.0
        assert way[-1] == pytest.approx(np.sign(velocity) * velocity**2 / (2.0 * deceleration))
        speed = np.diff(way) / 1e-3
        assert np.all(np.abs(speed) <= abs(velocity))
        assert np.all(np.abs(np.diff(speed, 2)[:-1]) < 1e-6 * deceleration)
        assert len(way) == np.ceil(abs(velocity) / deceleration / 1e-3) + 1
