# SPDX-License-Identifier: Apache-2.0
"""The servo law against the manual's formula in exact arithmetic, and each modifier by itself."""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.contract import AXES
from waferbot_pmac import servo
from waferbot_pmac.i_variables import servo_parameters

AMPERES_PER_BIT = 2.0**-10

QUIET = {
    'Ixx31': 0,
    'Ixx32': 0,
    'Ixx33': 0,
    'Ixx69': 32767,
    'Ixx11': 0,
    'Ixx12': 0,
    'amplifier_peak_current': AMPERES_PER_BIT * 32768,
}
"""Proportional gain only, and no limits in the way."""

ONE_BIT_PER_COUNT = {'Ixx30': 2**13, 'Ixx08': 64, 'Ixx09': 64}
"""One DAC bit for one count of error."""


def run(settings_of_axes, counts, commanded, **change_at):
    """
    Run the servo from standstill at the first row of `counts` (n, 4) and `commanded` (n, 3).

    `change_at` maps `cycle_<n>` to a function called with the parameters before that cycle.
    Returns the current in units of `AMPERES_PER_BIT`, so in DAC bits, (n, 3), and the states, one
    per cycle.
    """
    parameters = servo_parameters(settings_of_axes)
    state = servo.initial_state(parameters)
    counts = np.asarray(counts, dtype=np.int64)
    commanded = np.asarray(commanded, dtype=np.float64)
    servo.prime(state, parameters, counts[0], commanded[0])
    currents = np.zeros((len(counts), 3))
    states = []
    for n in range(len(counts)):
        if f'cycle_{n}' in change_at:
            change_at[f'cycle_{n}'](parameters)
        servo.step(state, parameters, counts[n], commanded[n], currents[n])
        states.append(state[0].copy())
    return currents / AMPERES_PER_BIT, np.array(states)


def run_y_linear(values, counts, commanded, **change_at):
    """Run with motion of `y_linear` only; counts and commanded positions of shape (n,)."""
    all_counts = np.zeros((len(counts), 4), np.int64)
    all_counts[:, 0] = counts
    all_commanded = np.zeros((len(counts), 3))
    all_commanded[:, 0] = commanded
    currents, states = run(
        {'y_linear': {**QUIET, **values}}, all_counts, all_commanded, **change_at
    )
    return currents[:, 0], states


class ManualServo:
    """
    The law as the manual prints it, in counts and DAC units, in rational numbers.

    Written from the equation, with sums over the history instead of registers.
    """

    def __init__(self, i, velocity_counts, commanded):
        self.i = {name: Fraction(value) for name, value in i.items()}
        self.cp = [self.rounded(commanded)] * 3
        self.avp = [Fraction(velocity_counts)] * 2
        self.integral = Fraction(0)  # Ixx33 * IE / 2^23, in counts
        self.x = [Fraction(0)] * 2
        self.y = [Fraction(0)] * 2

    def rounded(self, commanded):
        unit = 32 * self.i['Ixx08']
        return math.floor(Fraction(commanded) * unit + Fraction(1, 2)) / Fraction(unit)

    def cycle(self, position_counts, velocity_counts, commanded):
        i = self.i
        self.cp = [self.rounded(commanded), *self.cp[:2]]
        self.avp = [Fraction(velocity_counts), self.avp[0]]
        cv = self.cp[0] - self.cp[1]
        ca = cv - (self.cp[1] - self.cp[2])
        av = self.avp[0] - self.avp[1]
        fe = self.cp[0] - position_counts
        fe = max(-i['Ixx67'] / 16, min(i['Ixx67'] / 16, fe))
        band, gain = i['Ixx65'] / 16, i['Ixx64'] / 16
        fe += gain * max(-band, min(band, fe))
        feedforward = (i['Ixx32'] * cv + i['Ixx35'] * ca) / 128
        damping = i['Ixx31'] * i['Ixx09'] * av / 128
        x = (
            Fraction(1, 2**19)
            * i['Ixx30']
            * (i['Ixx08'] * (fe + feedforward + self.integral) - damping)
        )
        y = (
            x
            + i['Ixx36'] * self.x[0]
            + i['Ixx37'] * self.x[1]
            - i['Ixx38'] * self.y[0]
            - i['Ixx39'] * self.y[1]
        )
        self.x, self.y = [x, self.x[0]], [y, self.y[0]]
        command = y + i['Ixx29'] + i['Ixx68'] * ((cv > 0) - (cv < 0))
        saturated = abs(command) >= i['Ixx69']
        command = max(-i['Ixx69'], min(i['Ixx69'], command))
        if not saturated and (i['Ixx34'] == 0 or cv == 0):
            if int(i['Ixx96']) & 2:
                velocity_error = fe + feedforward - damping / i['Ixx08']
                self.integral += i['Ixx33'] * velocity_error / 2**23
            else:
                self.integral += i['Ixx33'] * fe / 2**23
        limit = abs(i['Ixx63']) / 16
        self.integral = max(-limit, min(limit, self.integral))
        return command


