# SPDX-License-Identifier: Apache-2.0
"""
What makes a fitted cause credible: logs with another motion, and what the command made it do.

In a closed loop noise moves the axis, the controller answers, and currents and noise go together. So a
cause has to show in what the *command* caused, too (`closed_loop_record`), and in logs in which nothing
was fitted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.together import NEARLY, far_channels, pays
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    parameters_of,
    signature,
    whole_change,
)
from waferbot_twin.estimation.stacked_least_squares import by_channel, fit_jointly
from waferbot_twin.residuals.problem import CURRENT_LOOP, PLANT, WINDINGS, Cause, Problem

TELLS = 15.0
"""Gain in 2 ln L that a log must be able to show for it to judge a cause."""

STANDARD_DEVIATIONS = 2.5
"""How far from what it should gain a true cause may be in logs that hardly show it."""

CONFIRMS, SHARE = 8.0, 0.1
"""
Gain in 2 ln L that a cause must have in logs kept for judging, where nothing is fitted: at least the
first, and this share of what it should have. Half of the first will do if all logs together gain `TELLS`
more than they have to: of a true cause that should gain 16 there, one in six gains less than 8.
"""

CAUSED, PLAINLY = 0.6, 4.0
"""
A cause gains too little by what the command makes it do if it gains less than this share of what it
should, and that by more than so many standard deviations.
"""


LITTLE = 0.4
"""Share of a motion, in RMS, that a cause leaves if it explains most of it: a sixth of its power."""

CURRENTS = (WINDINGS, CURRENT_LOOP)
"""The blocks whose output is measured currents, with the noise of sensors that a loop follows."""


@dataclass(frozen=True)
class Fitted:
    """
    A hypothesis fitted to the logs for finding, and as it stands in those for judging.

    `confirmed`: it pays for itself and is to be believed. `possible`: nothing speaks against it, but by
    itself it would not be believed; what is believed in its place may be this. `feigned`: noise in the
    current loop made it.
    """

    found: Hypothesis
    judged: Hypothesis
    confirmed: bool = False
    possible: bool = False
    feigned: bool = False

    @property
    def log_likelihood(self) -> float:
        """The sum over both kinds of logs."""
        return self.found.log_likelihood + self.judged.log_likelihood

    @property
    def information_criterion(self) -> float:
        """Schwarz' criterion with both kinds of logs."""
        return self.found.information_criterion - 2.0 * self.judged.log_likelihood


def weighed(
    finding: Problem, judging: Problem, base: Fitted, item: Fitted, needed: float
) -> Fitted:
    """
    Return a hypothesis with whether it is to be believed beside `base`, that without its new causes.

    It has to gain `needed` in 2 ln L, or nearly so much and as much again in the logs for judging, and
    these must not speak against it. What the command causes has to pay for the hypothesis in all logs
    together: a motion may be so slow that noise decides when an axis slides. One that nearly pays so is
    possible.
    """
    gained = 2.0 * (item.found.log_likelihood - base.found.log_likelihood)
    confirmed = 2.0 * (item.judged.log_likelihood - base.judged.log_likelihood)
    if not pays(gained, confirmed, needed):
        return item
    try:
        in_finding = caused_by_command(finding, base.found, item.found)
        in_judging = caused_by_command(judging, base.judged, item.judged)
    except UserError:
        return item
    if _too_little(in_finding, in_judging):
        return replace(item, feigned=True)
    together = in_finding.gain + in_judging.gain
    possible = together >= NEARLY * needed and confirmed > _least(in_judging.expected)
    if in_judging.expected < TELLS:
        # That motion does not show the effect: what was found must be beyond doubt by itself, and
        # what little it should do there must not speak against it.
        believed = in_finding.gain >= needed + TELLS and confirmed > _least(in_judging.expected)
    else:
        least = CONFIRMS if together < needed + TELLS else 0.5 * CONFIRMS
        believed = (
            together >= needed
            and in_judging.gain >= least
            and confirmed >= max(least, SHARE * in_judging.expected)
        )
    return replace(item, confirmed=believed, possible=possible)


def feigned(finding: Problem, judging: Problem, base: Fitted, item: Fitted) -> bool:
    """
    Return whether noise in the current loop made the last cause of a hypothesis.

    `base` is the same without it. Raises `UserError` if the model's loop is unstable.
    """
    return _too_little(
        caused_by_command(finding, base.found, item.found),
        caused_by_command(judging, base.judged, item.judged),
    )


def _too_little(*logs: ByCommand) -> bool:
    """
    Return whether a cause gains plainly less than it should in what measures currents.

    The root of the gain of a true one is normally distributed about that of what it should be, with a
    standard deviation of one. The gain of a sensor that a fit took from noise in the current loop is
    much larger than what the command shows of it. In the plant friction is far from linear, and a
    tangent says little of what it should gain.
    """
    gain = max(sum(item.gain_in_currents for item in logs), 0.0)
    expected = max(sum(item.expected_in_currents for item in logs), 0.0)
    return gain < CAUSED * expected and math.sqrt(expected) - math.sqrt(gain) > PLAINLY


