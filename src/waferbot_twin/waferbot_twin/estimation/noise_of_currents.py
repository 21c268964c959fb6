# SPDX-License-Identifier: Apache-2.0
"""
How much of a measured current is noise: as much as the machine does not answer.

Taken for torque, noise does not add to what a model lacks; it turns it. The machine seems to answer
less than it does, and whatever makes a drive weaker (a worn gear, a large inertia) gains more than what
really lacks. So it is found before anything else is looked for. What is white in a current is taken
out of it in windows of any number of samples, by octaves (`residuals.drive_noise`), or is left in it,
whichever makes the readings likeliest beside the model of an axis that everybody fits first: inertia,
Coulomb and viscous friction and a constant force. It is left in where that gains less than one number
more costs (G. Schwarz, Annals of Statistics 6, 1978).

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
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.residuals.drive_noise import CurrentNoise, white_floors, without_noise
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Record

LEAST_SQUARES = ('coulomb_friction', 'viscous_friction', 'constant_force')
"""What a least-squares model of an axis has beside its inertia or mass and its force constant."""

WINDOWS = tuple(16 * 2**octave for octave in range(11))
"""Samples of a window."""

TIMES = tuple(2.0 ** (0.25 * step) for step in range(5))
"""How many times the noise is taken out."""

_Noise = Mapping[str, CurrentNoise]


def noise_of_currents(nominal: Variant, records: Sequence[Record], workers: int = 1) -> _Noise:
    """
    Return the noise in the measured current of each axis, if there is any.

    Nothing where the model does not run.
    """
    floors = white_floors(records)
    if not floors:
        return {}

    def problem_of(noise: _Noise) -> Problem:
        return Problem(nominal, [without_noise(record, noise) for record in records])

    def fitted(noise: _Noise, begun: Sequence[Cause]) -> Hypothesis:
        return fit_causes(problem_of(noise), tuple(begun), workers=workers)

    def likeliest(tried: Sequence[_Noise], found: Hypothesis) -> _Noise:
        return max(tried, key=lambda one: evaluate(problem_of(one), found.causes).log_likelihood)

    noise: _Noise = {
        axis: CurrentNoise(floor, WINDOWS[2], TIMES[1]) for axis, floor in floors.items()
    }
    try:
        first = _first(problem_of({}), floors)
        as_read, found = fitted({}, first), fitted(noise, first)
        while True:  # the likelihood rises each time
            tried = noise
            for axis, floor in floors.items():
                own = tried.get(axis, CurrentNoise(floor, WINDOWS[2]))
                others = {one: its for one, its in tried.items() if one != axis}
                windows = [{**others, axis: replace(own, samples=one)} for one in WINDOWS]
                tried = likeliest(windows, found)
                times = [{**others, axis: replace(tried[axis], times=one)} for one in TIMES]
                tried = likeliest([others, *times], found)
            again = found if tried == noise else fitted(tried, found.causes)
            if again.log_likelihood <= found.log_likelihood:
                break
            noise, found = tried, again
    except UserError:
        return {}
    return noise if gain(found, as_read) > 0.5 * math.log(found.samples) else {}


def without_noise_of_currents(
    nominal: Variant, records: Sequence[Record], of: Sequence[Record], workers: int = 1
) -> tuple[list[Record], list[str]]:
    """
    Return logs without the noise of their measured currents, and what to tell of it.

    As much as there is of it in some logs, or in parts `of` them.
    """
    noise = noise_of_currents(nominal, of, workers)
    told = [
        f'of the measured current of {nominal.titles[axis]} {one.ampere:.3g} A RMS are noise, which '
        'the axis does not answer: it is left out'
        for axis, one in noise.items()
    ]
    return [without_noise(record, noise) for record in records], told


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
