# SPDX-License-Identifier: Apache-2.0
"""Dead time and a bus that sags: hand formulas, Kirchhoff, neutral values."""

import math

import numpy as np
import pytest

from waferbot_copley import faults
from waferbot_copley.current_loop import (
    CIRCULAR,
    FIELD_ORIENTED,
    HEXAGONAL,
    dead_time_loss,
    loaded_bus,
)

SOFT = {'bus_resistance': 2.0}


def driven(stand, ticks=400, command=12.0, speed=0.02):
    """Run with a turning angle; return terminals (n, 3) and the line currents before (n, 3)."""
    terminals, currents = [], []
    for tick in range(ticks):
        currents.append(stand.tick(command, speed * tick))
        terminals.append(stand.terminals)
    return np.array(terminals), np.array(currents)


@pytest.mark.parametrize(
    ('current', 'share'), [(0.0, 0.0), (0.1, 0.2), (-0.25, -0.5), (0.5, 1.0), (9.0, 1.0), (-3, -1)]
)
def test_dead_time_law(current, share):
    """In proportion up to the full current, then constant, against the current."""
    assert dead_time_loss(current, 4.0, 0.5) == pytest.approx(4.0 * share)


@pytest.mark.parametrize('mode', [0, FIELD_ORIENTED])
@pytest.mark.parametrize('limit', [0, CIRCULAR, HEXAGONAL])
def test_dead_time_is_what_the_terminals_lack(drive_stand, mode, limit):
    """Same inputs, with and without: the terminals differ by the law of each line's current."""
    currents = np.array([3.0, -0.2, -2.8])
    found = []
    for lost in (0.0, 5.0):
        stand = drive_stand(dead_time_voltage=lost, mode=mode, voltage_limit=limit)
        stand.lines = currents
        found.append(stand.amplifier_only(4.0, 0.3))
    assert found[0] - found[1] == pytest.approx([5.0, -5.0 * 0.4, -5.0], rel=1e-9)


def test_dead_time_comes_after_the_update_delay(drive_stand):
    """It follows the present current, not that of the tick in which the voltage was worked out."""
    stand = drive_stand(dead_time_voltage=5.0, update_delay=1)
    stand.amplifier_only(0.0)
    stand.lines = np.array([2.0, -1.0, -1.0])
    assert stand.amplifier_only(0.0) == pytest.approx([-5.0, 5.0, 5.0], abs=1e-9)


def test_loop_makes_up_for_dead_time_when_at_rest(drive_stand):
    """Integral action: the standing current is that commanded, the voltage R i after the loss."""
    stand = drive_stand(dead_time_voltage=5.0, motor_resistance=4.0)
    for _ in range(3000):
        stand.tick(6.0, 1.0)
    assert stand.lines == pytest.approx(6.0 * stand.phasing(1.0), rel=1e-6)
    differences = np.diff(stand.terminals)
    assert differences == pytest.approx(np.diff(2.0 * stand.lines), rel=1e-6)


def test_dead_time_distorts_the_current_by_the_fifth_and_seventh_harmonic(drive_stand):
    """A square wave of +-V has harmonics V 4/(pi n); those of order 3 are not seen by the motor."""
    stand = drive_stand(dead_time_voltage=8.0, dead_time_current=0.5, proportional_gain=100)
    period = 360
    _, currents = driven(stand, 10 * period, 12.0, 2.0 * math.pi / period)
    spectrum = 2.0 * np.abs(np.fft.rfft(currents[-period:, 0])) / period
    assert spectrum[5] > 0.05
    assert spectrum[7] > 0.02
    assert spectrum[3] < 1e-3 * spectrum[5]
    clean = drive_stand(proportional_gain=100)
    _, currents = driven(clean, 10 * period, 12.0, 2.0 * math.pi / period)
    spectrum = 2.0 * np.abs(np.fft.rfft(currents[-period:, 0])) / period
    assert spectrum[5] < 1e-3


