# SPDX-License-Identifier: Apache-2.0
"""Errors of encoders: hand formulas, neutral values, repeatability."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant import plant
from waferbot_plant.plant import Machine, load_machine

COUNTS = 1.0e6
TURN = 2.0 * math.pi


def slide(delay: int = 0, divider: int = 1, **errors):
    """Return (machine, parameters) of a slide with an encoder of 1e6 counts per m."""
    machine = load_machine(
        machines.write_single_mass(
            gravity_m_s2=[0, 0, 0],
            encoders={
                'y_linear': {'coordinate': 'travel', 'counts_per_m': COUNTS, **errors},
                'x_rotate': {'coordinate': 'travel', 'counts_per_m': -COUNTS, **errors},
            },
            feedback={'delay_cycles': delay},
        ),
        timing=Timing(encoder_divider=divider, servo_divider=4 * divider),
    )
    return machine, machine.parameters()


def readings(positions, place: int = 0, looked_at: bool = False, **settings) -> np.ndarray:
    """Return what an encoder tells while the slide is put to one position after another."""
    machine, parameters = slide(**settings)
    if looked_at:
        parameters[0]['encoder_imperfect'] = 1
    state = machine.initial_state(parameters)
    state[0]['position'][0] = positions[0]
    plant.fill_readings(state, parameters)
    counts, lines = np.zeros(4, np.int64), np.zeros(6)
    told = []
    for tick, position in enumerate(positions):
        state[0]['position'][0] = position
        plant.measure(state, parameters, tick, counts, lines)
        told.append(int(counts[place]))
    return np.array(told)


def random_positions(seed: int = 3, number: int = 400) -> np.ndarray:
    print('seed', seed)
    return np.random.default_rng(seed).uniform(-0.3, 0.3, number)


def agrees(told: np.ndarray, exact: np.ndarray) -> bool:
    """Tell whether the counts are the exact positions rounded down, up to 1e-6 counts."""
    return bool(np.all((told <= exact + 1e-6) & (exact - 1e-6 < told + 1)))


@pytest.mark.parametrize('place', [0, 1])
@pytest.mark.parametrize('error', [1e-4, -0.02])
def test_scale_error(place: int, error: float) -> None:
    positions = random_positions()
    sign = 1.0 if place == 0 else -1.0
    exact = sign * COUNTS * (1.0 + error) * positions
    assert agrees(readings(positions, place, scale_error=error), exact)


@pytest.mark.parametrize('place', [0, 1])
def test_eccentricity_is_one_period_and_has_its_peak_at_its_phase(place: int) -> None:
    positions = random_positions()
    wrong = {'amplitude_m': 2e-4, 'period_m': 0.04, 'phase_rad': 0.6}
    sign = 1.0 if place == 0 else -1.0
    exact = sign * COUNTS * (positions + 2e-4 * np.cos(TURN * positions / 0.04 - 0.6))
    assert agrees(readings(positions, place, eccentricity=wrong), exact)
    at_peak = readings([0.04 * 0.6 / TURN + 0.04 * 3], place, eccentricity=wrong)[0]
    assert at_peak == pytest.approx(sign * (COUNTS * (0.04 * 0.6 / TURN + 0.12) + 200.0), abs=1.0)


def test_eccentricity_of_a_rotary_encoder_is_in_radians() -> None:
    machine = load_machine(
        machines.write_pendulum(
            encoders={
                'x_rotate': {
                    'coordinate': 'swing',
                    'counts_per_revolution': 2**20,
                    'eccentricity': {'amplitude_rad': 1e-3, 'period_rad': TURN},
                }
            },
            feedback={'delay_cycles': 0},
        )
    )
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    counts = np.zeros(4, np.int64)
    for angle in (0.0, 0.7, 3.0):
        state[0]['position'][0] = angle
        plant.measure(state, parameters, 0, counts, np.zeros(6))
        exact = 2**20 / TURN * (angle + 1e-3 * math.cos(angle))
        assert counts[1] == math.floor(exact)


def test_eccentricity_of_an_encoder_behind_a_rigid_gear_turns_with_its_own_coordinate() -> None:
    machine = load_machine(
        'rigid',
        overlays=[
            {
                'encoders': {
                    'y_rotate_motor': {'eccentricity': {'amplitude_rad': 0.01, 'period_rad': TURN}}
                },
                'feedback': {'delay_cycles': 0},
            }
        ],
    )
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    counts = np.zeros(4, np.int64)
    state[0]['position'][2] = 0.05
    plant.measure(state, parameters, 0, counts, np.zeros(6))
    motor = 48 * 0.05
    assert counts[3] == math.floor(2**16 / TURN * (motor + 0.01 * math.cos(motor)))


def test_interpolation_error_has_the_signal_period() -> None:
    positions = random_positions()
    wrong = {'amplitude_counts': 7.5, 'period_counts': 400.0, 'phase_rad': -1.0}
    exact = COUNTS * positions
    exact = exact + 7.5 * np.cos(TURN * exact / 400.0 + 1.0)
    assert agrees(readings(positions, interpolation=wrong), exact)


@pytest.mark.parametrize('coarse', [1, 2, 16, 2.5])
def test_only_multiples_of_the_coarseness_are_seen(coarse: float) -> None:
    positions = random_positions()
    told = readings(positions, coarseness_counts=coarse)
    expected = [math.floor(coarse * math.floor(COUNTS * x / coarse)) for x in positions]
    assert told.tolist() == expected


@pytest.mark.parametrize(('common', 'extra'), [(0, 1), (1, 3), (1, 14), (15, 0)])
def test_extra_delay_is_whole_phase_cycles(common: int, extra: int) -> None:
    positions = random_positions(number=100)
    told = readings(positions, delay=common, extra_delay_cycles=extra)
    late = common + extra
    shifted = [positions[max(0, tick - late)] for tick in range(100)]
    assert told.tolist() == [math.floor(COUNTS * x) for x in shifted]


@pytest.mark.parametrize('divider', [1, 2])
@pytest.mark.parametrize('delay_ms', [0.2, 1.0, 7.4, 20.0])
def test_a_delay_is_that_time_at_constant_speed(delay_ms: float, divider: int) -> None:
    """Beside whole cycles and a fraction of one, which stay as they are; to 20 ms."""
    speed = 37.3e-6  # m per tick
    positions = 0.1 + speed * np.arange(600)
    cycles = {'extra_delay_cycles': 2, 'delay_fraction': 0.75}
    told = readings(positions, divider=divider, delay_s=1e-3 * delay_ms, **cycles)
    late = 1e-3 * delay_ms * 18000 + 2.75 * divider  # ticks
    first = (math.ceil(late / divider) + 1) * divider
    exact = COUNTS * (positions - late * speed)
    assert agrees(told[first::divider], exact[first::divider])
    assert told[: int(late)].max() <= 100000


def test_a_delay_that_the_history_does_not_hold_is_an_error() -> None:
    twice = Timing(36000, 1, 4)
    machine, _ = slide(divider=2, delay_s=0.015)
    assert machine.parameters()['encoder_delay'][0, 0] == 135
    fast = Machine(machine.description, machine.assembly, twice)
    with pytest.raises(
        UserError, match=r'encoders.y_linear: delay_s: is 0.015; with 36000 readings'
    ):
        fast.parameters()


@pytest.mark.parametrize('fraction', [0.25, 1.0])
@pytest.mark.parametrize('divider', [1, 2])
def test_fraction_of_a_cycle_is_exact_at_constant_speed(fraction: float, divider: int) -> None:
    speed = 37.3e-6  # m per tick
    positions = 0.1 + speed * np.arange(200)
    told = readings(positions, divider=divider, delay_fraction=fraction)
    exact = COUNTS * (positions - fraction * divider * speed)
    assert agrees(told[2 * divider :: divider], exact[2 * divider :: divider])


def test_noise_is_white_and_of_the_rms_asked_for() -> None:
    number = 20000
    told = readings(np.full(number, 0.1 + 0.5e-6), noise_counts=5.0, noise_seed=4) - 100000.0
    expected = math.sqrt(25.0 + 1.0 / 12.0)  # with the rounding
    assert told.std() == pytest.approx(expected, rel=4.0 / math.sqrt(2 * number))
    assert abs(told.mean()) < 4.0 * expected / math.sqrt(number)
    assert abs(np.corrcoef(told[1:], told[:-1])[0, 1]) < 4.0 / math.sqrt(number)


def test_noise_repeats_with_its_seed_and_differs_between_encoders() -> None:
    positions = np.full(2000, 0.1)
    one = readings(positions, noise_counts=5.0, noise_seed=4)
    assert np.array_equal(one, readings(positions, noise_counts=5.0, noise_seed=4))
    other = readings(positions, noise_counts=5.0, noise_seed=5)
    second = -readings(positions, place=1, noise_counts=5.0, noise_seed=4)
    for different in (other, second):
        correlation = np.corrcoef(one, different)[0, 1]
        assert abs(correlation) < 4.0 / math.sqrt(2000)


def test_counts_are_lost_at_every_mark_in_either_direction() -> None:
    """Marks at +-5 mm, +-15 mm, ...: to 12 mm (1 mark), to -12 mm (3), to 0 (4 in all)."""
    lost = {'counts': 3.0, 'every_m': 0.01}
    there = np.linspace(0.0, 0.012, 50)
    positions = np.concatenate(
        [there, np.linspace(0.012, -0.012, 100), np.linspace(-0.012, 0, 50)]
    )
    told = readings(positions, lost_counts=lost)
    exact = COUNTS * positions
    assert agrees(told[:15], exact[:15])
    assert told[49] == math.floor(exact[49]) - 3
    assert told[149] == math.floor(exact[149]) - 9
    assert told[-1] == math.floor(exact[-1]) - 12
    assert readings([0.0, 0.052], lost_counts=lost)[1] == 52000 - 5 * 3


def test_counts_are_not_lost_where_the_machine_stands() -> None:
    lost = {'counts': 3.0, 'every_m': 0.01}
    assert readings([0.1234, 0.1234], lost_counts=lost).tolist() == [123400, 123400]


def test_history_before_the_start_is_what_was_read_there() -> None:
    """With delay the first counts come from before tick 0: same errors, noise of its own."""
    wrong = {'scale_error': 0.01, 'noise_counts': 30.0}
    told = readings(np.full(10, 0.1), delay=5, **wrong)
    assert np.abs(told - 101000).max() < 200
    assert len(set(told.tolist())) > 5


def test_neutral_values_are_no_effect_at_all() -> None:
    """Not named, named with neutral values, and looked at with neutral values: the same bits."""
    neutral = {
        'scale_error': 0.0,
        'eccentricity': {'amplitude_m': 0.0, 'period_m': 1.0},
        'interpolation': {'amplitude_counts': 0.0, 'period_counts': 1.0},
        'coarseness_counts': 1,
        'extra_delay_cycles': 0,
        'delay_fraction': 0.0,
        'delay_s': 0.0,
        'noise_counts': 0.0,
        'lost_counts': {'counts': 0.0, 'every_m': 0.1},
    }
    positions = random_positions()
    perfect = readings(positions, delay=1)
    assert np.array_equal(readings(positions, delay=1, **neutral), perfect)
    assert np.array_equal(readings(positions, delay=1, looked_at=True), perfect)
    assert not slide()[1]['encoder_imperfect'].any()
