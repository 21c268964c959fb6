# SPDX-License-Identifier: Apache-2.0
"""The current loop on a motor of R and L, against discrete control theory."""

import math

import numpy as np
import pytest
from scipy import signal

from waferbot_copley.current_loop import (
    CIRCULAR,
    HEXAGONAL,
    common_mode,
    gains_from_motor,
    voltage_factor,
)

RESISTANCE, INDUCTANCE = 2.0, 1e-3  # of one branch of the star
SCALES = {'peak_current': 40.0, 'gain_scale': 1 / 64, 'integral_scale': 0.25}
BUS = 325.0


def designed_gains(bandwidth_hz=1500.0):
    """Return Cp and Ci for the motor above as settings."""
    proportional, integral = gains_from_motor(
        2 * RESISTANCE, 2 * INDUCTANCE, bandwidth_hz=bandwidth_hz, **SCALES
    )
    return {'proportional_gain': proportional, 'integral_gain': integral, **SCALES}


def loop_theory(stand, frequencies, update_delay):
    """
    Return the open loop C(z) G(z) z^-delay at the frequencies, in the z domain.

    G is resistance and inductance behind a zero-order hold, C = Kp + Ki / (z - 1).
    """
    kp, ki = stand.loop_gains()
    z = np.exp(2j * np.pi * frequencies / stand.tick_hz)
    plant, _, _ = signal.cont2discrete(([1.0], [INDUCTANCE, RESISTANCE]), 1 / stand.tick_hz)[:3]
    denominator = [1.0, -math.exp(-RESISTANCE / INDUCTANCE / stand.tick_hz)]
    motor = np.polyval(np.ravel(plant), z) / np.polyval(denominator, z)
    return (kp + ki / (z - 1)) * motor * z**-update_delay


def loop_measured(stand, frequencies, angle):
    """
    Return the open loop from injected sines: L = T / (1 - T), T = actual / commanded current.

    The current is the projection of the three lines on the phasing, over one whole 180 Hz period
    after the start has died out.
    """
    ticks = round(stand.tick_hz / 180)
    result = []
    for frequency in frequencies:
        response = 0.0
        for tick in range(20 * ticks):
            phase = 2 * np.pi * frequency * tick / stand.tick_hz
            actual = 2 / 3 * stand.tick(0.5 * math.sin(phase), angle) @ stand.phasing(angle)
            if tick >= 19 * ticks:
                response += 4 / ticks * actual * np.exp(-1j * phase)
        closed = response * 1j  # of a sine
        result.append(closed / (1 - closed))
    return np.array(result)


def crossover(frequencies, loop):
    """Return frequency of unity gain (Hz) and phase margin (degrees), by interpolation."""
    gain, phase = np.log(np.abs(loop)), np.unwrap(np.angle(loop))
    log_crossover = np.interp(0.0, -gain, np.log(frequencies))
    margin = 180 + np.degrees(np.interp(log_crossover, np.log(frequencies), phase))
    return math.exp(log_crossover), margin


@pytest.mark.parametrize('update_delay', [0, 1])
@pytest.mark.parametrize('settings', [{'mode': 0}, {'mode': 0, 'limit_order': 0}, {'mode': 1}])
def test_bandwidth_and_phase_margin(drive_stand, settings, update_delay):
    """The loop measured by injection is that of the z-domain calculation, at every frequency."""
    frequencies = 180.0 * np.array([1, 3, 5, 7, 8, 9, 10, 14, 25])
    stand = drive_stand(
        resistance=RESISTANCE, inductance=INDUCTANCE, update_delay=update_delay,
        **settings, **designed_gains(),
    )  # fmt: skip
    measured = loop_measured(stand, frequencies, angle=0.7)
    theory = loop_theory(stand, frequencies, update_delay)
    assert measured == pytest.approx(theory, rel=1e-5)

    fine = np.linspace(800.0, 3000.0, 5000)
    bandwidth, margin = crossover(fine, loop_theory(stand, fine, update_delay))
    measured_bandwidth, measured_margin = crossover(frequencies, measured)
    assert measured_bandwidth == pytest.approx(bandwidth, rel=0.01)
    assert measured_margin == pytest.approx(margin, abs=1.0)
    # what the design rule promises
    assert bandwidth == pytest.approx(1500.0, rel=0.06)
    assert margin == pytest.approx(75.0 - 30.0 * update_delay, abs=2.0)


def test_gains_from_motor_are_those_of_the_rule(drive_stand):
    """Kp = 2 pi f L and Ki = Kp R / (L f_loop), to half a step of the drive's whole numbers."""
    stand = drive_stand(**designed_gains(1200.0))
    step = 32 * SCALES['gain_scale'] / SCALES['peak_current']
    kp, ki = stand.loop_gains()
    exact = 2 * math.pi * 1200.0 * INDUCTANCE
    assert kp == pytest.approx(exact, abs=step / 2)
    assert ki == pytest.approx(exact * RESISTANCE / (INDUCTANCE * 18000), abs=step / 8)