@pytest.mark.parametrize(('resistance', 'power'), [(2.0, 5000.0), (2.0, -4000.0), (0.5, 52812.5)])
def test_loaded_bus_obeys_kirchhoff(resistance, power):
    """V + R P / V = V0."""
    bus = loaded_bus(325.0, resistance, power)
    assert bus + resistance * power / bus == pytest.approx(325.0, rel=1e-12)
    assert (bus < 325.0) == (power > 0.0)


def test_overloaded_bus_gives_what_it_can():
    """Beyond V0^2 / 4R there is no solution; the bus stays at half of its voltage."""
    assert loaded_bus(100.0, 2.0, 1e9) == 50.0


def test_sag_weakens_the_voltage_by_the_power_of_the_tick_before(drive_stand):
    """Kirchhoff with the power worked out from the recorded terminals and currents."""
    soft, stiff = drive_stand(**SOFT), drive_stand()
    power = 0.0
    for tick in range(300):
        stiff.lines = measured = soft.lines
        for name in ('integrator', 'starting'):
            stiff.state[name][0, stiff.axis] = soft.field(name)
        full = stiff.amplifier_only(12.0, 0.02 * tick)
        found = soft.amplifier_only(12.0, 0.02 * tick)
        bus = 0.5 * (325.0 + math.sqrt(325.0**2 - 4.0 * 2.0 * power))
        assert found == pytest.approx(full * bus / 325.0, rel=1e-9, abs=1e-9)
        power = found @ measured
        soft.lines = soft.decay * measured + (1 - soft.decay) / soft.resistance * found
    assert power > 200.0
    assert bus < 324.0


def test_with_feedforward_sag_only_limits(drive_stand):
    """The loop is that of a stiff bus until the sagging bus cannot give the voltage."""
    settings = {'voltage_limit': CIRCULAR, 'limit_order': 0}
    stiff, _ = driven(drive_stand(**settings))
    soft, _ = driven(drive_stand(**SOFT, bus_feedforward=1, **settings))
    weak, _ = driven(drive_stand(**SOFT, **settings))
    assert np.array_equal(soft, stiff)
    assert np.abs(weak - stiff).max() > 0.05
    low = {'bus_voltage': 62.0, 'under_voltage': 0.0, 'bus_feedforward': 1, **settings}
    held, _ = driven(drive_stand(bus_resistance=0.0, **low), command=15.0)
    sagged, _ = driven(drive_stand(bus_resistance=2.0, **low), command=15.0)
    largest = [np.ptp(run[-100:], axis=1).max() for run in (held, sagged)]
    assert largest[1] < 0.9 * largest[0]


def test_sag_may_cause_an_under_voltage_fault(drive_stand):
    """The fault watches the bus as it is."""
    stand = drive_stand(bus_resistance=5.0, under_voltage=315.0)
    for tick in range(200):
        stand.tick(20.0, 0.02 * tick)
        if stand.field('faults') & faults.UNDER_VOLTAGE:
            break
    assert stand.field('faults') & faults.UNDER_VOLTAGE
    assert not stand.terminals.any()


def test_neutral_values_are_no_effect_at_all(drive_stand):
    """The same bits as without, whatever else is set beside the neutral value."""
    plain, _ = driven(drive_stand())
    neutral, _ = driven(
        drive_stand(
            bus_resistance=0.0, bus_feedforward=1, dead_time_voltage=0.0, dead_time_current=3.0
        )
    )
    assert np.array_equal(plain, neutral)


@pytest.mark.parametrize(
    ('name', 'small'), [('bus_resistance', 1e-3), ('dead_time_voltage', 1e-3)]
)
def test_effects_are_continuous_about_zero(drive_stand, name, small):
    """Half the parameter, half the change."""
    plain, _ = driven(drive_stand())
    full, _ = driven(drive_stand(**{name: small}))
    half, _ = driven(drive_stand(**{name: small / 2}))
    change = np.linalg.norm(full - plain)
    assert change > 0.0
    assert change / np.linalg.norm(half - plain) == pytest.approx(2.0, rel=1e-2)