def random_settings(random):
    """Return random settings of one motor: all terms present, stable notch, no faults."""

    def whole(low, high):
        return int(random.integers(low, high))

    poles = random.uniform(0.0, 0.9) * np.exp(1j * random.uniform(0.0, np.pi))
    zeros = random.uniform(0.5, 1.0) * np.exp(1j * random.uniform(0.0, np.pi))
    with_notch = random.random() < 0.5

    def coefficient(value):
        return round(value * 2**22) / 2**22 if with_notch else 0.0

    return {
        'Ixx08': whole(1, 200),
        'Ixx09': whole(0, 200),
        'Ixx11': 0,
        'Ixx12': 0,
        'Ixx29': whole(-500, 500),
        'Ixx30': whole(-300000, 300000),
        'Ixx31': whole(-4000, 4000),
        'Ixx32': whole(-4000, 4000),
        'Ixx33': whole(0, 2000000),
        'Ixx34': whole(0, 2),
        'Ixx35': whole(-4000, 4000),
        'Ixx36': coefficient(-2.0 * zeros.real),
        'Ixx37': coefficient(abs(zeros) ** 2),
        'Ixx38': coefficient(-2.0 * poles.real),
        'Ixx39': coefficient(abs(poles) ** 2),
        'Ixx63': whole(1, 3000),
        'Ixx64': whole(-16, 40),
        'Ixx65': whole(0, 400),
        'Ixx67': whole(1, 4000),
        'Ixx68': whole(0, 300),
        'Ixx69': whole(1, 32767),
        'Ixx96': 2 * whole(0, 2),
    }


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_law_matches_the_manuals_equation_in_exact_arithmetic(seed):
    random = np.random.default_rng(seed)
    cycles = 25
    values = {axis: {**QUIET, **random_settings(random)} for axis in AXES}
    values['y_rotate'] |= {'Ixx03': 2, 'Ixx04': 3}
    values['y_linear'] |= {'Ixx03': 0, 'Ixx04': 0}
    values['x_rotate'] |= {'Ixx03': 1, 'Ixx04': 0}
    offset = random.integers(-(10**9), 10**9)
    counts = offset + np.cumsum(random.integers(-40, 40, (cycles, 4)), axis=0)
    # Positions in 1/4096 count, which is no multiple of the register unit; often standing still.
    moves = random.integers(-80 * 4096, 80 * 4096, (cycles, 3)) * (
        random.random((cycles, 3)) < 0.6
    )
    commanded = offset + np.cumsum(moves, axis=0) / 4096.0

    currents, states = run(values, counts, commanded)

    for place, axis in enumerate(AXES):
        position, velocity = values[axis]['Ixx03'], values[axis]['Ixx04']
        manual = ManualServo(values[axis], int(counts[0, velocity]), commanded[0, place])
        for n in range(cycles):
            exact = manual.cycle(
                int(counts[n, position]), int(counts[n, velocity]), commanded[n, place]
            )
            # The command word is rounded down to 1/256 DAC unit; float64 may lie within 1e-9 of a
            # step and fall on its other side.
            tolerance = Fraction(1, 10**9) * max(1, abs(exact))
            possible = {
                math.floor((exact - tolerance) * 256),
                math.floor((exact + tolerance) * 256),
            }
            assert states['output'][n, place] * 256 in possible
            assert currents[n, place] == states['output'][n, place]
            assert states['integrator'][n, place] == pytest.approx(
                float(manual.integral), rel=1e-12, abs=1e-15
            )


