# SPDX-License-Identifier: Apache-2.0
"""Command delay and feedback filter: shifted records, SciPy's filter, kills, neutral values."""

import math

import numpy as np
import pytest
import scipy.signal

from waferbot_lockstep.errors import UserError
from waferbot_pmac import servo
from waferbot_pmac.i_variables import change_parameter, servo_parameters

GAINS = {
    'Ixx30': 2000, 'Ixx31': 1280, 'Ixx32': 900, 'Ixx33': 5000, 'Ixx34': 0, 'Ixx69': 32767,
    'Ixx11': 0, 'Ixx12': 0, 'Ixx29': 120,
}  # fmt: skip


def run(settings, counts, commanded=None):
    """Run y_linear from standstill; return currents (n,), and outputs of the servo (n,)."""
    parameters = servo_parameters({'y_linear': {**GAINS, **settings}})
    state = servo.initial_state(parameters)
    all_counts = np.zeros((len(counts), 4), np.int64)
    all_counts[:, 0] = counts
    target = np.zeros((len(counts), 3))
    if commanded is not None:
        target[:, 0] = commanded
    servo.prime(state, parameters, all_counts[0], target[0])
    current = np.zeros(3)
    currents, outputs = [], []
    for n in range(len(counts)):
        servo.step(state, parameters, all_counts[n], target[n], current)
        currents.append(current[0])
        outputs.append(state[0]['output'][0])
    return np.array(currents), np.array(outputs)


def wandering(number=300, seed=6):
    print('seed', seed)
    return np.cumsum(np.random.default_rng(seed).integers(-20, 21, number))


@pytest.mark.parametrize('delay', [1, 3, 8])
def test_delay_is_the_command_some_cycles_late(delay):
    """The first result stands in for what came before; the servo itself is not changed."""
    counts = wandering()
    plain, results = run({}, counts)
    late, results_of_late = run({'command_delay': delay}, counts)
    assert np.array_equal(results_of_late, results)
    assert np.array_equal(late[delay:], plain[:-delay])
    assert np.array_equal(late[:delay], np.full(delay, plain[0]))
    assert plain[0] != 0.0


def test_delay_with_extended_servo_cycles_is_in_interrupts():
    """Ixx60 = 3: a new result every fourth interrupt, each three interrupts late."""
    counts = wandering()
    plain, _ = run({'Ixx60': 3}, counts)
    late, _ = run({'Ixx60': 3, 'command_delay': 3}, counts)
    assert np.array_equal(late[3:], plain[:-3])


def test_a_killed_motor_is_off_at_once_and_starts_afresh():
    """Nothing of the old command comes out after a kill, nor after the loop is closed again."""
    settings = {'y_linear': {**GAINS, 'command_delay': 5, 'Ixx11': 16 * 1000}}
    parameters = servo_parameters(settings)
    state = servo.initial_state(parameters)
    counts, target, current = np.zeros(4, np.int64), np.zeros(3), np.zeros(3)
    servo.prime(state, parameters, counts, target)
    for _ in range(10):
        servo.step(state, parameters, counts, target, current)
    assert current[0] != 0.0
    counts[0] = 5000
    servo.step(state, parameters, counts, target, current)
    assert current[0] == 0.0
    counts[0] = 0
    servo.prime(state, parameters, counts, np.zeros(3))
    servo.step(state, parameters, counts, target, current)
    assert current[0] == pytest.approx(120.0 * 40.0 / 32768.0)


@pytest.mark.parametrize('tau', [0.5, 3.0, 40.0])
def test_filter_is_first_order(tau):
    """Following error against SciPy's filter, to the 1/32 count that the table keeps."""
    counts = wandering()
    parameters = servo_parameters({'y_linear': {**GAINS, 'feedback_filter': tau}})
    state = servo.initial_state(parameters)
    all_counts = np.zeros(4, np.int64)
    all_counts[0] = counts[0]
    servo.prime(state, parameters, all_counts, np.zeros(3))
    seen = []
    for count in counts:
        all_counts[0] = count
        servo.step(state, parameters, all_counts, np.zeros(3), np.zeros(3))
        seen.append(-state[0]['following_error'][0])
    share = 1.0 / (1.0 + tau)
    expected, _ = scipy.signal.lfilter(
        [share], [1.0, share - 1.0], counts.astype(float), zi=[(1.0 - share) * counts[0]]
    )
    assert np.abs(np.array(seen) - expected).max() <= 1.0 / 64.0 + 1e-9
    assert np.abs(expected - counts).max() > 5.0