def test_loop_is_that_of_the_thesis(drive_stand):
    """
    Three separate PI loops of line currents, written from Fig. 3.11, give the same voltages.

    V = PI(e) * 32 / Vbus * Vbus / Ipeak in each line; the commands sum to zero.
    """
    seed = 11
    print('seed', seed)
    random = np.random.default_rng(seed)
    stand = drive_stand(proportional_gain=700, integral_gain=250, **SCALES)
    integrator = np.zeros(3)
    command = 0.0
    for _ in range(500):
        command += random.normal()
        angle = random.uniform(-30, 30)
        stand.lines = random.normal(size=3) * 5
        wanted = np.clip(command, -30, 30) * stand.phasing(angle)
        error = wanted - stand.lines
        pi = SCALES['gain_scale'] * (700 * error + 0.25 * 250 * integrator)
        integrator += error
        expected = pi * (32 / BUS) * (BUS / 40.0)
        terminals = stand.amplifier_only(np.clip(command, -30, 30), angle)
        assert terminals == pytest.approx(expected, rel=1e-7, abs=1e-6)  # the angle is in counts
        assert terminals.sum() == pytest.approx(0.0, abs=1e-12 * np.abs(terminals).max())


@pytest.mark.parametrize('angle', [0.0, 0.4, 2.0, 5.5])
def test_field_oriented_and_per_phase_agree_at_standstill(drive_stand, angle):
    """On small steps both loops give the same line currents, as the rotor frame stands still."""
    stands = [drive_stand(mode=mode, **designed_gains()) for mode in (0, 1)]
    for tick in range(200):
        command = 2.0 if tick < 100 else -1.0
        per_phase, field_oriented = (stand.tick(command, angle) for stand in stands)
        assert per_phase == pytest.approx(field_oriented, abs=1e-9)
    assert per_phase == pytest.approx(-stands[0].phasing(angle), rel=1e-3, abs=1e-3)


def test_rotating_motor_separates_the_two_modes(drive_stand):
    """
    At an electrical frequency f the per-phase loop follows with its own response T(f).

    The rotor frame sees a constant instead and has no error in the long run.
    """
    frequency = 150.0
    stands = [drive_stand(mode=mode, **designed_gains()) for mode in (0, 1)]
    per_phase, field_oriented = [], []
    for tick in range(2400):
        angle = 2 * math.pi * frequency * tick / 18000
        for stand, record in zip(stands, (per_phase, field_oriented), strict=True):
            line_1 = stand.tick(3.0, angle)[0]
            if tick >= 2280:  # the last whole electrical cycle
                record.append(line_1 * np.exp(-1j * angle) * 2j / 120)
    loop = loop_theory(stands[0], np.array([frequency]), 0)[0]
    assert sum(per_phase) == pytest.approx(3.0 * loop / (1 + loop), rel=1e-5)
    assert sum(field_oriented) == pytest.approx(3.0, rel=1e-5)
    assert abs(loop / (1 + loop) - 1) > 0.02  # so the two do differ


def test_bus_voltage_cancels_until_it_limits(drive_stand):
    """The bus changes nothing while it suffices; a low bus holds the voltage down."""

    def voltage(bus, command):
        stand = drive_stand(
            bus_voltage=bus, voltage_limit=CIRCULAR, limit_order=0, **designed_gains()
        )
        terminals = stand.amplifier_only(command, math.pi / 2)
        return terminals - terminals.mean()

    assert voltage(100.0, 5.0) == pytest.approx(voltage(400.0, 5.0), rel=1e-12)
    assert voltage(100.0, 35.0)[0] == pytest.approx(100.0 / math.sqrt(3), rel=1e-12)
    assert voltage(400.0, 35.0)[0] == pytest.approx(400.0 / math.sqrt(3), rel=1e-12)


@pytest.mark.parametrize('mode', [0, 1])
@pytest.mark.parametrize('limit', [CIRCULAR, HEXAGONAL])
def test_voltage_limits(drive_stand, limit, mode):
    """
    A command that wants far too much voltage gets the largest vector there is, in its direction.

    Circle: Vbus / sqrt(3) everywhere. Hexagon: the same in the middle of its sides, 2/3 Vbus in
    its corners. No terminal leaves the bus.
    """
    radii = []
    for angle in np.radians(np.arange(0.0, 360.0, 5.0)):
        stand = drive_stand(mode=mode, voltage_limit=limit, limit_order=0, **designed_gains(6000))
        terminals = stand.amplifier_only(40.0, angle)
        vector = terminals - terminals.mean()
        radius = math.sqrt(2 / 3 * (vector**2).sum())
        assert vector == pytest.approx(radius * stand.phasing(angle), abs=1e-5)
        assert np.abs(terminals).max() <= BUS / 2 * (1 + 1e-12)
        assert np.ptp(terminals) <= BUS * (1 + 1e-12)
        radii.append(radius)
    if limit == CIRCULAR:
        assert radii == pytest.approx([BUS / math.sqrt(3)] * len(radii), rel=1e-12)
    else:  # line 1 is largest at 90 degrees: a corner
        assert radii[18] == pytest.approx(2 / 3 * BUS, rel=1e-7)
        assert radii[0] == pytest.approx(BUS / math.sqrt(3), rel=1e-7)
        assert min(radii) >= BUS / math.sqrt(3) * (1 - 1e-7)
        assert max(radii) <= 2 / 3 * BUS * (1 + 1e-7)