def test_proportional_gain_in_dac_bits_per_count():
    current, _ = run_y_linear({'Ixx30': 2000}, [0, 0], [0, 1000])
    exact = 2000 * 96 * 1000 / 2**19
    assert current[1] == math.floor(exact * 256) / 256


def test_current_is_the_output_times_the_amplifiers_scale():
    current, states = run_y_linear({'amplifier_peak_current': 40.0}, [0, 0], [0, 1000])
    assert current[1] * AMPERES_PER_BIT == states['output'][1, 0] * 40.0 / 32768


def test_first_cycle_after_prime_has_no_kick_from_where_the_axis_stands():
    everything = {'Ixx31': 3000, 'Ixx32': 3000, 'Ixx35': 3000, 'Ixx33': 5000, 'Ixx34': 0}
    position = 123_456_789
    current, states = run_y_linear(everything, [position] * 5, [position] * 5)
    assert not current.any()
    assert not states['flags'][:, 0].astype(int).__and__(servo.MOVING).any()


def test_step_makes_one_pulse_of_velocity_and_two_of_acceleration_feedforward():
    values = {**ONE_BIT_PER_COUNT, 'Ixx32': 256, 'Ixx35': 384}
    commanded = [0, 0, 10, 10, 10, 10]
    current, states = run_y_linear(values, [0] * 6, commanded)
    assert current.tolist() == [0, 0, 10 + 20 + 30, 10 - 30, 10, 10]
    moving = states['flags'][:, 0] & servo.MOVING
    assert moving.astype(bool).tolist() == [False, False, True, False, False, False]


def test_derivative_acts_on_the_velocity_feedback_only():
    values = {**ONE_BIT_PER_COUNT, 'Ixx31': 128}
    current, _ = run_y_linear(values, [0, 0, 5, 5], [0, 0, 0, 0])
    assert current.tolist() == [0, 0, -5 - 5, -5]


def test_dual_feedback_scale_makes_a_finer_velocity_sensor_equal():
    """A motor encoder three times as fine, with a third of Ixx09, damps as the load encoder."""
    random = np.random.default_rng(7)
    load = np.cumsum(random.integers(-30, 30, 40))
    counts = np.zeros((40, 4), np.int64)
    counts[:, 2] = load
    counts[:, 3] = 3 * load
    commanded = np.zeros((40, 3))
    values = {**QUIET, 'Ixx31': 2500, 'Ixx08': 96}
    single, _ = run({'y_rotate': {**values, 'Ixx04': 2, 'Ixx09': 96}}, counts, commanded)
    dual, _ = run({'y_rotate': {**values, 'Ixx04': 3, 'Ixx09': 32}}, counts, commanded)
    assert np.abs(single[:, 2]).max() > 10
    assert (single == dual).all()


def test_output_is_limited_and_flagged_at_ixx69():
    current, states = run_y_linear({'Ixx69': 1000}, [0] * 3, [0, 10**6, -(10**6)])
    assert current.tolist() == [0, 1000, -1000]
    limited = states['flags'][:, 0] & servo.OUTPUT_LIMITED
    assert limited.tolist() == [0, servo.OUTPUT_LIMITED, servo.OUTPUT_LIMITED]


@pytest.mark.parametrize(('command', 'limited'), [(99, False), (100, True)])
def test_output_that_just_reaches_the_limit_counts_as_limited(command, limited):
    values = {**ONE_BIT_PER_COUNT, 'Ixx69': 100, 'Ixx33': 1, 'Ixx34': 0}
    current, states = run_y_linear(values, [0] * 2, [0, command])
    assert current.tolist() == [0, command]
    reason = servo.OUTPUT_LIMITED if limited else servo.INTEGRATOR_ACTIVE
    assert states['flags'][1, 0] == servo.MOVING | reason
    assert (states['integrator'][1, 0] == 0) == limited


