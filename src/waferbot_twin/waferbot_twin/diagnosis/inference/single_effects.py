# SPDX-License-Identifier: Apache-2.0
"""
Which causes, and how sure: a sum of single effects.

The machine differs from its model by a sum of L effects,

    theta = theta_0 + w_1 + ... + w_L,    each w_l of one candidate gamma_l only,                     (1)

gamma_l drawn from the candidates, w_l from the prior of that candidate's size (G. Wang, A. Sarkar,
P. Carbonetto, M. Stephens, J. R. Stat. Soc. B 82, 2020: iterative Bayesian stepwise selection).
With the other effects in the model, the posterior of one of them is

    p(gamma_l = j) = pi_j BF_j / (1 + sum over k of pi_k BF_k),                                       (2)

and p(none) the rest. BF_j are Bayes factors of all logs (`estimation.evidence`). A candidate is a name
(`effect:axis`) with the prior pi_j; of its trials the best stands for it. How effects are found is in
`search`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.nuisance import each_once
from waferbot_twin.diagnosis.inference.refit import to_the_end
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.residuals.problem import Cause, Problem


@dataclass(frozen=True)
class Member:
    """
    A candidate for one effect, fitted beside the others: ln BF, ln of its prior odds, probability.

    `gained` is what counts as its gain in ln BF (`evidence.evidence_of`), if that is not all it gains.
    """

    found: Hypothesis
    log_evidence: float
    log_prior: float
    probability: float = 0.0
    gained: float | None = None

    @property
    def cause(self) -> Cause:
        """The candidate itself."""
        return self.found.causes[-1]

    @property
    def log_odds(self) -> float:
        """Ln of its posterior odds against none."""
        return self.log_prior + self.log_evidence


@dataclass(frozen=True)
class SingleEffect:
    """One effect of the sum: candidates, the most probable first, and the probability of none."""

    members: tuple[Member, ...]
    none: float

    @property
    def best(self) -> Member:
        """The most probable candidate."""
        return self.members[0]

    @property
    def inclusion(self) -> float:
        """The probability that there is such an effect at all."""
        return 1.0 - self.none

    @property
    def log_odds(self) -> float:
        """Ln of the odds that there is such an effect at all; infinite where none is impossible."""
        if not self.none:
            return math.inf
        return math.log(self.inclusion / self.none) if self.inclusion else -math.inf

    def as_judged(self, log_odds: float) -> SingleEffect:
        """Return the effect with ln BF of its best member by the odds of that beside all others."""
        best = replace(self.best, log_evidence=log_odds - self.best.log_prior)
        return replace(self, members=(best, *self.members[1:]))

    def credible_set(self, level: float) -> tuple[Member, ...]:
        """Return the fewest candidates that hold the effect with this probability, if there is one."""
        total, chosen = 0.0, []
        for member in self.members:
            chosen.append(member)
            total += member.probability
            if total >= level * self.inclusion:
                break
        return tuple(chosen)


Follows = Mapping[tuple[str, str], float]
"""Of a channel, by block and name, the share of what is left over that goes with the command."""


def squares_of(problem: Problem, found: Hypothesis, block: str, axis: str) -> float:
    """Return the sum of squares that a hypothesis leaves over in the channels of a block on an axis."""
    return sum(
        float(left @ left)
        for channel, left in zip(problem.channels(block), found.residuals[block], strict=True)
        if channel.axis == axis
    )


@dataclass(frozen=True)
class Posterior:
    """
    All effects, and the hypothesis with the best of each in the same order; `nothing` without.

    `models` are others that the logs leave open (`model_average`).
    """

    nothing: Hypothesis
    found: Hypothesis
    effects: tuple[SingleEffect, ...]
    tried: int
    models: tuple[Hypothesis, ...] = ()

    def share(self, problem: Problem, place: int, follows: Follows | None = None) -> float:
        """
        Return the share of what the nominal model gets wrong that goes with one cause alone, 0 to 1.

        Of the mean square on the cause's axis, beyond noise, in the block where that share is largest:

            (s_without - s) / (max(s_nominal, s_without) - n),        n = sum over channels of (1 - f) s,

        s what all causes leave over, f the part of a channel of it that `follows` the command: the rest
        is noise, but in blocks that follow to the last bit.
        """
        cause = self.found.causes[place]
        others = (*self.found.causes[:place], *self.found.causes[place + 1 :])
        try:
            fewer = evaluate(problem, others)
        except UserError:  # the machine does not stand without it
            return 1.0
        shares = [0.0]
        for block in problem.touched(cause.effect, cause.axis):
            nominal, without, left = (
                squares_of(problem, item, block, cause.axis)
                for item in (self.nothing, fewer, self.found)
            )
            error = max(nominal, without) - self.noise(problem, block, cause.axis, follows)
            if error > 0.0:
                shares.append((without - left) / error)
        return min(max(shares), 1.0)

    def noise(
        self, problem: Problem, block: str, axis: str, follows: Follows | None = None
    ) -> float:
        """Return the sum of squares of noise in the channels of a block on an axis; see `share`."""
        return sum(
            (1.0 - (follows or {}).get((block, channel.name), 0.0)) * float(left @ left)
            for channel, left in zip(
                problem.channels(block), self.found.residuals[block], strict=True
            )
            if channel.axis == axis and channel.noise.order
        )

    def without(self, problem: Problem, causes: Sequence[Cause], workers: int = 1) -> Posterior:
        """Return the posterior without some causes, the others fitted anew."""
        if not causes:
            return self
        names = {cause.name for cause in causes}
        kept = [place for place, cause in enumerate(self.found.causes) if cause.name not in names]
        others = tuple(self.found.causes[place] for place in kept)
        found = to_the_end(problem, evaluate(problem, each_once(problem, others)), workers)
        return replace(self, found=found, effects=tuple(self.effects[place] for place in kept))


def with_odds(effect: SingleEffect, log_odds: float) -> SingleEffect:
    """Return an effect with other odds that it is there at all, and its members in proportion."""
    none = float(expit(-log_odds))
    total = sum(member.probability for member in effect.members)
    members = tuple(
        replace(member, probability=(1.0 - none) * (member.probability / total if total else 1.0))
        for member in effect.members
    )
    return SingleEffect(members, none)


def posterior_of(base: Hypothesis, members: Sequence[Member]) -> SingleEffect | None:
    """
    Return equation (2) for fitted candidates.

    Which of them it is, is judged by what they do differently. Whether there is any, by that one which
    shows it most plainly: none is no more probable than beside any of them.
    """
    if not members:
        return None
    relative = _relative(base, members)
    by_odds = sorted(members, key=lambda item: -relative[id(item)])
    ranked: dict[str, Member] = {}
    for one in by_odds:
        ranked.setdefault(one.cause.name, one)
    members = list(ranked.values())
    best = members[0]
    behind = np.array([relative[id(one)] - relative[id(best)] for one in members])
    logs = max(one.log_odds for one in members) + behind
    weights = np.exp(logs - max(float(logs.max()), 0.0))
    none = math.exp(-max(float(logs.max()), 0.0))
    total = float(weights.sum()) + none
    found = [
        replace(member, probability=float(weight / total))
        for member, weight in zip(members, weights, strict=True)
    ]
    found.sort(key=lambda item: -item.probability)
    return SingleEffect(tuple(found), none / total)


def _relative(base: Hypothesis, members: Sequence[Member]) -> dict[int, float]:
    """
    Return ln of the posterior odds of each member against the one that no other beats, by its id.

    Two candidates are compared along what they do differently, not along what both explain. Begun
    with the likeliest, the one that is ahead of it takes its place until none is. Whole machines are:
    what the springs do that a cause needs is as much a part of it there as those of a compliance.
    """
    own = [
        one.log_odds - (gain(one.found, base) if one.gained is None else one.gained)
        for one in members
    ]
    place = max(range(len(members)), key=lambda number: members[number].found.log_likelihood)
    seen: set[int] = set()
    while True:
        seen.add(place)
        ahead = [
            odds - own[place] - gain(members[place].found, one.found)
            for odds, one in zip(own, members, strict=True)
        ]
        best = int(np.argmax(ahead))
        if best in seen:
            return {id(one): value for one, value in zip(members, ahead, strict=True)}
        place = best
