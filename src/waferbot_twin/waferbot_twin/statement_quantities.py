# SPDX-License-Identifier: Apache-2.0
"""
What the statements of the thesis about curves are measured by: one function per quantity.

Each takes the runs and what the statement is about (axis, models, signal, step), and returns a
`Measured`. Positions are in steps: 0 where the axis stood, 1 where the step commands it, for the
step down as for the step up. Currents are in A, positive in the direction of the step up.
`model` is what is spoken of, `reference` what it is compared with; ratios are model to reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_plant import verification
from waferbot_plant.modes import first_frequencies
from waferbot_plant.plant import load_machine
from waferbot_twin import curve_features as features
from waferbot_twin.metrics import performance_improvement, rms
from waferbot_twin.oscillation import BETWEEN_S, WINDOW_S
from waferbot_twin.response import AxisResponse
from waferbot_twin.step_runs import Runs
from waferbot_twin.thesis import thesis

STEPS = ('up', 'down')

VISIBLE = 0.01
"""Least wiggle that one sees in a figure, in steps: the width of its lines."""

SWING = 0.02
"""Least swing that is called oscillation, in steps."""

SETTLED = 0.05
"""The band that the thesis calls settled, in steps, or of the largest current."""

END_S = 0.05
"""The end of a hold, over which a remaining offset is taken."""

SLOW_HZ = 300.0
"""Ten times the bandwidth: what is faster makes no peak of a response."""

ABOVE_HZ = (50.0, 1125.0)
"""Where lines are looked for: above the loop's own motion, below half of the servo rate."""


@dataclass(frozen=True)
class Mark:
    """A point of a curve that a quantity was taken from: time from its step (s), value as drawn."""

    model: str
    step: str
    time: float
    value: float


@dataclass(frozen=True)
class Measured:
    """A value, its unit ('' for ratios and counts), and the points of the position that it is from."""

    value: float
    unit: str = ''
    marks: tuple[Mark, ...] = field(default=())


Curve = tuple[np.ndarray, np.ndarray]


def curve(response: AxisResponse, step: str, signal: str = 'position') -> Curve:
    """Return times from a step (s) and a signal behind it, up to the next: in steps, or in A."""
    first = response.step()
    if first is None:
        raise ValueError('the response has no step')
    jumps = np.flatnonzero(np.diff(response.commanded)) + 1
    starts = [*response.servo_time[jumps].tolist(), np.inf]
    place = STEPS.index(step)
    time, values = (
        (response.encoder_time, response.position)
        if signal == 'position'
        else (response.tick_time, response.current)
    )
    part = (time >= starts[place]) & (time < starts[place + 1])
    height = float(response.commanded[jumps[place]] - response.commanded[jumps[place] - 1])
    if signal == 'position':
        values = (values - response.commanded[jumps[place] - 1]) / height
    return time[part] - starts[place], values[part]


def of(runs: Runs, model: str, axis: str, step: str, signal: str = 'position') -> Curve:
    """Return the curve of a run: see `curve`."""
    return curve(runs[model, axis].response, step, signal)