def test_integrator_is_held_not_cleared_while_saturated():
    values = {'Ixx33': 100000, 'Ixx34': 0, 'Ixx69': 500}
    commanded = [0] + [100] * 10 + [10**5] * 10 + [100] * 3
    _, states = run_y_linear(values, [0] * 24, commanded)
    stored = states['integrator'][:, 0]
    assert stored[10] > 0
    assert (stored[11:21] == stored[10]).all()
    assert stored[21] > stored[20]


def test_integrator_is_held_not_cleared_while_moving_in_mode_1():
    commanded = [0, 50, 50, 50, 50] + [51 + n for n in range(10)] + [60, 60]
    values = {'Ixx33': 100000, 'Ixx34': 1}
    _, states = run_y_linear(values, [0] * 17, commanded)
    stored = states['integrator'][:, 0]
    active = (states['flags'][:, 0] & servo.INTEGRATOR_ACTIVE).astype(bool)
    assert stored[4] > 0
    assert (stored[5:15] == stored[4]).all()
    assert not active[5:15].any()
    assert stored[15] > stored[14]
    assert active[15]
    _, always = run_y_linear({**values, 'Ixx34': 0}, [0] * 17, commanded)
    assert (np.diff(always['integrator'][1:, 0]) > 0).all()


def test_integral_acts_one_cycle_late():
    values = {**ONE_BIT_PER_COUNT, 'Ixx33': 2**22, 'Ixx34': 0}
    current, _ = run_y_linear(values, [0] * 4, [0, 10, 10, 10])
    assert current.tolist() == [0, 10, 15, 20]


def test_ixx33_zero_keeps_the_integrators_output_and_ixx63_zero_clears_it():
    def set_to_zero(name):
        def change(parameters):
            parameters[name][0, 0] = 0

        return change

    values = {'Ixx33': 100000, 'Ixx34': 0}
    commanded = [0] + [10] * 9
    _, kept = run_y_linear(values, [0] * 10, commanded, cycle_5=set_to_zero('Ixx33'))
    assert kept['integrator'][9, 0] == kept['integrator'][4, 0] > 0
    current, cleared = run_y_linear(values, [0] * 10, commanded, cycle_5=set_to_zero('Ixx63'))
    assert (cleared['integrator'][5:, 0] == 0).all()
    proportional, _ = run_y_linear({'Ixx33': 0}, [0] * 10, commanded)
    assert current[5] == proportional[5]


def test_integrator_at_the_limit_of_the_manuals_rule_reaches_ixx69_by_itself():
    """Ixx63 = Ixx69 * 2^23 / (Ixx08 * Ixx30) lets the integral term alone saturate the output."""
    ixx30, ixx69 = 2**16, 3000
    limit = ixx69 * 2**23 // (96 * ixx30)
    values = {'Ixx30': ixx30, 'Ixx33': 2**22, 'Ixx34': 0, 'Ixx63': limit}
    current, states = run_y_linear(values, [0] * 14, [0] + [50] * 12 + [0])
    assert states['integrator'][-2, 0] == limit / 16
    assert states['flags'][-2, 0] & servo.INTEGRATOR_LIMITED
    assert current[-1] == ixx69


@pytest.mark.parametrize('sign', [1, -1])
def test_negative_ixx63_kills_a_motor_whose_integrator_is_full(sign):
    values = {'Ixx33': 2**22, 'Ixx34': 0, 'Ixx63': 16 * 100 * sign, 'Ixx24': 2 << 21}
    current, states = run_y_linear(values, [0] * 30, [0] + [20] * 29)
    full = int(np.argmax(states['flags'][:, 0] & servo.INTEGRATOR_LIMITED > 0))
    assert states['integrator'][full, 0] == 100
    assert full < 25
    both = servo.FATAL_FOLLOWING_ERROR | servo.INTEGRATOR_LIMITED | servo.MOTOR_KILLED
    if sign > 0:
        assert current[-1] != 0
        assert not states['flags'][-1, 0] & servo.MOTOR_KILLED
    else:
        assert not current[full + 1 :].any()
        assert (states['flags'][full + 1 :, 0] & both == both).all()


