# SPDX-License-Identifier: Apache-2.0
"""
How much of a measured current is noise: as much as the machine does not answer.

Taken for torque, noise does not add to what a model lacks; it turns it. The machine seems to answer
less than it does, and whatever makes a drive weaker (a worn gear, a large inertia) gains more than what
really lacks. So it is found before anything else is looked for. What is white in a current is taken
out of it in windows of any number of samples, by octaves (`residuals.drive_noise`), or is left in it,
whichever makes the readings likeliest beside the model of an axis that everybody fits first: inertia,
Coulomb and viscous friction and a constant force, fitted anew each time. With values from other noise
those windows look best that leave as much of it as these were fitted to. It is left in where that gains
less than one number more costs (G. Schwarz, Annals of Statistics 6, 1978).

Limit: where the load hangs on a spring, the readings may not show what the motor answers, and what
moves it there is taken for noise. All logs have the same noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects import find
from waferbot_twin.effects.effect import Effect
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.drive_noise import CurrentNoise, white_floors, without_noise
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.windows import Windows

LEAST_SQUARES = ('coulomb_friction', 'viscous_friction', 'constant_force')
"""What a least-squares model of an axis has beside its inertia or mass and its force constant."""

WINDOWS = tuple(16 * 2**octave for octave in range(11))
"""Samples of a window."""

TIMES = (math.sqrt(2.0), 1.0, 2.0)
"""How many times the noise is taken out; the first while windows are compared."""

_Noise = Mapping[str, CurrentNoise]
_Found = tuple[_Noise, Hypothesis]


def noise_of_currents(nominal: Variant, logs: Sequence[Windows], workers: int = 1) -> _Noise:
    """
    Return the noise in the measured current of each axis, if there is any.

    By the readings in the windows of the logs; the current is that of a whole log without its noise, so
    that the shortest window of a log is no limit for those of a spectrum. Nothing where the model does
    not run.
    """
    floors = white_floors([one.record for one in logs])
    if not floors:
        return {}

    def problem_of(noise: _Noise) -> Problem:
        return Problem(nominal, [part for one in logs for part in _quiet(one, noise).records])

    def fitted(noise: _Noise, begun: Sequence[Cause]) -> Hypothesis:
        return fit_causes(problem_of(noise), tuple(begun), workers=workers)

    def likeliest(axis: str, tried: Sequence[CurrentNoise], best: _Found) -> _Found:
        for own in tried:
            noise = {**best[0], axis: own}
            one = noise, fitted(noise, best[1].causes)
            best = max(best, one, key=lambda item: item[1].log_likelihood)
        return best

    try:
        as_read = fitted({}, _first(problem_of({}), floors))
        best: _Found = {}, as_read
        for axis, floor in floors.items():
            every = [CurrentNoise(floor, samples, TIMES[0]) for samples in WINDOWS]
            best = likeliest(axis, every, best)
            if axis in best[0]:
                own = best[0][axis]
                best = likeliest(axis, [replace(own, times=one) for one in TIMES[1:]], best)
    except UserError:
        return {}
    noise, found = best
    return noise if gain(found, as_read) > 0.5 * math.log(found.samples) else {}


def without_noise_of_currents(
    nominal: Variant, logs: Sequence[Windows], of: Sequence[Windows], workers: int = 1
) -> tuple[list[Windows], list[str]]:
    """Return logs without the noise of their measured currents, and what to tell: that `of` some."""
    noise = noise_of_currents(nominal, of, workers)
    told = [
        f'of the measured current of {nominal.titles[axis]} {one.ampere:.3g} A RMS are noise, which '
        'the axis does not answer: it is left out'
        for axis, one in noise.items()
    ]
    return [_quiet(one, noise) for one in logs], told


def _quiet(log: Windows, noise: _Noise) -> Windows:
    return replace(log, record=without_noise(log.record, noise))


def _first(problem: Problem, axes: Sequence[str] | Mapping[str, float]) -> list[Cause]:
    """Return what everybody fits first on some axes, with nothing of it."""
    return [
        _none_of(problem, effect, axis)
        for effect in map(find, ('wrong_inertia', *LEAST_SQUARES))
        for axis in effect.axes(problem.nominal)
        if axis in axes and problem.touched(effect, axis)
    ]


def _none_of(problem: Problem, effect: Effect, axis: str) -> Cause:
    parameters = effect.parameters(problem.nominal, axis)
    return Cause(effect, axis, {item.name: item.neutral for item in parameters})
