# SPDX-License-Identifier: Apache-2.0
"""
Is a cause as large everywhere? If not, it stands in for something else.

A cause that is nearly the truth explains nearly all: viscous friction what a cold ferrofluid does,
Coulomb friction what a friction does that grows with the load. What is left is too little to be seen
with nothing in mind, but it has the form of the cause itself, larger here and smaller there. So beside
what the parameters of all causes change in the noise-free log, s (`agreement.changes_without_noise`),
the residuals are regressed on m(t) s of each, with m the time, the position, the speed, the direction
or the current of its axis, one at a time, without its mean and at most one:

    r + a s + b m s = noise.

For a true cause b is zero, and twice the gain in ln L by b has a chi-squared distribution, with a degree
of freedom for each of its parameters in the logs that found it and in those that judge.

Assumption: m changes slowly against the memory of the blocks' observers, some milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.agreement import WithoutNoise, changes_without_noise
from waferbot_twin.diagnosis.hypothesis import Hypothesis
from waferbot_twin.diagnosis.jointly import by_channel
from waferbot_twin.diagnosis.noise_free_motion import Motion, motion
from waferbot_twin.diagnosis.problem import Cause, Problem
from waferbot_twin.diagnosis.record import Array
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.diagnosis.whitening import fit

CHANCE = 1e-4
"""Probability that any of the causes seems unsteady if all are true."""

SLOW: Mapping[str, Callable[[Motion], Array]] = {
    'time': lambda axis: axis.clock_s,
    'position': lambda axis: axis.position,
    'speed': lambda axis: np.abs(axis.speed),
    'direction': lambda axis: axis.direction,
    'current': lambda axis: axis.amplitude,
}
"""What the size of a cause may change with."""


@dataclass(frozen=True)
class Unsteady:
    """A cause whose size seems to change `with_what`, and how probable that is if it does not."""

    cause: Cause
    with_what: str
    chance: float

    def __str__(self) -> str:
        """Say so."""
        return (
            f'{self.cause.name} would explain more if its size changed with the {self.with_what} of its '
            f'axis (by chance {self.chance:.1g}): it may stand in for something else'
        )


def unsteady(problem: Problem, judge: Problem, found: Search) -> list[Unsteady]:
    """
    Return the causes that seem larger in one place than in another, each with what that shows best.

    None where a log does not have what was commanded, or the model's loop is unstable: then there
    is no noise-free log to ask.
    """
    both = []
    for logs, hypothesis in ((problem, found.found), (judge, found.judged)):
        try:
            without_noise = changes_without_noise(logs, hypothesis)
        except UserError:
            without_noise = None
        if without_noise is None:
            return []
        both.append((logs, hypothesis, without_noise))
    result = []
    causes = found.found.causes
    for place, cause in enumerate(causes):
        asked = []
        for name in SLOW:
            each = [_gained(*one, place, name) for one in both]
            count = sum(number for _, number in each)
            if count:
                gained = sum(gain for gain, _ in each)
                asked.append(Unsteady(cause, name, float(chi2.sf(gained, count))))
        if not asked:
            continue
        best = min(asked, key=lambda item: item.chance)
        if best.chance * len(SLOW) * len(causes) < CHANCE:
            result.append(best)
    return result


def _gained(
    problem: Problem, hypothesis: Hypothesis, without_noise: WithoutNoise, place: int, name: str
) -> tuple[float, int]:
    """Return what logs gain in 2 ln L if a cause may change with something, and by how many numbers."""
    mine = without_noise.cause_of == place
    gained, count = 0.0, 0
    for block, changes in without_noise.changes.items():
        if block in problem.exact_blocks:
            continue
        residuals = hypothesis.residuals[block]
        own = by_channel(changes, residuals)
        weights = _weights(problem, without_noise, block, hypothesis.causes[place].axis, name)
        more = [
            np.hstack([one, one[:, mine] * weight[:, None]])
            for one, weight in zip(own, weights, strict=True)
        ]
        shows = np.any([np.any(one != 0.0, axis=0) for one in more], axis=0)
        new = int(np.count_nonzero(shows[len(mine) :]))
        if not new:
            continue
        noises = problem.noises(block)
        steady, free = (
            fit(residuals, matrices, noises).log_likelihood for matrices in (own, more)
        )
        gained, count = gained + 2.0 * (free - steady), count + new
    return max(gained, 0.0), count


def _weights(
    problem: Problem, without_noise: WithoutNoise, block: str, axis: str, name: str
) -> Iterator[Array]:
    """Give for every channel of a block what the size of a cause may change with, at its samples."""
    ideal = {
        id(record): noise_free
        for record, noise_free in zip(problem.records, without_noise.ideal.records, strict=True)
    }
    for channel in problem.channels(block):
        there = motion(problem.nominal, ideal[id(channel.log.record)], axis)
        slow = SLOW[name](there)
        slow = slow - np.mean(slow)
        largest = float(np.max(np.abs(slow)))
        weight = slow / largest if largest > 0.0 else slow
        yield np.interp(channel.log.times_s(channel.name), there.clock_s, weight)