def test_integrator_inside_the_velocity_loop_sums_the_velocity_error():
    values = {**ONE_BIT_PER_COUNT, 'Ixx31': 128, 'Ixx33': 2**22, 'Ixx34': 0}
    current, _ = run_y_linear({**values, 'Ixx96': 2}, [0, 0, 4, 4], [0, 10, 10, 10])
    # velocity error: 10, then 6 - 4, then 6; half of each enters the integrator
    assert current.tolist() == [0, 10, 6 - 4 + 5, 6 + 5 + 1]


def test_warning_and_fatal_following_error():
    values = {'Ixx12': 16 * 100, 'Ixx11': 16 * 200, 'Ixx24': 2 << 21}
    commanded = [0, 100, 101, 200, 201, 0, 0]
    current, states = run_y_linear(values, [0] * 7, commanded)
    flags = states['flags'][:, 0]
    warned = (flags & servo.WARNING_FOLLOWING_ERROR).astype(bool)
    assert warned.tolist() == [False, False, True, True, True, True, True]
    fatal = (flags & servo.FATAL_FOLLOWING_ERROR).astype(bool)
    assert fatal.tolist() == [False] * 4 + [True] * 3
    assert current[3] != 0
    assert not current[4:].any()
    assert states['killed'][:, 0].tolist() == [0] * 4 + [1] * 3


@pytest.mark.parametrize(
    ('scope', 'others_killed'), [(0, True), (1, True), (2, False), (3, False)]
)
def test_ixx24_says_whom_a_fault_kills(scope, others_killed):
    faulty = {**QUIET, 'Ixx11': 16, 'Ixx24': scope << 21}
    values = {'y_linear': QUIET, 'x_rotate': faulty, 'y_rotate': {**QUIET, 'Ixx04': 2}}
    commanded = np.zeros((3, 3))
    commanded[1:] = 10
    current, states = run(values, np.zeros((3, 4), np.int64), commanded)
    assert current[1, 1] == 0
    assert states['killed'][1, 1]
    for other in (0, 2):
        assert (current[1, other] == 0) == others_killed
        killed = states['flags'][2, other] & servo.MOTOR_KILLED
        assert bool(killed) == others_killed
        assert not states['flags'][2, other] & servo.FATAL_FOLLOWING_ERROR


def test_prime_closes_a_killed_loop_again():
    parameters = servo_parameters({'y_linear': {**QUIET, 'Ixx11': 16}})
    state = servo.initial_state(parameters)
    counts, current = np.zeros(4, np.int64), np.zeros(3)
    servo.step(state, parameters, counts, np.array([5.0, 0.0, 0.0]), current)
    assert state['killed'].all()
    servo.prime(state, parameters, counts, np.zeros(3))
    servo.step(state, parameters, counts, np.array([1.0, 0.0, 0.0]), current)
    assert current[0] > 0
    assert not state['killed'].any()
    assert state['flags'][0, 0] == servo.MOVING


def test_prime_forgets_the_motion_before():
    values = {'Ixx32': 500, 'Ixx35': 500, 'Ixx31': 500, 'Ixx33': 5000, 'Ixx34': 0, 'Ixx36': 0.5}
    parameters = servo_parameters({axis: {**QUIET, **values} for axis in AXES})
    state = servo.initial_state(parameters)
    counts, current = np.zeros(4, np.int64), np.zeros(3)
    for n in range(20):
        counts += 3
        servo.step(state, parameters, counts, np.full(3, 2.0 * n * n), current)
    assert current.all()
    servo.prime(state, parameters, counts, counts[:3].astype(float))
    fresh = servo.initial_state(parameters)
    servo.prime(fresh, parameters, counts, counts[:3].astype(float))
    assert state == fresh
    servo.step(state, parameters, counts, counts[:3].astype(float), current)
    assert not current.any()


def test_ixx67_limits_the_error_that_the_filter_sees_but_not_the_reported_one():
    current, states = run_y_linear({'Ixx67': 16 * 50}, [0] * 4, [0, 49, 50, 10**5])
    assert current[3] == current[2] > current[1]
    assert states['following_error'][3, 0] == 10**5


