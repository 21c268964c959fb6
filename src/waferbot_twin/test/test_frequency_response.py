# SPDX-License-Identifier: Apache-2.0
"""Frequency responses against systems whose response is known by an equation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, freqz, lfilter, ss2tf

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_plant.assembly import home_mass_matrix_and_weight
from waferbot_pmac import trajectories
from waferbot_twin.effects.places import coordinate, force_per_ampere
from waferbot_twin.effects.variant import Variant
from waferbot_twin.frequency_response.channels import (
    Channel,
    moving_axis,
    parse_channel,
    run_of,
    unit_of,
)
from waferbot_twin.frequency_response.compare import Comparison
from waferbot_twin.frequency_response.estimate import (
    FrequencyResponse,
    Run,
    estimate,
    period_of,
)
from waferbot_twin.frequency_response.linear_plant import position_over_force
from waferbot_twin.frequency_response.peaks import (
    ANTIRESONANCE,
    EXTRA,
    MATCHED,
    MISSING,
    NOT_JUDGED,
    RESONANCE,
    find_peaks,
    match,
)
from waferbot_twin.frequency_response.report import sentence
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model

SEED = 20261121
STEP_S = 1.0 / 2250.0

# A sampled first-order plant y[n] = POLE y[n-1] + GAIN u[n-1] + noise, under u = CONTROLLER (r - y).
POLE, GAIN, CONTROLLER = 0.8, 0.5, 0.6


def plant_at(frequency_hz):
    delay = np.exp(-2j * np.pi * frequency_hz * STEP_S)
    return GAIN * delay / (1.0 - POLE * delay)


def closed_loop(random, reference, noise):
    """Return a run of the loop with coloured noise of a size on what the plant gives."""
    disturbance = noise * lfilter([1.0], [1.0, -0.9], random.normal(size=len(reference)))
    driven = lfilter([0.0, GAIN * CONTROLLER], [1.0, GAIN * CONTROLLER - POLE], reference)
    shaken = lfilter([1.0, -POLE], [1.0, GAIN * CONTROLLER - POLE], disturbance)
    output = driven + shaken
    return Run(STEP_S, CONTROLLER * (reference - output), output, reference)


def open_loop(random, size):
    signal = random.normal(size=size)
    noise = 0.3 * lfilter([1.0], [1.0, -0.9], random.normal(size=size))
    return Run(STEP_S, signal, lfilter([0.0, GAIN], [1.0, -POLE], signal) + noise)


def two_masses(first, second, stiffness, damping):
    """Return acceleration of the first of two masses over the force on it, in continuous time."""
    rates = np.array(
        [
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [-stiffness / first, stiffness / first, -damping / first, damping / first],
            [stiffness / second, -stiffness / second, damping / second, -damping / second],
        ]
    )
    return rates, np.array([[0], [0], [1 / first], [0]]), rates[2:3], np.array([[1 / first]])


def exact(frequency_hz, value):
    """Return a response without any noise."""
    none = np.zeros(len(frequency_hz))
    step_hz = float(frequency_hz[1] - frequency_hz[0])
    return FrequencyResponse(
        frequency_hz, value.astype(complex), 1e-9 + none, 1.0 + none, None, 9, step_hz,
        'direct', 'tapers',
    )  # fmt: skip


def two_mass_response(frequency_hz, resonance_hz, damping_ratio=0.01):
    first, second = 3.0, 2.0
    reduced = first * second / (first + second)
    omega = 2 * np.pi * resonance_hz
    rates, entry, reading, through = two_masses(
        first, second, omega**2 * reduced, 2 * damping_ratio * omega * reduced
    )
    s = 2j * np.pi * frequency_hz[:, None, None]
    inside = np.linalg.solve(s * np.eye(4) - rates, np.broadcast_to(entry, (len(s), 4, 1)))
    return (reading @ inside + through)[:, 0, 0]


def test_the_circle_of_the_direct_estimate_holds_the_truth_as_often_as_it_says():
    random = np.random.default_rng(SEED)
    inside = []
    for _ in range(60):
        response = estimate([open_loop(random, 4500)], resolution_hz=5.0)
        assert response.method == 'direct'
        lines = slice(5, None, 30)  # lines closer than the resolution go together
        error = np.abs(response.value - plant_at(response.frequency_hz))[lines]
        inside += (error < response.radius()[lines]).tolist()
    assert len(inside) > 3000
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


def test_in_closed_loop_the_direct_estimate_is_wrong_and_the_indirect_one_is_not():
    """Noise that is as large as what is commanded pulls H1 towards -1 / controller, by its share."""
    random = np.random.default_rng(SEED)
    runs = [closed_loop(random, random.normal(size=9000), 0.7) for _ in range(20)]
    indirect = estimate(runs, resolution_hz=4.0)
    direct = estimate([Run(run.step_s, run.input, run.output) for run in runs], 4.0)
    assert (indirect.method, direct.method) == ('indirect', 'direct')
    truth = plant_at(direct.frequency_hz)
    noise_power = (
        0.7**2 / np.abs(1 - 0.9 * np.exp(-2j * np.pi * direct.frequency_hz * STEP_S)) ** 2
    )
    biased = (truth - noise_power / CONTROLLER) / (1.0 + noise_power)
    lines = slice(5, None, 20)
    wrong = np.abs(direct.value - truth)[lines] > 2.0 * direct.radius()[lines]
    assert wrong.mean() > 0.9
    expected = np.abs(direct.value - biased)[lines] < direct.radius()[lines]
    assert expected.mean() == pytest.approx(0.95, abs=0.05)
    held = np.abs(indirect.value - truth)[lines] < indirect.radius()[lines]
    assert held.sum() > 100
    assert held.mean() == pytest.approx(0.95, abs=0.05)


def test_a_swept_sine_in_the_loop_gives_the_plant():
    random = np.random.default_rng(SEED)
    times = trajectories.cycle_times(5.0, 1.0 / STEP_S)
    sweep = trajectories.swept_sine(times, 0.1, 4.9, 1.0, 1.0, 300.0, fade_s=0.2)
    response = estimate([closed_loop(random, sweep, 0.002)], highest_hz=250.0)
    truth = plant_at(response.frequency_hz)
    assert response.reliable.all()
    assert np.abs(response.value / truth - 1.0).max() < 0.05
    held = np.abs(response.value - truth) < response.radius()
    assert held.mean() > 0.85


@pytest.mark.parametrize('realisations', [1, 4])
def test_periods_of_a_multisine_give_the_plant_at_its_lines_and_nowhere_else(realisations):
    random = np.random.default_rng(SEED)
    times = trajectories.cycle_times(7.0, 1.0 / STEP_S)
    held = []
    for _ in range(10):
        runs = [
            closed_loop(
                random,
                trajectories.multisine(times, 0.3, 1.0, 1.0, 5.0, 300.0, fade_s=0.2, seed=seed),
                0.01,
            )
            for seed in range(realisations)
        ]
        response = estimate(runs)
        assert response.looks == ('realisations' if realisations > 1 else 'periods')
        assert response.degrees == (realisations - 1 if realisations > 1 else 4)
        assert response.frequency_hz == pytest.approx(np.arange(5.0, 301.0))
        held += (
            np.abs(response.value - plant_at(response.frequency_hz)) < response.radius()
        ).tolist()
    assert np.mean(held) == pytest.approx(0.95, abs=0.02)


def test_realisations_tell_distortion_from_noise():
    """A cubic bends the response differently for every choice of phases, period after period alike."""
    random = np.random.default_rng(SEED)
    times = trajectories.cycle_times(5.0, 1.0 / STEP_S)
    runs = []
    for seed in range(8):
        signal = trajectories.multisine(times, 0.0, 1.0, 1.0, 5.0, 300.0, seed=seed)
        noise = 1e-4 * random.normal(size=len(signal))
        runs.append(Run(STEP_S, signal, signal + 0.5 * signal**3 + noise, signal))
    response = estimate(runs)
    single = estimate(runs[:1])
    assert np.median(response.noise) < 0.1 * np.median(response.deviation)
    # The mean of eight scatters by the deviation; one alone by its root of eight times as much.
    scatter = np.sqrt(np.mean(np.abs(single.value - response.value) ** 2))
    assert scatter == pytest.approx(
        np.sqrt(7.0) * np.sqrt(np.mean(response.deviation**2)), rel=0.2
    )


@settings(max_examples=50, deadline=None)
@example(81, 3, 60, 1, 7170237)
@given(
    st.integers(20, 200), st.integers(3, 6), st.integers(0, 60), st.integers(0, 60),
    st.integers(0, 2**31),
)  # fmt: skip
def test_the_period_is_found_between_whatever_comes_before_and_after(
    length, count, before, after, seed
):
    random = np.random.default_rng(seed)
    wave = random.normal(size=length)
    # Far from the wave, or it would go on by chance.
    around = [20.0 + random.normal(size=size) for size in (before, after)]
    signal = np.concatenate([around[0], np.tile(wave, count), around[1]])
    late = slice(len(signal) // 2, 3 * len(signal) // 4)
    found = period_of(signal)
    if late.start - length < before or late.stop > before + count * length:
        return  # the part that is looked at is not all periodic
    assert found == (length, slice(before, before + count * length))


def test_no_period_in_what_does_not_repeat():
    random = np.random.default_rng(SEED)
    times = trajectories.cycle_times(5.0, 1.0 / STEP_S)
    assert period_of(random.normal(size=1000)) is None
    assert period_of(np.zeros(1000)) is None
    assert period_of(trajectories.swept_sine(times, 0.1, 4.9, 1.0, 1.0, 300.0, fade_s=0.2)) is None


def test_a_run_that_is_too_short_is_told():
    run = open_loop(np.random.default_rng(SEED), 450)
    with pytest.raises(UserError, match=r'0\.2 s cannot resolve 2 Hz.*--resolution between 15'):
        estimate([run], resolution_hz=2.0)
    with pytest.raises(UserError, match='different rates'):
        estimate([run, Run(2 * STEP_S, run.input, run.output)])


@pytest.mark.parametrize('damping_ratio', [0.005, 0.02, 0.05])
def test_peaks_of_two_masses_have_the_frequencies_and_dampings_of_the_equation(damping_ratio):
    frequency = np.arange(20.0, 200.0, 0.1)
    peaks = find_peaks(exact(frequency, two_mass_response(frequency, 75.0, damping_ratio)))
    assert [peak.kind for peak in peaks] == [ANTIRESONANCE, RESONANCE]
    # With the first mass held the second one has k / m2 and d / m2; the sum 1 / m1 + 1 / m2 of the
    # resonance is 5 / 3 of that.
    ratio = np.sqrt(3.0 / 5.0)
    for peak, frequency_hz, damping in zip(
        peaks, (75.0 * ratio, 75.0), (damping_ratio * ratio, damping_ratio), strict=True
    ):
        assert peak.frequency_hz == pytest.approx(frequency_hz, rel=1e-3)
        assert peak.damping == pytest.approx(damping, rel=0.03)
        assert not peak.bounded


def test_a_resonance_out_of_a_noisy_loop_is_found_and_nothing_else_is():
    """Two masses sampled with a held force; twelve noises, no peak more than the two that are there."""
    sampled = cont2discrete(two_masses(3.0, 2.0, 2.66e5, 11.0), STEP_S)[:4]
    # The acceleration does not know of the free motion: its two poles at 1 are taken out.
    numerator, denominator = ss2tf(*sampled)
    numerator, denominator = (
        np.polydiv(np.polydiv(one, [1, -1])[0], [1, -1])[0] for one in (numerator[0], denominator)
    )
    for seed in range(12):
        random = np.random.default_rng(SEED + seed)
        force = random.normal(size=18000)
        motion = lfilter(numerator, denominator, force)
        noisy = motion + 0.02 * random.normal(size=len(force))
        response = estimate([Run(STEP_S, force, noisy)], resolution_hz=2.0, highest_hz=500.0)
        peaks = find_peaks(response)
        assert [peak.kind for peak in peaks] == [ANTIRESONANCE, RESONANCE], seed
        omega = 2 * np.pi * response.frequency_hz * STEP_S
        truth = freqz(numerator, denominator, omega)[1]
        top = response.frequency_hz[np.argmax(np.abs(truth))]
        assert abs(peaks[1].frequency_hz - top) < response.resolution_hz


def test_peaks_are_matched_missing_or_extra():
    frequency = np.arange(20.0, 200.0, 0.1)
    measured = exact(frequency, two_mass_response(frequency, 75.0))
    shifted = exact(frequency, two_mass_response(frequency, 78.0))
    rigid = exact(frequency, np.full(len(frequency), 0.2))
    pairs = match(measured, shifted)
    assert [pair.verdict for pair in pairs] == [MATCHED, MATCHED]
    assert [pair.shift_percent for pair in pairs] == pytest.approx([4.0, 4.0], abs=0.1)
    assert [pair.verdict for pair in match(measured, rigid)] == [MISSING, MISSING]
    assert [pair.verdict for pair in match(rigid, measured)] == [EXTRA, EXTRA]
    far = exact(frequency, two_mass_response(frequency, 150.0))
    assert sorted(pair.verdict for pair in match(measured, far)) == [EXTRA] * 2 + [MISSING] * 2


def test_where_the_model_is_not_known_nothing_is_missing():
    frequency = np.arange(20.0, 200.0, 0.1)
    measured = exact(frequency, two_mass_response(frequency, 75.0))
    lost = exact(frequency, np.full(len(frequency), 0.2))
    lost.deviation[:] = 1.0
    assert {pair.verdict for pair in match(measured, lost)} == {NOT_JUDGED}
    assert {pair.verdict for pair in match(measured, None)} == {NOT_JUDGED}


def test_the_sentence_claims_no_more_than_was_judged():
    frequency = np.arange(20.0, 200.0, 0.1)
    measured = exact(frequency, two_mass_response(frequency, 75.0))
    rigid = exact(frequency, np.full(len(frequency), 0.2))
    lost = exact(frequency, np.full(len(frequency), 0.2))
    lost.deviation[:] = 1.0

    def said(one, other):
        channels = (Channel('x_rotate', 'force'), Channel('x_rotate', 'acceleration'))
        pairs = tuple(match(one, other))
        return sentence(Comparison((), channels, '', 'mine', one, other, None, pairs, (), {}))

    assert said(measured, rigid) == 'Model mine lacks the resonance at 75 Hz.'
    assert (
        said(rigid, measured) == 'Model mine has, other than the machine, the resonance at 75 Hz.'
    )
    assert said(measured, measured).startswith('Model mine has the resonances that were measured')
    nothing = 'No resonance stands out where measurement and model are reliable.'
    assert said(rigid, rigid) == said(measured, lost) == nothing
    assert said(measured, None) == 'There is no simulation to compare with.'


def log_of(**signals):
    return MeasuredLog(
        'bench',
        tuple(
            Signal(kind, 'x_rotate', unit, time_s, value)
            for kind, (unit, time_s, value) in signals.items()
        ),
    )


@pytest.fixture(scope='module')
def rigid():
    return Variant.of(load_model('rigid'))


@pytest.mark.parametrize(
    ('kind', 'power'), [('acceleration', 2), ('velocity', 1), ('position', 0)]
)
def test_a_double_integrator_is_one_over_its_inertia_by_whatever_is_derived(kind, power):
    """Position by the exact sum of sines of a torque without noise, J = 0.25 kg m2."""
    times = trajectories.cycle_times(6.0, 1.0 / STEP_S)
    lines = np.arange(3.0, 200.0)
    phases = np.random.default_rng(SEED).uniform(0.0, 2 * np.pi, len(lines))
    arguments = 2 * np.pi * lines[:, None] * times + phases[:, None]
    torque = np.sin(arguments).sum(axis=0)
    position = (-np.sin(arguments) / (0.25 * (2 * np.pi * lines[:, None]) ** 2)).sum(axis=0)
    log = log_of(
        force=('Nm', times, torque),
        position=('rad', times, position),
        commanded_position=('rad', times, torque),
    )
    channels = (Channel('x_rotate', 'force'), Channel('x_rotate', kind))
    run = run_of(log, channels, None)
    raw = estimate([run])
    factor = channels[1].factor(raw.frequency_hz, run.step_s)
    response = raw.times(factor / channels[0].factor(raw.frequency_hz, run.step_s))
    expected = 4.0 * (2j * np.pi * response.frequency_hz) ** (power - 2)
    assert len(response.value) == len(lines)
    assert np.abs(response.value / expected - 1.0).max() < 1e-6


def test_force_is_current_by_the_force_constant_of_the_model(rigid):
    times = trajectories.cycle_times(1.0, 1.0 / STEP_S)
    wave = np.sin(40.0 * times)
    log = log_of(current=('A', times, wave), position=('rad', times, wave))
    channels = (Channel('x_rotate', 'force'), Channel('x_rotate', 'acceleration'))
    run = run_of(log, channels, rigid)
    assert run.reference is None
    assert run.input == pytest.approx(force_per_ampere(rigid, 'x_rotate') * wave[1:-1])
    assert unit_of(channels, rigid) == '(rad/s2)/(Nm)'
    with pytest.raises(UserError, match='no current of x_rotate'):
        run_of(log_of(position=('rad', times, wave)), channels, rigid)


def test_a_gap_is_not_bridged():
    times = trajectories.cycle_times(2.0, 1.0 / STEP_S)
    there = (times < 0.5) | (times > 0.6)
    wave = np.sin(40.0 * times)
    log = log_of(force=('Nm', times, wave), position=('rad', times[there], wave[there]))
    run = run_of(log, (Channel('x_rotate', 'force'), Channel('x_rotate', 'position')), None)
    assert len(run.input) == np.count_nonzero(times > 0.6) - 2


def test_channels_are_named_by_kind_or_axis_and_kind():
    assert parse_channel('position', 'x_rotate', AXES) == Channel('x_rotate', 'position')
    assert parse_channel('y_linear.acceleration', 'x_rotate', AXES) == Channel(
        'y_linear', 'acceleration'
    )
    with pytest.raises(UserError, match="no signal 'positon'; did you mean 'position'"):
        parse_channel('positon', 'x_rotate', AXES)
    with pytest.raises(UserError, match="no axis 'z'"):
        parse_channel('z.position', 'x_rotate', AXES)


def test_the_axis_is_the_one_that_was_commanded():
    times = trajectories.cycle_times(1.0, 1.0 / STEP_S)
    still = MeasuredLog('still', ())
    moved = log_of(commanded_position=('rad', times, np.sin(times)))
    assert moving_axis([still, moved]) == 'x_rotate'
    with pytest.raises(UserError, match=r'give --axis.*none'):
        moving_axis([still])


@pytest.mark.parametrize('axis', ['y_linear', 'x_rotate', 'y_rotate'])
def test_the_linear_plant_of_the_rigid_machine_is_its_inertia(rigid, axis):
    """Far above the swing under gravity; the other axes are free and give way, so (M^-1)_ii counts."""
    frequency = np.array([300.0])
    moved = position_over_force(rigid, (axis, axis), frequency)
    assembly = rigid.rigid
    mass, _ = home_mass_matrix_and_weight(
        list(assembly.links),
        assembly.placing,
        len(assembly.coordinates),
        rigid.description.gravity,
    )
    mass = mass + np.diag(assembly.rotor_inertia)
    row, ratio = assembly.placing[coordinate(rigid, axis)]
    expected = ratio**2 * np.linalg.inv(mass)[row, row]
    assert -moved * (2 * np.pi * frequency) ** 2 == pytest.approx(expected, rel=1e-3)
