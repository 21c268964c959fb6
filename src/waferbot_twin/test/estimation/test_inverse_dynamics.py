# SPDX-License-Identifier: Apache-2.0
"""Inverse dynamics on motions that are formulas, so that the force follows without an integrator."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.errors import UserError
from waferbot_twin.estimation.inverse_dynamics import (
    HIGHEST_SHARE,
    Stretch,
    Terms,
    cut_off,
    derivatives,
    estimate,
    filter_all,
    joined,
    least_squares,
    noise_share,
    position_noise,
    relative_error,
)

MASS, VISCOUS, COULOMB, OFFSET = 95.0, 200.0, 20.0, -3.0
STEP_S = 1e-3

SEED = 3


class Motion:
    """A sum of six sines of 0.2 to 2 Hz with a speed of some 0.2 m/s."""

    def __init__(self, random) -> None:
        self.wave = 2.0 * np.pi * random.uniform(0.2, 2.0, 6)
        self.phase = random.uniform(0.0, 2.0 * np.pi, 6)
        self.size = random.uniform(0.05, 0.1, 6) / self.wave

    def __call__(self, order, time_s):
        angle = np.outer(time_s, self.wave) + self.phase + order * np.pi / 2.0
        return np.sin(angle) @ (self.size * self.wave**order)


def stretch(random, noise=0.0, more=lambda position, speed: 0.0, length_s=20.0, resolution=0.0):
    """A motion, the force that it needs, with `noise` (N rms, white) on it; rounded position."""
    motion = Motion(random)
    time_s = np.arange(0.0, length_s, STEP_S)
    position, speed, acceleration = (motion(order, time_s) for order in range(3))
    force = MASS * acceleration + VISCOUS * speed + COULOMB * np.sign(speed) + OFFSET
    force = force + more(position, speed) + noise * random.standard_normal(len(time_s))
    if resolution:
        position = resolution * np.round(position / resolution)
    return Stretch(STEP_S, position, force, resolution)


def values(found):
    return dict(zip(found.names, found.value, strict=True))


def test_a_known_machine_comes_out(random) -> None:
    found, _, _ = estimate([stretch(random, noise=5.0, resolution=1e-6)])
    expected = {
        'inertia': MASS,
        'viscous': VISCOUS,
        'coulomb': COULOMB,
        'offset': OFFSET,
    }
    for name, value in expected.items():
        place = found.names.index(name)
        assert abs(found.value[place] - value) < 4.0 * found.standard_error[place]
        assert found.high95[place] - value < 0.1 * abs(value)


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    mass=st.floats(0.01, 1000.0),
    viscous=st.floats(-50.0, 500.0),
    coulomb=st.floats(0.0, 100.0),
    offset=st.floats(-50.0, 50.0),
    cut_off_hz=st.floats(5.0, 90.0),
)
def test_without_noise_the_filter_bends_nothing(
    seed, mass, viscous, coulomb, offset, cut_off_hz
) -> None:
    """Whatever the cut-off, since force and regressors pass through the same filter."""
    motion = Motion(np.random.default_rng(seed))
    time_s = np.arange(0.0, 8.0, STEP_S)
    position, speed, acceleration = (motion(order, time_s) for order in range(3))
    force = mass * acceleration + viscous * speed + coulomb * np.sign(speed) + offset
    found, _, _ = estimate([Stretch(STEP_S, position, force)], None, cut_off_hz)
    size = float(np.sqrt(np.mean(force**2)))
    for name, value, column in (
        ('inertia', mass, acceleration),
        ('viscous', viscous, speed),
        ('coulomb', coulomb, np.ones(1)),
        ('offset', offset, np.ones(1)),
    ):
        error = values(found)[name] - value
        assert abs(error) * np.sqrt(np.mean(column**2)) < 0.01 * size, name


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1), of_length=st.floats(1e-3, 1e3), of_force=st.floats(1e-3, 1e3)
)
def test_units_do_not_matter(seed, of_length, of_force) -> None:
    one = stretch(np.random.default_rng(seed), noise=1.0, length_s=4.0, resolution=1e-6)
    other = Stretch(
        STEP_S, of_length * one.position, of_force * one.force, of_length * one.resolution
    )
    (found, _, hz), (scaled, _, other_hz) = estimate([one]), estimate([other])
    assert other_hz == pytest.approx(hz)
    factors = {'inertia': of_force / of_length, 'viscous': of_force / of_length}
    for place, name in enumerate(found.names):
        factor = factors.get(name, of_force)
        for mine, theirs in ((found.value, scaled.value), (found.high95, scaled.high95)):
            scale = factor * max(abs(found.high95[place]), abs(found.low95[place]))
            assert theirs[place] == pytest.approx(factor * mine[place], rel=1e-6, abs=1e-6 * scale)


def test_intervals_hold_the_truth_where_residuals_are_correlated(random) -> None:
    """Force noise with a correlation time of 0.1 s: 95 % intervals hold it in some 95 % of 100 logs."""
    inside = np.zeros(4)
    naive = 0
    tries = 100
    for _ in range(tries):
        one = stretch(random, length_s=8.0)
        noise = np.zeros(len(one.force))
        kick = random.standard_normal(len(noise)) * 8.0 * math.sqrt(2.0 * STEP_S / 0.1)
        for place in range(1, len(noise)):
            noise[place] = (1.0 - STEP_S / 0.1) * noise[place - 1] + kick[place]
        found, terms, hz = estimate([Stretch(STEP_S, one.position, one.force + noise)], None, 20.0)
        truth = np.array([MASS, VISCOUS, COULOMB, OFFSET])
        inside += (found.low95 < truth) & (truth < found.high95)
        columns, _ = joined(filter_all([one], hz, terms, 0.0))
        matrix = np.column_stack(list(columns.values()))
        rms = np.sqrt(np.mean((noise - noise.mean()) ** 2))
        simple = rms * np.sqrt(np.linalg.inv(matrix.T @ matrix)[3, 3])
        naive += abs(found.value[3] - OFFSET) < 1.96 * simple
    print(inside / tries, naive / tries)
    # 86 of 100 or fewer have a chance of 0.05 % if it is 95 %.
    assert inside.min() >= 87
    assert naive < 60  # and the usual formula is far too sharp


def test_white_noise_needs_no_wider_intervals_than_the_usual_formula(random) -> None:
    count = 20000
    columns = {'a': random.standard_normal(count), 'b': random.standard_normal(count)}
    found = least_squares(columns, 2.0 * columns['a'] + random.standard_normal(count))
    assert found.standard_error == pytest.approx(1.0 / math.sqrt(count), rel=0.15)
    assert found.low95[0] < 2.0 < found.high95[0]


def test_weights_are_one_over_the_variance(random) -> None:
    count = 4000
    deviation = np.where(np.arange(count) % 2 == 0, 0.1, 10.0)
    columns = {'a': random.standard_normal(count)}
    force = 2.0 * columns['a'] + deviation * random.standard_normal(count)
    plain, weighted = (least_squares(columns, force, weight) for weight in (None, deviation**-2.0))
    assert weighted.standard_error[0] < 0.05 * plain.standard_error[0]
    assert abs(weighted.value[0] - 2.0) < 4.0 * weighted.standard_error[0]


def test_optional_terms_come_out(random) -> None:
    def more(position, speed):
        backward = np.where(speed < 0.0, 60.0 * speed, 0.0)
        rise = -8.0 * np.sign(speed) * np.exp(-np.abs(speed) / 0.03)
        return backward + rise + 4.0 * np.sin(2.0 * np.pi / 0.05 * position)

    terms = Terms(True, math.nan, (2.0 * np.pi / 0.05,))
    found, used, _ = estimate([stretch(random, 2.0, more)], terms, 50.0)
    got = values(found)
    assert used.rise_speed == pytest.approx(0.03, rel=0.15)
    assert got['viscous_forward'] == pytest.approx(200.0, rel=0.02)
    assert got['viscous_backward'] == pytest.approx(260.0, rel=0.02)
    assert got['coulomb'] == pytest.approx(20.0, rel=0.03)
    assert got['rise'] == pytest.approx(-8.0, rel=0.15)
    assert got['sine_1'] == pytest.approx(4.0, rel=0.03)
    assert got['cosine_1'] == pytest.approx(0.0, abs=0.1)


def test_noise_of_the_position_is_seen_and_lowers_the_cut_off(random) -> None:
    one = stretch(random)
    noisy = Stretch(
        STEP_S, one.position + 1e-5 * random.standard_normal(len(one.position)), one.force
    )
    assert position_noise(noisy) == pytest.approx(1e-5, rel=0.05)
    coarse = stretch(random, resolution=1e-4)
    assert position_noise(coarse) == pytest.approx(1e-4 / math.sqrt(12.0), rel=0.2)
    assert cut_off([one]) == pytest.approx(HIGHEST_SHARE / STEP_S)
    lower = cut_off([noisy])
    assert lower < 0.5 * cut_off([one])
    # At that cut-off half a percent of the inertia is lost, at four times it much more.
    found = [values(estimate([noisy], None, hz)[0])['inertia'] for hz in (lower, 4.0 * lower)]
    assert found[0] == pytest.approx(MASS, rel=0.015)
    assert found[1] < 0.9 * MASS
    assert noise_share([noisy], 4.0 * lower) > 0.1


def test_a_resonance_lowers_the_cut_off(random) -> None:
    """A second mass on a spring, 5 Hz: nearer to that the axis seems heavier, above it lighter."""
    motion = Motion(random)
    time_s = np.arange(0.0, 20.0, STEP_S)
    omega = 2.0 * np.pi * 5.0
    position, acceleration = motion(0, time_s), motion(2, time_s)
    wave = 2.0 * np.pi * np.array([17.0, 21.0, 26.0])
    size = np.array([0.6, 0.6, 0.6])
    for one, amplitude in zip(wave, size, strict=True):
        position = position - amplitude / one**2 * np.sin(one * time_s)
    load = 0.5 * MASS
    force = MASS * acceleration
    for one, amplitude in zip(wave, size, strict=True):
        response = 1.0 / (1.0 - (one / omega) ** 2)
        force = force + (load + load * response) * amplitude * np.sin(one * time_s)
    force = force + random.standard_normal(len(force))
    found, _, hz = estimate([Stretch(STEP_S, position, force)])
    assert hz < 17.0
    assert values(found)['inertia'] == pytest.approx(MASS, rel=0.05)
    wide, _, _ = estimate([Stretch(STEP_S, position, force)], None, 100.0)
    assert values(wide)['inertia'] < 0.94 * MASS


def swing(random):
    """Return 64 s at 100 Hz of a joint that swings under gravity at 0.1 Hz, after a start at once."""
    step_s, wave = 0.01, 2.0 * np.pi * 0.1
    time_s = np.arange(0.0, 64.0, step_s)
    start = np.clip(time_s / 0.5, 0.0, 1.0)
    position = 1.5 * np.sin(wave * time_s) + 0.2 * start**4 * (35 - 84 * start + 70 * start**2)
    position -= 0.2 * start**4 * 20 * start**3
    speed, acceleration = derivatives(position, step_s)
    force = 3.2 * acceleration + 8.7 * speed + 5.3 * np.sign(speed) - 37.5 * np.sin(position)
    force += 0.8 * random.standard_normal(len(force))
    return Stretch(step_s, 1e-4 * np.round(position / 1e-4), force, 1e-4)


def test_where_next_to_nothing_tells_the_inertia_no_cut_off_has_a_say(random) -> None:
    """A swing under gravity accelerates nearly as the sine of its angle; the start tells."""
    one, terms = swing(random), Terms(wave_numbers=(1.0,))
    told = [estimate([one], terms, hz)[0].told[0] for hz in (0.2, 5.0)]
    assert told[0] < 0.01 < told[1]
    found, _, hz = estimate([one], terms)
    place = found.names.index('inertia')
    assert hz > 0.5
    assert found.value[place] == pytest.approx(3.2, rel=0.15)
    assert found.high95[place] - found.low95[place] < 2.0


def test_differences_are_of_fourth_order() -> None:
    omega = 2.0 * np.pi * 100.0
    time_s = np.arange(0.0, 1.0, STEP_S)
    first, second = derivatives(np.sin(omega * time_s), STEP_S)
    inner = slice(3, -3)
    assert first[inner] == pytest.approx(omega * np.cos(omega * time_s)[inner], abs=0.006 * omega)
    reference = -(omega**2) * np.sin(omega * time_s)[inner]
    assert second[inner] == pytest.approx(reference, abs=0.002 * omega**2)


def test_what_cannot_be_told_apart_is_left_open(random) -> None:
    """Always forwards: Coulomb friction and offset are one force."""
    time_s = np.arange(0.0, 10.0, STEP_S)
    speed = 0.2 + 0.05 * np.sin(2.0 * np.pi * time_s)
    position = 0.2 * time_s - 0.05 / (2.0 * np.pi) * np.cos(2.0 * np.pi * time_s)
    acceleration = 0.05 * 2.0 * np.pi * np.cos(2.0 * np.pi * time_s)
    force = MASS * acceleration + VISCOUS * speed + COULOMB + OFFSET
    force += random.standard_normal(len(force))
    found, _, _ = estimate([Stretch(STEP_S, position, force)])
    left_open = {n for n, known in zip(found.names, found.determined, strict=True) if not known}
    assert left_open == {'coulomb', 'offset'}
    assert np.isnan(found.low95[found.names.index('coulomb')])
    assert values(found)['inertia'] == pytest.approx(MASS, rel=0.02)
    assert values(found)['coulomb'] + values(found)['offset'] == pytest.approx(17.0, abs=1.5)


TIME_S = np.arange(0.0, 20.0, STEP_S)
SWING = 0.3 * np.sin(2.0 * np.pi * 0.3 * TIME_S)
FORWARDS = {
    'from rest to a constant speed': np.clip(np.minimum(TIME_S - 1.0, 3.0), 0.0, None) / 10.0,
    'up and down from rest': np.clip(np.minimum(TIME_S - 1.0, 15.0 - TIME_S), 0.0, 4.0) / 10.0,
    'stop and go': np.clip(SWING, 0.0, None),
    'short rests': np.clip(SWING + 0.28, 0.0, None),
}
BOTH_WAYS = {
    'there and back': SWING,
    'a moment back': 0.3
    + 0.08 * np.sin(2.5 * TIME_S)
    - 0.6 * np.exp(-(((TIME_S - 10.0) / 0.4) ** 2)),
}


def moved(speed, random):
    """Return the stretch of a mass that moves at these speeds, its position in steps of 1 um."""
    acceleration = np.gradient(speed, STEP_S)
    force = MASS * acceleration + VISCOUS * speed + COULOMB * np.sign(speed) + OFFSET
    position = 1e-6 * np.round(np.cumsum(speed) * STEP_S / 1e-6)
    return Stretch(STEP_S, position, force + 0.3 * random.standard_normal(len(speed)), 1e-6)


@pytest.mark.parametrize('name', FORWARDS)
def test_a_motion_in_one_direction_leaves_friction_and_offset_open(random, name) -> None:
    """How the filter settles beside a rest is not what tells them apart."""
    found, _, _ = estimate([moved(FORWARDS[name], random)])
    left_open = {n for n, known in zip(found.names, found.determined, strict=True) if not known}
    assert left_open == {'coulomb', 'offset'}
    assert values(found)['inertia'] == pytest.approx(MASS, rel=0.03)
    assert values(found)['viscous'] == pytest.approx(VISCOUS, rel=0.05)
    assert values(found)['coulomb'] + values(found)['offset'] == pytest.approx(17.0, rel=0.05)


@pytest.mark.parametrize('name', BOTH_WAYS)
def test_a_moment_in_the_other_direction_tells_friction_and_offset_apart(random, name) -> None:
    found, _, _ = estimate([moved(BOTH_WAYS[name], random)])
    assert found.determined.all()
    assert values(found)['coulomb'] == pytest.approx(COULOMB, rel=0.05)
    assert values(found)['offset'] == pytest.approx(OFFSET, abs=1.0)


def test_one_speed_both_ways_leaves_the_kind_of_friction_open(random) -> None:
    speed = 0.3 * np.sign(np.sin(2.0 * np.pi * 0.2 * TIME_S))
    found, _, _ = estimate([moved(speed, random)])
    left_open = {n for n, known in zip(found.names, found.determined, strict=True) if not known}
    assert left_open == {'viscous', 'coulomb'}
    assert values(found)['offset'] == pytest.approx(OFFSET, abs=1.0)


def test_rest_is_left_out_and_says_nothing(random) -> None:
    """A force of any size while the axis stands does not change a thing."""
    angle = 2.0 * np.pi * np.arange(0.0, 10.0, STEP_S)  # 1 Hz, and then it stands
    speed, acceleration = 0.3 * np.sin(angle), 0.6 * np.pi * np.cos(angle)
    position = np.concatenate([0.15 / np.pi * (1.0 - np.cos(angle)), np.zeros(4000)])
    force = MASS * acceleration + VISCOUS * speed + COULOMB * np.sign(speed) + OFFSET
    force += random.standard_normal(len(force))
    parts = [
        Stretch(STEP_S, position, np.concatenate([force, hold]), 1e-6)
        for hold in (np.full(4000, 12.0), 12.0 * np.sin(np.linspace(0.0, 9.0, 4000)))
    ]
    found = [estimate([part], None, 30.0)[0] for part in parts]
    assert found[0].value == pytest.approx(found[1].value, rel=0.01)
    assert values(found[0])['coulomb'] == pytest.approx(COULOMB, rel=0.02)


def test_errors_are_told() -> None:
    with pytest.raises(UserError, match='too few'):
        estimate([Stretch(STEP_S, np.zeros(30), np.zeros(30))], None, 50.0)
    with pytest.raises(UserError, match='never moves'):
        estimate([Stretch(STEP_S, np.zeros(3000), np.zeros(3000), 1e-6)], None, 50.0)
    with pytest.raises(UserError, match='too few'):
        least_squares({'a': np.ones(2)}, np.ones(2))


def test_relative_error() -> None:
    assert relative_error(np.array([3.0, 4.0]), np.array([0.3, 0.4])) == pytest.approx(0.1)
    assert math.isnan(relative_error(np.zeros(2), np.zeros(2)))