@given(gain=st.integers(-16, 64), width=st.integers(1, 3000))
@settings(max_examples=50, deadline=None)
def test_deadband_is_continuous_and_tends_to_the_usual_gain(gain, width):
    edge = width / 16.0
    errors = np.array([0.0, edge / 2, edge, edge + 1 / 32, 2 * edge, 1e6 * edge])
    deadbanded = np.array([servo._deadband(e, edge, gain / 16.0) for e in errors])
    mirrored = np.array([servo._deadband(-e, edge, gain / 16.0) for e in errors])
    assert (mirrored == -deadbanded).all()
    assert deadbanded[1] == pytest.approx(errors[1] * (gain + 16) / 16)
    assert deadbanded[2] == pytest.approx(errors[2] * (gain + 16) / 16)
    assert deadbanded[3] - deadbanded[2] == pytest.approx(1 / 32, rel=1e-6)
    assert deadbanded[5] / errors[5] == pytest.approx(1.0, rel=1e-5)


def test_true_deadband_leaves_no_command_inside():
    values = {'Ixx64': -16, 'Ixx65': 16 * 20}
    current, _ = run_y_linear(values, [0] * 5, [0, 19, 20, 21, -20])
    assert current[1] == current[2] == current[4] == 0
    assert current[3] > 0


def test_notch_matches_scipy_and_has_its_gain_at_rest():
    numerator, denominator = [1.0, -1.75, 0.96875], [1.0, -1.25, 0.5]
    values = {
        'Ixx36': numerator[1],
        'Ixx37': numerator[2],
        'Ixx38': denominator[1],
        'Ixx39': denominator[2],
        **ONE_BIT_PER_COUNT,
    }
    error = np.random.default_rng(3).integers(-500, 500, 300)
    error[0] = 0
    error[200:] = 1000
    current, _ = run_y_linear(values, [0] * 300, error)
    expected = scipy.signal.lfilter(numerator, denominator, error)
    assert current == pytest.approx(expected, abs=1 / 256)
    at_rest = 1000 * sum(numerator) / sum(denominator)
    assert current[-1] == pytest.approx(at_rest, abs=1 / 256)


def test_friction_feedforward_has_the_sign_of_the_commanded_velocity():
    values = {'Ixx30': 0, 'Ixx68': 160, 'Ixx29': -7}
    current, _ = run_y_linear(values, [0] * 5, [0, 0.5, 1.0, 0.25, 0.25])
    assert current.tolist() == [-7, 153, 153, -167, -7]
    limited, _ = run_y_linear({**values, 'Ixx69': 100}, [0] * 5, [0, 0.5, 1.0, 0.25, 0.25])
    assert limited.tolist() == [-7, 100, 100, -100, -7]


def test_extended_cycle_acts_every_ixx60_plus_first_interrupt_and_holds_between():
    values = {**ONE_BIT_PER_COUNT, 'Ixx31': 128, 'Ixx60': 2}
    counts = [0, 1, 2, 3, 4, 5, 6]
    current, _ = run_y_linear(values, counts, [0] * 7)
    # at interrupts 0, 3 and 6 three counts have gone by since the cycle before
    assert current.tolist() == [0, 0, 0, -3 - 3, -6, -6, -6 - 3]


def test_current_protection_trips_after_the_time_of_the_manuals_example():
    """|I|T: 0.75 of full scale, continuous 0.25, 3 s at 4 kHz: Ixx58 = 6000."""
    parameters = servo_parameters(
        {'y_linear': {**QUIET, 'Ixx30': 0, 'Ixx29': 24576, 'Ixx57': -8192, 'Ixx58': 6000}}
    )
    assert _interrupts_until_trip(parameters) == 12000


@pytest.mark.parametrize('cycle_extension', [0, 3])
def test_i2t_trips_at_the_analytic_time(cycle_extension):
    level, continuous, integral = 0.5, 0.25, 300
    parameters = servo_parameters(
        {
            'y_linear': {
                **QUIET,
                'Ixx30': 0,
                'Ixx29': int(level * 32768),
                'Ixx57': int(continuous * 32768),
                'Ixx58': integral,
                'Ixx60': cycle_extension,
            }
        }
    )
    assert _interrupts_until_trip(parameters) == integral / (level**2 - continuous**2)