def test_voltage_factor_leaves_small_vectors_alone():
    """Inside the limit the factor is exactly 1."""
    for limit in (0, CIRCULAR, HEXAGONAL):
        assert voltage_factor(50.0, -20.0, BUS, limit) == 1.0
    assert voltage_factor(1e4, -20.0, BUS, 0) == 1.0


def test_common_mode_centres_the_terminals():
    """The highest and the lowest terminal end up equally far from the middle of the bus."""
    vector = np.array([100.0, 30.0, -130.0])
    shifted = vector + common_mode(*vector)
    assert shifted.max() == pytest.approx(-shifted.min())
    assert np.diff(shifted) == pytest.approx(np.diff(vector))


@pytest.mark.parametrize('mode', [0, 1])
def test_saturation_does_not_wind_up(drive_stand, mode):
    """
    After a long time at the voltage limit the current returns as fast as after a short one.

    The command of 30 A through 10 ohm is more than the bus can drive. Without the correction of
    the integrator (tracking 0) the same loop is far slower, so the test can tell.
    """

    def ticks_to_return(tracking, saturated_ticks):
        stand = drive_stand(
            resistance=10.0, inductance=5e-3, mode=mode, voltage_limit=CIRCULAR, limit_order=0,
            **{**designed_gains(), 'proportional_gain': 3000, 'integral_gain': 1200},
        )  # fmt: skip
        if tracking is not None:
            stand.parameters['tracking'] = tracking
        for _ in range(saturated_ticks):
            stand.tick(30.0, 0.3)
        assert np.hypot(*stand.field('integrator')) > 0
        ticks = 0
        while np.abs(stand.tick(5.0, 0.3) - 5.0 * stand.phasing(0.3)).max() > 0.1:
            ticks += 1
            assert ticks < 5000
        return ticks

    assert ticks_to_return(None, 2000) <= ticks_to_return(None, 100) + 1
    assert ticks_to_return(0.0, 2000) > 5 * ticks_to_return(None, 2000)


@pytest.mark.parametrize(('proportional', 'integral'), [(500, 100), (500, 8000), (0, 300)])
def test_integrator_stays_within_the_voltage_limit(drive_stand, proportional, integral):
    """However long the limit lasts, the integrator holds at most one tick's error beyond it."""
    stand = drive_stand(
        voltage_limit=CIRCULAR, proportional_gain=proportional, integral_gain=integral, **SCALES
    )
    _, ki = stand.loop_gains()
    scale = 32 / SCALES['peak_current']
    random = np.random.default_rng(5)
    for _ in range(500):
        stand.lines = random.normal(size=3) * 10
        stand.amplifier_only(40.0 * random.choice([-1.0, 1.0]), random.uniform(0, 6))
        line_1, line_2 = stand.field('integrator') * scale
        held = math.sqrt(4 / 3 * (line_1**2 + line_1 * line_2 + line_2**2))
        assert held <= BUS / math.sqrt(3) + ki * 90.0


@pytest.mark.parametrize('mode', [0, 1])
@pytest.mark.parametrize('update_delay', [0, 1])
def test_loop_that_knows_the_resistance_takes_over_a_current_without_a_bump(
    drive_stand, mode, update_delay
):
    """The motor already carries what is commanded; from the first tick it stays as it is."""
    stands = {
        known: drive_stand(
            resistance=RESISTANCE,
            inductance=INDUCTANCE,
            mode=mode,
            update_delay=update_delay,
            motor_resistance=2 * RESISTANCE if known else 0.0,
            **designed_gains(),
        )
        for known in (True, False)
    }
    angle, current = 2.0 * math.pi * 0.111, 8.0  # a whole number of the stand's counts
    lines = current * (stands[True].phasing(angle))
    bumps = {}
    for known, stand in stands.items():
        stand.lines = lines
        errors = []
        for _ in range(200):
            stand.tick(current, angle)
            errors.append(np.abs(stand.lines - lines).max())
        bumps[known] = max(errors)
    assert bumps[True] < 1e-9 * current
    assert bumps[False] > 0.1


def test_bridge_switched_on_again_starts_afresh(drive_stand):
    """After safe torque off the terminals were open: no current, so no voltage to begin with."""
    stand = drive_stand(motor_resistance=2 * RESISTANCE, **designed_gains())
    stand.lines = 5.0 * stand.phasing(0.0)
    stand.amplifier_only(5.0)
    assert np.abs(stand.field('integrator')).max() > 0.0
    stand.set('safe_torque_off', 1)
    assert not stand.amplifier_only(0.0).any()
    stand.lines = np.zeros(3)
    stand.set('safe_torque_off', 0)
    stand.state['faults'] = 0
    assert not stand.amplifier_only(0.0).any()