def test_filter_lags_by_its_time_constant_at_constant_speed():
    """A ramp of 7 counts per interrupt is seen 7 tau counts late."""
    counts = 7 * np.arange(2000)
    parameters = servo_parameters({'y_linear': {**GAINS, 'feedback_filter': 12.0}})
    state = servo.initial_state(parameters)
    all_counts = np.zeros(4, np.int64)
    servo.prime(state, parameters, all_counts, np.zeros(3))
    for count in counts:
        all_counts[0] = count
        servo.step(state, parameters, all_counts, np.zeros(3), np.zeros(3))
    assert -state[0]['following_error'][0] == pytest.approx(counts[-1] - 84.0, abs=1 / 64 + 1e-6)


def test_filter_is_on_the_velocity_encoder_too():
    """Y-Rotate damps by the motor's encoder: a jump there dies away by the filter's ratio."""
    settings = {
        'y_rotate': {**GAINS, 'Ixx33': 0, 'Ixx29': 0, 'Ixx31': 4096, 'feedback_filter': 3.0}
    }
    parameters = servo_parameters(settings)
    state = servo.initial_state(parameters)
    counts, current = np.zeros(4, np.int64), np.zeros(3)
    servo.prime(state, parameters, counts, np.zeros(3))
    counts[3] = 4096
    pushes = []
    for _ in range(6):
        servo.step(state, parameters, counts, np.zeros(3), current)
        pushes.append(current[2])
    ratios = np.array(pushes[1:]) / pushes[:-1]
    assert pushes[0] < 0.0
    assert ratios == pytest.approx([0.75] * 5, rel=1e-3)


def test_filter_runs_at_every_interrupt_of_an_extended_cycle():
    """The conversion table is worked through at every servo interrupt, whatever Ixx60 is."""
    parameters = servo_parameters({'y_linear': {**GAINS, 'feedback_filter': 1.0, 'Ixx60': 3}})
    state = servo.initial_state(parameters)
    counts = np.zeros(4, np.int64)
    servo.prime(state, parameters, counts, np.zeros(3))
    servo.step(state, parameters, counts, np.zeros(3), np.zeros(3))
    counts[0] = 1024
    for _ in range(4):
        servo.step(state, parameters, counts, np.zeros(3), np.zeros(3))
    assert -state[0]['following_error'][0] == 1024 * (1 - 0.5**4)


def test_neutral_values_are_no_effect_at_all():
    """The same bits as without."""
    counts = wandering()
    commanded = np.linspace(0.0, 500.0, len(counts))
    plain, _ = run({}, counts, commanded)
    neutral, _ = run({'feedback_filter': 0.0, 'command_delay': 0}, counts, commanded)
    assert np.array_equal(plain, neutral)


def test_a_small_filter_changes_little():
    """Continuous about zero: half the time constant, half the change, to the 1/32 count."""
    counts = 100 * wandering()
    plain, _ = run({}, counts)
    changes = [
        np.linalg.norm(run({'feedback_filter': tau}, counts)[0] - plain) for tau in (0.02, 0.01)
    ]
    assert changes[0] / changes[1] == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize(
    ('name', 'value', 'words'),
    [
        ('command_delay', 9, ['command_delay', '0 to 8']),
        ('command_delay', 1.5, ['command_delay', 'whole']),
        ('feedback_filter', -1.0, ['feedback_filter', '0 to 10000']),
        ('feedback_filter', math.nan, ['feedback_filter']),
    ],
)
def test_wrong_values_are_explained(name, value, words):
    """The error names axis, setting and range."""
    with pytest.raises(UserError) as caught:
        servo_parameters({'y_linear': {name: value}}, 'model.yaml')
    for word in ('model.yaml', 'y_linear', *words):
        assert word in str(caught.value)


def test_they_cannot_change_while_the_loop_is_closed():
    """Their memory would not fit."""
    parameters = servo_parameters({})
    for name, value in (('command_delay', 2), ('feedback_filter', 1.5)):
        with pytest.raises(UserError, match='closed'):
            change_parameter(parameters, 'y_linear', name, value, loop_closed=True)
        change_parameter(parameters, 'y_linear', name, value, loop_closed=False)
        assert parameters[name][0, 0] == value
