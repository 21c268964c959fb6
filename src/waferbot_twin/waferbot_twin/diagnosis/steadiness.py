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
of freedom for each of its parameters in the logs that found it and in those that judge. What is next to
nothing beside what the cause itself gains does not count (`agreement` says why).

Assumption: m changes slowly against the memory of the blocks' observers, some milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.agreement import WithoutNoise, changes_without_noise, counts
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.estimation.stacked_least_squares import by_channel
from waferbot_twin.noise_model.prediction_error import fit
from waferbot_twin.residuals.noise_free_motion import Motion, motions
from waferbot_twin.residuals.problem import Cause, Channel, Problem
from waferbot_twin.residuals.record import Array

CHANCE = 1e-4
"""Probability that any of the causes seems unsteady if all are true."""

NEGLIGIBLE = 0.02
"""
Share of what a cause gains in 2 ln L up to which such a change does not speak against it.

Of 54 true frictions (as in `agreement`) 21 had left something that should be there by chance once in
50 000, 0.2 to 1.2 % of what they gained, in three cases 2.0, 2.5 and 4.2 %. Of 60 false ones in place of
another friction 52 had more than 2 %, mostly 4 to 140 %.
"""

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
    """
    A cause whose size seems to change `with_what`, and how probable that is if it does not.

    `gained` is what such a change gains in 2 ln L.
    """

    cause: Cause
    with_what: str
    chance: float
    gained: float

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
    blocks: list[_Block] = []
    for logs, hypothesis in ((problem, found.found), (judge, found.judged)):
        try:
            without_noise = changes_without_noise(logs, hypothesis)
        except UserError:
            without_noise = None
        if without_noise is None:
            return []
        blocks.extend(_blocks(logs, hypothesis, without_noise))
    result = []
    causes = found.found.causes
    for place, cause in enumerate(causes):
        asked = []
        for name in SLOW:
            each = [block.gained(place, cause.axis, name) for block in blocks]
            count = sum(number for _, number in each)
            if count:
                gained = sum(gain for gain, _ in each)
                asked.append(Unsteady(cause, name, float(chi2.sf(gained, count)), gained))
        if not asked:
            continue
        best = min(asked, key=lambda item: item.chance)
        significant = best.chance * len(SLOW) * len(causes) < CHANCE
        if significant and counts(best.gained, NEGLIGIBLE, cause, problem, judge, found):
            result.append(best)
    return result


@dataclass(frozen=True)
class _Block:
    """
    A block with noise in some logs: what is left over there, and what the causes change, by channel.

    `likelihood` is ln L with every cause as large everywhere; `moved` says what the axes do there.
    """

    channels: Sequence[Channel]
    left: Sequence[Array]
    changes: Sequence[Array]
    cause_of: NDArray[np.int64]
    moved: Mapping[tuple[int, str], Motion]
    likelihood: float

    def gained(self, place: int, axis: str, name: str) -> tuple[float, int]:
        """Return what is gained in 2 ln L if a cause may change with it, and by how many numbers."""
        mine = self.cause_of == place
        more = [
            np.hstack([own, own[:, mine] * self._weight(channel, axis, name)[:, None]])
            for channel, own in zip(self.channels, self.changes, strict=True)
        ]
        shows = np.any([np.any(one != 0.0, axis=0) for one in more], axis=0)
        new = int(np.count_nonzero(shows[len(mine) :]))
        if not new:
            return 0.0, 0
        free = fit(self.left, more, [channel.noise for channel in self.channels]).log_likelihood
        return max(2.0 * (free - self.likelihood), 0.0), new

    def _weight(self, channel: Channel, axis: str, name: str) -> Array:
        """Return what a cause may change with, at a channel's samples: without its mean, at most one."""
        there = self.moved[id(channel.log.record), axis]
        slow = SLOW[name](there)
        slow = slow - np.mean(slow)
        largest = float(np.max(np.abs(slow)))
        weight = slow / largest if largest > 0.0 else slow
        return np.interp(channel.log.times_s(channel.name), there.clock_s, weight)


def _blocks(
    problem: Problem, hypothesis: Hypothesis, without_noise: WithoutNoise
) -> Iterator[_Block]:
    """Give the blocks with noise that any cause changes."""
    axes = {cause.axis for cause in hypothesis.causes}
    moved = motions(problem, without_noise.ideal, axes)
    for block, matrix in without_noise.changes.items():
        if block in problem.exact_blocks:
            continue
        left, channels = hypothesis.residuals[block], problem.channels(block)
        changes = by_channel(matrix, left)
        steady = fit(left, changes, [channel.noise for channel in channels])
        yield _Block(channels, left, changes, without_noise.cause_of, moved, steady.log_likelihood)