def _together(one: Curve, other: Curve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times and both curves at the times of the first."""
    return one[0], one[1], np.interp(one[0], *other)


def _turns(position: Curve, least: float) -> list[tuple[float, float]]:
    """
    Return (time, value) where a position turns by `least` steps, without what is above 300 Hz.

    Vibration faster than ten times the bandwidth, which chapter 6 takes to be of minimal impact, would
    else make a peak of the response several.
    """
    time, values = position
    return features.turning_points(time, features.low_passed(time, values, SLOW_HZ), least)


def _peaks(position: Curve) -> list[tuple[float, float]]:
    """Return (time, value) of the maxima of a position that one sees, in their order."""
    turns = _turns(position, VISIBLE)
    return [turn for turn in turns if turn[1] >= _mean_around(turns, turn)]


def _mean_around(turns: Sequence[tuple[float, float]], turn: tuple[float, float]) -> float:
    """Return the mean of the neighbours of a turn (of the first: the start, at 0)."""
    place = turns.index(turn)
    around = [turns[place - 1][1] if place else 0.0]
    if place + 1 < len(turns):
        around.append(turns[place + 1][1])
    return float(np.mean(around))


# --- figures of a step (tables) ---------------------------------------------------------------------


def percent_from_measured(runs: Runs, axis: str, model: str, figures: Sequence[str]) -> Measured:
    """Return 100 (simulated - measured) / measured (4.1), of several the farthest from zero."""
    measured = runs.metrics('as_built', axis)
    simulated = runs.metrics(model, axis)
    percents = [
        100.0 * (getattr(simulated, name) / getattr(measured, name) - 1.0) for name in figures
    ]
    return Measured(max(percents, key=abs), '%')


def least_percent_from_measured(
    runs: Runs, axis: str, model: str, figures: Sequence[str]
) -> Measured:
    """Return the magnitude of the smallest of several differences (4.1)."""
    percents = [percent_from_measured(runs, axis, model, [name]).value for name in figures]
    return Measured(min(abs(percent) for percent in percents), '%')


def percent_change(runs: Runs, axis: str, model: str, reference: str, figure: str) -> Measured:
    """Return 100 (model - reference) / reference of a figure."""
    one, other = (getattr(runs.metrics(name, axis), figure) for name in (model, reference))
    return Measured(100.0 * (one / other - 1.0), '%')


def improvement(runs: Runs, axis: str, figure: str) -> Measured:
    """Return the performance improvement (6.1) from rigid to flexible, of a figure or `rms_error`."""
    if figure == 'rms_error':
        wrong = [runs.rms_error(model, axis) for model in ('rigid', 'flexible')]
    else:
        wrong = [
            abs(percent_from_measured(runs, axis, model, [figure]).value)
            for model in ('rigid', 'flexible')
        ]
    return Measured(performance_improvement(*wrong), '%')


def least_improvement(runs: Runs, axis: str) -> Measured:
    """Return the RMS gain (6.1) of an axis less the smallest of the other two."""
    gains = {name: improvement(runs, name, 'rms_error').value for name in AXES}
    return Measured(gains.pop(axis) - min(gains.values()), '%')


def rms_percent(runs: Runs, axis: str, model: str) -> Measured:
    """Return the RMS error (4.2) in percent of what the thesis divides it by: printed / percent."""
    entry = thesis()['steps'][axis]['rigid']['rms_error']
    amplitude = 100.0 * entry['printed'] / entry['percent_of_step']
    return Measured(100.0 * runs.rms_error(model, axis) / amplitude, '%')


# --- position ---------------------------------------------------------------------------------------


def peak_ratio(runs: Runs, axis: str, model: str, reference: str, step: str) -> Measured:
    """Return the highest position of one model over that of the other."""
    tops = []
    for name in (model, reference):
        time, values = of(runs, name, axis, step)
        place = int(np.argmax(values))
        tops.append(Mark(name, step, float(time[place]), float(values[place])))
    return Measured(tops[0].value / tops[1].value, '', tuple(tops))


def overshoot_down_to_up(runs: Runs, axis: str, model: str) -> Measured:
    """Return the overshoot of the step down over that of the step up."""
    marks = tuple(peak_ratio(runs, axis, model, model, step).marks[0] for step in STEPS)
    up, down = (mark.value - 1.0 for mark in marks)
    return Measured(down / up, '', marks)


def initial_peak(runs: Runs, axis: str, model: str, step: str) -> Measured:
    """Return the first maximum before the highest one, in steps; 0 if there is none."""
    peaks = _peaks(of(runs, model, axis, step))
    highest = max(peaks, key=lambda peak: peak[1], default=(0.0, 0.0))
    if not peaks or peaks[0][0] >= highest[0]:
        return Measured(0.0, 'steps')
    return Measured(peaks[0][1], 'steps', (Mark(model, step, *peaks[0]),))


def initial_peak_ratio(runs: Runs, axis: str, model: str, reference: str, step: str) -> Measured:
    """Return the initial peak of one model over that of the other; NaN without the latter."""
    one, other = (initial_peak(runs, axis, name, step) for name in (model, reference))
    ratio = one.value / other.value if other.value else float('nan')
    return Measured(ratio, '', one.marks + other.marks)


def crossings_to_peak(runs: Runs, axis: str, model: str, step: str) -> Measured:
    """Return how often the position crosses the command on its way to the highest peak."""
    time, values = of(runs, model, axis, step)
    slow = features.low_passed(time, values, SLOW_HZ)
    return Measured(float(features.crossings(slow[: int(np.argmax(slow)) + 1], 1.0)))


def _three_largest(runs: Runs, axis: str, model: str, step: str) -> list[Mark]:
    peaks = sorted(_peaks(of(runs, model, axis, step)), key=lambda peak: -peak[1])[:3]
    return [Mark(model, step, *peak) for peak in sorted(peaks)]


def order_of_highest(runs: Runs, axis: str, model: str, step: str) -> Measured:
    """Return which in time of the three largest maxima is the highest: 1, 2 or 3."""
    marks = _three_largest(runs, axis, model, step)
    heights = [mark.value for mark in marks]
    return Measured(float(np.argmax(heights) + 1), '', tuple(marks))


def peak_time_to_first_large(
    runs: Runs, axis: str, model: str, reference: str, step: str
) -> Measured:
    """Return the time of a model's highest peak over that of the first of the reference's largest."""
    peak = peak_ratio(runs, axis, model, model, step).marks[0]
    first = _three_largest(runs, axis, reference, step)[0]
    return Measured(peak.time / first.time, '', (peak, first))


def swings_after_peak(runs: Runs, axis: str, model: str, step: str) -> Measured:
    """Return how often the position turns behind its highest peak, by swings of `SWING` or more."""
    time, values = of(runs, model, axis, step)
    behind = slice(int(np.argmax(values)), None)
    turns = _turns((time[behind], values[behind]), SWING)
    return Measured(float(len(turns)), '', tuple(Mark(model, step, *turn) for turn in turns))


def more_swings(runs: Runs, axis: str, model: str, reference: str, step: str) -> Measured:
    """Return by how many more swings one model oscillates than the other."""
    one, other = (swings_after_peak(runs, axis, name, step) for name in (model, reference))
    return Measured(one.value - other.value, '', one.marks + other.marks)


def oscillation_time_ratio(
    runs: Runs, axis: str, model: str, reference: str, step: str
) -> Measured:
    """Return how long one model goes on swinging by more than the settling band over the other."""
    last = []
    for name in (model, reference):
        turns = _turns(of(runs, name, axis, step), SETTLED)
        last.append(Mark(name, step, *turns[-1]) if turns else Mark(name, step, 0.0, 0.0))
    ratio = last[0].time / last[1].time if last[1].time else float('nan')
    return Measured(ratio, '', tuple(last))


def end_offset(
    runs: Runs, axis: str, model: str, step: str, reference: str | None = None
) -> Measured:
    """
    Return the distance that is left in the last `END_S` of a hold, in steps.

    From the command; from what the reference has left there if one is given.
    """
    left = []
    for name in (model, reference):
        if name is not None:
            time, values = of(runs, name, axis, step)
            left.append(float(values[time >= time[-1] - END_S].mean()))
    return Measured(abs(left[0] - (left[1] if len(left) > 1 else 1.0)), 'steps')


# --- errors of the models ---------------------------------------------------------------------------


def _error(runs: Runs, model: str, axis: str, step: str) -> Curve:
    """Return simulated minus measured position behind a step, in steps."""
    time, simulated, measured = _together(
        of(runs, model, axis, step), of(runs, 'as_built', axis, step)
    )
    return time, simulated - measured


def first_error_peak_ratio(
    runs: Runs, axis: str, model: str, reference: str, step: str, sign: int
) -> Measured:
    """Return the first positive (or negative) peak of one model's error over that of the other."""
    peaks = []
    for name in (model, reference):
        time, error = _error(runs, name, axis, step)
        turns = _turns((time, sign * error), VISIBLE)
        peaks.append(next((value for _, value in turns if value > VISIBLE), float('nan')))
    return Measured(peaks[0] / peaks[1])


def error_after_overshoot_ratio(
    runs: Runs, axis: str, model: str, reference: str, step: str
) -> Measured:
    """Return the largest error behind the reference's overshoot, one model over the other."""
    peak = peak_ratio(runs, axis, reference, reference, step).marks[0]
    largest = []
    for name in (model, reference):
        time, error = _error(runs, name, axis, step)
        largest.append(float(np.abs(error[time > peak.time]).max()))
    return Measured(largest[0] / largest[1], '', (peak,))


def rms_error_ratio(runs: Runs, axis: str, model: str, reference: str, step: str) -> Measured:
    """Return the RMS of one model's error behind a step over that of the other."""
    one, other = (rms(_error(runs, name, axis, step)[1]) for name in (model, reference))
    return Measured(one / other)


def difference_of_errors(runs: Runs, axis: str, model: str, reference: str) -> Measured:
    """Return the RMS by which two models' errors differ over that of the reference's error."""
    return Measured(
        runs.rms_error(model, axis, reference) / runs.rms_error(reference, axis, 'as_built')
    )


def difference_of_curves(
    runs: Runs, axis: str, model: str, reference: str, step: str, signal: str
) -> Measured:
    """Return the RMS by which two curves differ over that of the reference about its mean."""
    _, one, other = _together(
        of(runs, model, axis, step, signal), of(runs, reference, axis, step, signal)
    )
    return Measured(rms(one - other) / rms(other - other.mean()))


def largest_difference(runs: Runs, axis: str, model: str, reference: str, step: str) -> Measured:
    """Return the largest distance of two positions, in steps."""
    _, one, other = _together(of(runs, model, axis, step), of(runs, reference, axis, step))
    return Measured(float(np.abs(one - other).max()), 'steps')


def lead(
    runs: Runs,
    axis: str,
    model: str,
    reference: str,
    step: str,
    signal: str,
    within_s: float = 0.2,
) -> Measured:
    """Return by how much one curve leads the other, by correlation of their first `within_s`."""
    time, one, other = _together(
        of(runs, model, axis, step, signal), of(runs, reference, axis, step, signal)
    )
    part = time < within_s
    return Measured(features.lead(time[part], one[part], other[part]), 's')


# --- oscillation ------------------------------------------------------------------------------------


def strongest_line(runs: Runs, axis: str, model: str, step: str, signal: str) -> Measured:
    """Return the frequency of the strongest line above 50 Hz; NaN without one."""
    time, values = of(runs, model, axis, step, signal)
    return Measured(features.strongest_line(time, values, ABOVE_HZ).frequency_hz, 'Hz')


def line_ratio(
    runs: Runs,
    axis: str,
    model: str,
    reference: str,
    step: str,
    signal: str,
    band_hz: Sequence[float],
) -> Measured:
    """Return the highest amplitude within a band of frequencies, one model over the other."""
    highest = []
    for name in (model, reference):
        frequency, amplitude = features.amplitude_spectrum(*of(runs, name, axis, step, signal))
        band = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
        highest.append(float(amplitude[band].max()))
    return Measured(highest[0] / highest[1])


def late_amplitude(
    runs: Runs, axis: str, model: str, step: str, signal: str, other_axis: str | None = None
) -> Measured:
    """
    Return half of peak to peak in the last 0.12 s of a hold, in steps, or of the measured peak current.

    Of `other_axis` (position) in its own unit, while `axis` is stepped.
    """
    if other_axis is not None:
        response = runs[model, axis].of(other_axis)
        end = response.encoder_time[-1]
        if step == 'up':
            end = runs[model, axis].response.servo_time[
                np.flatnonzero(np.diff(runs[model, axis].response.commanded))[1]
            ]
        part = (response.encoder_time > end - WINDOW_S) & (response.encoder_time <= end)
        return Measured(float(np.ptp(response.position[part]) / 2.0), response.unit)
    time, values = of(runs, model, axis, step, signal)
    amplitude = _amplitude_before(time, values, float(time[-1]))
    if signal == 'position':
        return Measured(amplitude, 'steps')
    measured = of(runs, 'as_built', axis, step, 'current')[1]
    return Measured(amplitude / float(np.abs(measured).max()))


def _amplitude_before(time: np.ndarray, values: np.ndarray, end: float) -> float:
    """Return half of peak to peak in the window that ends at a time."""
    return float(np.ptp(values[(time > end - WINDOW_S) & (time <= end)]) / 2.0)


def growth(runs: Runs, axis: str, model: str, step: str, signal: str) -> Measured:
    """Return the amplitude at the end of a hold over that `BETWEEN_S` before."""
    time, values = of(runs, model, axis, step, signal)
    end = float(time[-1])
    return Measured(
        _amplitude_before(time, values, end) / _amplitude_before(time, values, end - BETWEEN_S)
    )


def growth_between_holds(runs: Runs, axis: str, model: str, signal: str) -> Measured:
    """Return the amplitude at the end of the step down over that at the end of the step up."""
    up, down = (
        _amplitude_before(time, values, float(time[-1]))
        for time, values in (of(runs, model, axis, step, signal) for step in STEPS)
    )
    return Measured(down / up)


def final_amplitude_time(runs: Runs, axis: str, model: str, step: str, signal: str) -> Measured:
    """Return from when on an oscillation has 0.9 of the amplitude that it ends with, s."""
    return Measured(features.time_of_final_amplitude(*of(runs, model, axis, step, signal)), 's')


def final_amplitude_times(runs: Runs, axis: str, model: str, step: str) -> Measured:
    """Return that time of the current over that of the position."""
    current, position = (
        final_amplitude_time(runs, axis, model, step, signal).value
        for signal in ('current', 'position')
    )
    return Measured(current / position)


def late_frequency_ratio(
    runs: Runs, axis: str, model: str, other_axis: str, other_model: str
) -> Measured:
    """
    Return an axis' frequency at the end of its step down over that of another axis stepped alone.

    One where what grows on the first is the oscillation of the second. NaN for no oscillation.
    """
    found = []
    for name, place in ((model, axis), (other_model, other_axis)):
        time, values = of(runs, name, place, 'down')
        late = time > time[-1] - features.LINE_WINDOW_S
        mean = float(values[late].mean())
        line = features.strongest_line(time[late], values[late], (2.0, 1125.0), mean)
        found.append(line.frequency_hz)
    return Measured(found[0] / found[1])


# --- current ----------------------------------------------------------------------------------------


def swing_ratio(
    runs: Runs,
    axis: str,
    model: str,
    reference: str,
    step: str,
    signal: str,
    from_s: float,
    to_s: float,
) -> Measured:
    """Return a signal's peak to peak between two times from the step, one model over the other."""
    swings = []
    for name in (model, reference):
        time, values = of(runs, name, axis, step, signal)
        swings.append(float(np.ptp(values[(time >= from_s) & (time < to_s)])))
    return Measured(swings[0] / swings[1])


def peak_current_ratio(runs: Runs, axis: str, model: str, reference: str, step: str) -> Measured:
    """Return the largest magnitude of one model's current behind a step over that of the other."""
    one, other = (
        float(np.abs(of(runs, name, axis, step, 'current')[1]).max())
        for name in (model, reference)
    )
    return Measured(one / other)


def command_of_limit(runs: Runs, axis: str, model: str, limit_a: float) -> Measured:
    """Return the largest current command over what the controller can command."""
    return Measured(float(np.abs(runs[model, axis].response.current_command).max()) / limit_a)


def time_of_high_current(runs: Runs, axis: str, model: str, step: str, share: float) -> Measured:
    """Return for how long the current is above a share of its peak behind a step, s."""
    time, values = of(runs, model, axis, step, 'current')
    return Measured(features.time_above(time, values, share * float(np.abs(values).max())), 's')


def current_settling_ratio(
    runs: Runs, axis: str, model: str, reference: str, step: str
) -> Measured:
    """Return when the current last leaves 5 % of its peak around its end, one over the other."""
    last = []
    for name in (model, reference):
        time, values = of(runs, name, axis, step, 'current')
        away = values - values[time >= time[-1] - END_S].mean()
        outside = np.flatnonzero(np.abs(away) > SETTLED * np.abs(away).max())
        last.append(float(time[outside[-1]]))
    return Measured(last[0] / last[1])


# --- no step ----------------------------------------------------------------------------------------


def open_loop_difference(runs: Runs, axes: Sequence[str]) -> Measured:
    """Return by how much both plants' accelerations under 1 A differ, the largest of the axes."""
    differences = verification.open_loop_differences(load_machine('rigid'))
    return Measured(max(differences[axis] for axis in axes), '%')


def first_frequency(runs: Runs, element: str) -> Measured:
    """Return the first frequency of a flexible element (Table 6.7)."""
    return Measured(first_frequencies(load_machine('flexible').description)[element], 'Hz')


def elements_above(runs: Runs, frequency_hz: float, named: Sequence[str]) -> Measured:
    """Return how many elements have a first frequency above one; -1 if they are not those named."""
    frequencies = first_frequencies(load_machine('flexible').description)
    above = {name for name, value in frequencies.items() if value > frequency_hz}
    return Measured(float(len(above)) if above == set(named) else -1.0)


QUANTITIES: dict[str, Callable[..., Measured]] = {
    function.__name__: function
    for function in (
        percent_from_measured,
        least_percent_from_measured,
        percent_change,
        improvement,
        least_improvement,
        rms_percent,
        peak_ratio,
        overshoot_down_to_up,
        initial_peak,
        initial_peak_ratio,
        crossings_to_peak,
        order_of_highest,
        peak_time_to_first_large,
        more_swings,
        oscillation_time_ratio,
        end_offset,
        first_error_peak_ratio,
        error_after_overshoot_ratio,
        rms_error_ratio,
        difference_of_errors,
        difference_of_curves,
        largest_difference,
        lead,
        strongest_line,
        line_ratio,
        late_amplitude,
        growth,
        growth_between_holds,
        final_amplitude_time,
        final_amplitude_times,
        late_frequency_ratio,
        swing_ratio,
        peak_current_ratio,
        command_of_limit,
        time_of_high_current,
        current_settling_ratio,
        open_loop_difference,
        first_frequency,
        elements_above,
    )
}
"""By the name that `thesis_statements.yaml` gives them."""


def meaning(quantity: str) -> str:
    """Return the first line of a quantity's docstring, without its `Return`."""
    first = (QUANTITIES[quantity].__doc__ or '').strip().splitlines()[0]
    return first.removeprefix('Return ').rstrip('.')


def measure(quantity: str, runs: Runs, about: dict[str, Any]) -> Measured:
    """Return a quantity of the runs, of what the mapping names."""
    return QUANTITIES[quantity](runs, **about)