def _least(expected: float) -> float:
    """
    Return the least that a true cause gains in 2 ln L where it should gain this much.

    It is normally distributed about that, with a standard deviation of twice its root.
    """
    spread = 2.0 * math.sqrt(max(expected, 1.0))
    return max(-TELLS, expected - STANDARD_DEVIATIONS * spread)


def _beyond_noise(base: Hypothesis, more: Hypothesis) -> bool:
    """
    Return whether one cause alone leaves but a little of a motion that is too large for noise.

    Beside others it may stand in for what else lacks.
    """
    if base.causes:
        return False
    channels = zip(
        far_channels(base),
        base.residuals.get(PLANT, []),
        more.residuals.get(PLANT, []),
        strict=True,
    )
    return any(
        is_far and float(np.mean(after**2)) < LITTLE**2 * float(np.mean(before**2))
        for is_far, before, after in channels
    )


def _is_one_number_in_currents(problem: Problem, cause: Cause) -> bool:
    """Return whether a cause has one free parameter, and changes what measures currents."""
    shown = set(problem.touched(cause.effect, cause.axis))
    return cause.free == 1 and not shown.isdisjoint(CURRENTS)


@dataclass(frozen=True)
class ByCommand:
    """
    What a cause gains in 2 ln L by what the command makes it do, and what it should gain.

    Of it the part in blocks whose output is measured currents.
    """

    gain: float
    expected: float
    gain_in_currents: float = 0.0
    expected_in_currents: float = 0.0


def caused_by_command(problem: Problem, base: Hypothesis, more: Hypothesis) -> ByCommand:
    """
    Ask whether the last cause of `more` shows in what the *command* made it do, not only in noise.

    Its signature is taken from the noise-free log of `more` and fitted to the residuals of `base` in the
    logs of `problem`: slopes, or the change as a whole where that is one number in measured currents. An
    encoder that is late by several readings does not do several times what one reading does. What it
    should gain is found by adding it, as large as in `more`, to what that fit leaves over: noise with a
    large effect in it has another colour and variance, and the logarithm of its likelihood falls much
    less than by the square of the effect.

    Blocks whose output follows from their input to the last bit need no such protection, whatever
    moved them: what they gain counts as it is. So does what makes the machine ring: it is the noise in
    the currents that shakes it, too, and what a loop makes of noise has no line. So does what readings
    say themselves: the steps of a coarse encoder fall elsewhere in a log without noise, and a motor on
    the other flank of its gear's play, but no noise parts the encoders of motor and load. And so does
    what takes away most of what is too large for noise: where a machine swings, its model does, too,
    but not in step.

    Both hypotheses are those of the logs of `problem`. Logs that do not say what was commanded stand for
    it themselves, with their noise: then this asks no more than whether the cause shows.
    """
    cause = more.causes[-1]
    parameters = parameters_of(problem, cause)
    rings = any(item.name in cause.narrow and not item.shape for item in parameters)
    between = cause.effect.drive_train and problem.sees_both_ends(cause.axis)
    if rings or cause.effect.evident or between or _beyond_noise(base, more):
        gained = 2.0 * (more.log_likelihood - base.log_likelihood)
        return ByCommand(gained, gained)
    ideal = problem.ideal(more.causes) or problem
    if cause.effect.threshold or _is_one_number_in_currents(problem, cause):
        own = whole_change(ideal, evaluate(ideal, more.causes[:-1]), more.causes)
        change = np.ones(1)
    else:
        there = evaluate(ideal, more.causes)
        own = signature(ideal, there, more.causes, len(more.causes) - 1)
        change = np.array(
            [0.0 if item.shape else cause.values[item.name] - item.neutral for item in parameters]
        )
    exact = [block for block in problem.exact_blocks if block in base.fits]
    sure = sum(
        2.0 * (more.fits[block].log_likelihood - base.fits[block].log_likelihood)
        for block in exact
    )
    shown = {block: matrix for block, matrix in own.items() if block not in exact and matrix.any()}
    if not shown:
        return ByCommand(sure, sure)
    estimate = fit_jointly(problem, base.residuals, shown, known=base.fits)
    noise, with_cause = {}, {}
    for block, matrix in shown.items():
        channels = base.residuals[block]
        fitted = by_channel(matrix @ estimate.value, channels)
        noise[block] = [left + part for left, part in zip(channels, fitted, strict=True)]
        moved = by_channel(matrix @ change, channels)
        with_cause[block] = [left - part for left, part in zip(noise[block], moved, strict=True)]
    quiet, caused = problem.judge(noise), problem.judge(with_cause)

    def gains(blocks: list[str]) -> tuple[float, float]:
        there, before, with_it = (
            sum((fits[block].log_likelihood for block in blocks), 0.0)
            for fits in (quiet, base.fits, caused)
        )
        return 2.0 * (there - before), 2.0 * (there - with_it)

    gain, should = gains(list(shown))
    return ByCommand(
        gain + sure, should + sure, *gains([block for block in shown if block in CURRENTS])
    )