def test_current_protection_does_not_save_up_credit_at_rest():
    """After a long rest it trips as soon as after a short one."""
    values = {**QUIET, 'Ixx30': 0, 'Ixx29': 16384, 'Ixx57': 8192, 'Ixx58': 30}
    parameters = servo_parameters({'y_linear': values})
    state = servo.initial_state(parameters)
    counts, commanded, current = np.zeros(4, np.int64), np.zeros(3), np.zeros(3)
    parameters['Ixx29'] = 0
    for _ in range(1000):
        servo.step(state, parameters, counts, commanded, current)
    parameters['Ixx29'] = 16384
    assert _interrupts_until_trip(parameters, state=state) == 160  # 30 / (0.5^2 - 0.25^2)


def test_i2t_stays_empty_below_the_continuous_current_and_off_at_ixx58_zero():
    for values in ({'Ixx57': 1001, 'Ixx58': 1}, {'Ixx57': 0, 'Ixx58': 0}):
        parameters = servo_parameters({'y_linear': {**QUIET, 'Ixx30': 0, 'Ixx29': 1000, **values}})
        assert _interrupts_until_trip(parameters, at_most=2000) is None


def _interrupts_until_trip(parameters, at_most=100_000, state=None):
    state = servo.initial_state(parameters) if state is None else state
    counts, commanded, current = np.zeros(4, np.int64), np.zeros(3), np.zeros(3)
    for interrupt in range(1, at_most + 1):
        servo.step(state, parameters, counts, commanded, current)
        if state['flags'][0, 0] & servo.AMPLIFIER_I2T:
            assert current[0] == 0
            assert state['killed'][0, 0]
            return interrupt
    return None


def test_in_position_needs_standstill_and_a_small_error():
    _, states = run_y_linear({'Ixx28': 16 * 10}, [0] * 5, [0, 9, 9, 10, 10])
    assert states['in_position'][:, 0].tolist() == [1, 0, 1, 0, 0]


def test_gains_in_si_units_close_a_loop_with_the_frequency_and_damping_they_stand_for():
    """
    A mass on an ideal amplifier overshoots as its damping ratio says, exp(-pi z / sqrt(1 - z^2)).

    Slow against the servo (20 rad/s at 2.25 kHz), so sampling adds about 1 % at most.
    """
    frequency, damping, mass, force, rate, c = 20.0, 0.3, 80.0, 110.0, 2250.0, 1e7
    amperes_per_bit = 40.0 / 32768
    proportional = frequency**2 * mass / force  # A/m
    derivative = 2 * damping * frequency * mass / force  # A s/m
    ixx30 = round(proportional * 2**19 / (96 * c * amperes_per_bit))
    ixx31 = round(derivative * rate * 2**26 / (ixx30 * 96 * c * amperes_per_bit))
    values = {**QUIET, 'Ixx30': ixx30, 'Ixx31': ixx31, 'amplifier_peak_current': 40.0}
    parameters = servo_parameters({'y_linear': values})
    state = servo.initial_state(parameters)
    counts, current = np.zeros(4, np.int64), np.zeros(3)
    commanded = np.array([2500.0, 0.0, 0.0])
    position = velocity = peak = 0.0
    for _ in range(1000):
        counts[0] = math.floor(position * c)
        servo.step(state, parameters, counts, commanded, current)
        acceleration = force * current[0] / mass
        position += velocity / rate + acceleration / (2 * rate**2)
        velocity += acceleration / rate
        peak = max(peak, position)
    expected = 2.5e-4 * (1 + math.exp(-math.pi * damping / math.sqrt(1 - damping**2)))
    assert peak == pytest.approx(expected, rel=0.01)


def test_motors_do_not_touch_each_other():
    random = np.random.default_rng(11)
    counts = np.cumsum(random.integers(-20, 20, (50, 4)), axis=0)
    commanded = np.cumsum(random.integers(-20, 20, (50, 3)), axis=0).astype(float)
    values = {axis: {**QUIET, 'Ixx31': 900, 'Ixx33': 4000} for axis in AXES}
    together, _ = run(values, counts, commanded)
    for place in range(3):
        alone = commanded.copy()
        alone[:, [other for other in range(3) if other != place]] = 1e6
        current, _ = run(values, counts, alone)
        assert (current[:, place] == together[:, place]).all()
