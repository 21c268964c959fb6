# SPDX-License-Identifier: Apache-2.0
"""
Which causes, and how sure: a sum of single effects.

The machine differs from its model by a sum of L effects,

    theta = theta_0 + w_1 + ... + w_L,    each w_l of one candidate gamma_l only,                     (1)

gamma_l drawn from the candidates, w_l from the prior of that candidate's size (G. Wang, A. Sarkar,
P. Carbonetto, M. Stephens, J. R. Stat. Soc. B 82, 2020: iterative Bayesian stepwise selection).
With the other effects in the model, the posterior of one of them is

    p(gamma_l = j) = pi_j BF_j / (1 + sum over k of pi_k BF_k),                                       (2)

and p(none) the rest. BF_j are Bayes factors of all logs (`estimation.evidence`), from fits through
the simulation for every candidate that the linear problem puts within reach. Effects are added as
long as one is so probable that a name is worth its risk (`settings`); then each is asked for anew
beside all others, as often as one changes: an early choice is revised when the others are known. A
candidate is a name (`effect:axis`) with the prior pi_j; of its trials the best stands for it.

What no physical cause explains competes with them: forces over speed and position of an axis
without a name (`discrepancy`).

In a closed loop noise moves the axis, the controller answers, and what noise made of the current
looks like a wrong amplifier. What the *command* makes of a cause in the noise-free log of the
model knows nothing of the noise: an instrument z of its change d (L. Ljung, System Identification,
2nd ed., section 13.4). If the two agree on the size, Hausman's test of endogeneity (Econometrica
46, 1978), the logs count as they are, else the instrument alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, logit
from scipy.stats import t as student

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.refit import refit, released, within_reach
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.screening import Screened, untempered
from waferbot_twin.estimation.evidence import gain, log_evidence, log_occam, spread_of
from waferbot_twin.estimation.gauss_newton import fit_causes, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, parameters_of
from waferbot_twin.noise_model.prediction_error import Colour, in_deviations
from waferbot_twin.noise_model.residual_spectrum import power_along
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array

ROUNDING = 0.01
"""Of a probability: fits end where a round gains some hundredths in ln L."""

PASSES = 2
"""How often at most every effect is asked for anew."""


@dataclass(frozen=True)
class Member:
    """A candidate for one effect, fitted beside the others: ln BF, ln of its prior odds, probability."""

    found: Hypothesis
    log_evidence: float
    log_prior: float
    probability: float = 0.0

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

    def credible_set(self, level: float) -> tuple[Member, ...]:
        """Return the fewest candidates that hold the effect with this probability, if there is one."""
        total, chosen = 0.0, []
        for member in self.members:
            chosen.append(member)
            total += member.probability
            if total >= level * self.inclusion:
                break
        return tuple(chosen)


@dataclass(frozen=True)
class Posterior:
    """All effects, and the hypothesis with the best of each in the same order; `nothing` without."""

    nothing: Hypothesis
    found: Hypothesis
    effects: tuple[SingleEffect, ...]
    tried: int

    def share(self, problem: Problem, place: int) -> float:
        """
        Return the share of what the nominal model leaves over that goes with one cause alone.

        Of the mean square on the cause's axis, in the block where that share is largest; 0 to 1.
        """
        cause = self.found.causes[place]
        others = (*self.found.causes[:place], *self.found.causes[place + 1 :])
        try:
            fewer = evaluate(problem, others)
        except UserError:  # the machine does not stand without it
            return 1.0
        shares = [0.0]
        for block in problem.touched(cause.effect, cause.axis):
            squares = [
                sum(
                    float(one @ one)
                    for channel, one in zip(
                        problem.channels(block), item.residuals[block], strict=True
                    )
                    if channel.axis == cause.axis
                )
                for item in (self.nothing, fewer, self.found)
            ]
            if squares[0] > 0.0:
                shares.append((squares[1] - squares[2]) / max(squares[:2]))
        return min(max(shares), 1.0)

    def fitted_to(self, problem: Problem) -> Posterior:
        """Return the posterior with the values of its causes fitted to another problem's logs."""
        found = _fitted(problem, self.found.causes) or self.found
        return replace(self, nothing=evaluate(problem), found=found)

    def without(self, problem: Problem, names: Sequence[str]) -> Posterior:
        """Return the posterior without some causes, the others fitted anew."""
        if not names:
            return self
        kept = [place for place, cause in enumerate(self.found.causes) if cause.name not in names]
        causes = tuple(self.found.causes[place] for place in kept)
        found = _fitted(problem, causes) or evaluate(problem, causes)
        return replace(self, found=found, effects=tuple(self.effects[place] for place in kept))


def infer(pool: CandidatePool) -> Posterior:
    """
    Return the posterior over causes of the logs of a pool.

    Raises `UserError` if the nominal model does not run in their motions.
    """
    nothing = evaluate(pool.problem)
    pool.begin(nothing)
    found, effects = _search(pool, nothing, [])
    return Posterior(nothing, found, tuple(effects), len(pool.names))


def infer_from_least_squares(pool: CandidatePool, first: Posterior) -> Posterior:
    """
    Return the more probable of a posterior and of what a search finds that begins with more.

    It begins with what everybody fits first, all together: masses and force constants, Coulomb and
    viscous friction and a constant force of every axis. Where most things are off, a search that adds
    one cause at a time goes wrong: whichever comes first takes what many others leave over, and they
    find nothing any more. Of these each stays that is evident beside all that is found.
    """
    causes = pool.usual()
    begun = _fitted(pool.problem, causes) if causes else None
    if begun is None:
        return first
    tentative = [
        SingleEffect(
            (Member(_with_last(pool.problem, begun, one.name), 0.0, pool.log_prior(one), 1.0),),
            0.0,
        )
        for one in causes
    ]
    found, effects = _search(pool, begun, tentative)
    if _odds_against(pool, found, first.found) <= 0.0:
        return first
    return replace(first, found=found, effects=tuple(effects))


def _search(
    pool: CandidatePool, found: Hypothesis, tentative: list[SingleEffect]
) -> tuple[Hypothesis, list[SingleEffect]]:
    """Add effects to some, and ask for all of them anew, until none is added, changed or feigned."""
    effects: list[SingleEffect] = []
    most = pool.settings.most_asked
    while True:
        found, effects, asked = _ask_on(pool, found, effects, tentative, most)
        most -= asked
        found, effects, asked = _ask_again(pool, found, effects, most)
        most -= asked
        feigned, judged = _instrumented(pool, found, effects)
        if feigned is None:
            return found, judged
        pool.leave_out(feigned)
        found, effects = _without(pool.problem, found, effects, feigned)
        tentative = []


def _odds_against(pool: CandidatePool, this: Hypothesis, other: Hypothesis) -> float:
    """Return ln of the posterior odds of a hypothesis with all its causes against another one."""
    occam = [
        sum(
            pool.log_prior(cause)
            + log_occam(
                cause,
                parameters_of(pool.problem, cause),
                spread_of(pool.problem, one, place),
                pool.settings.prior_scales,
            )
            for place, cause in enumerate(one.causes)
        )
        for one in (this, other)
    ]
    return gain(this, other) + occam[0] - occam[1]


def _ask_on(
    pool: CandidatePool,
    found: Hypothesis,
    effects: list[SingleEffect],
    begun: list[SingleEffect],
    most: int,
) -> tuple[Hypothesis, list[SingleEffect], int]:
    """
    Add effects as long as one is included; return how often was asked, too.

    Where many things lack, each is hidden by what the others leave over: along most directions there is
    so much that no single cause stands out of it. So what would be more probable than none if the power
    along it were known is in the model for the time being, too, as is what was `begun` with; it stays
    if it is evident beside all that was found by then.
    """
    asked, effects, tentative = 0, list(effects), list(begun)
    most_causes = pool.settings.most_causes + len(begun)
    while len(effects) + len(tentative) < most_causes and asked < most:
        effect = _ask(pool, found)
        asked += 1
        if effect is not None and _included(effect, pool.settings):
            best = effect.best
            effects.append(effect)
        elif effect is not None and (ahead := _ahead(pool.problem, found, effect)) is not None:
            best = ahead
            tentative.append(SingleEffect((ahead,), effect.none))
        else:
            break
        found = _fitted(pool.problem, best.found.causes) or best.found
    return *_evident(pool, found, effects, tentative), asked


def _ahead(problem: Problem, base: Hypothesis, effect: SingleEffect) -> Member | None:
    """Return the most probable member if the power of the noise along each were known; None for none."""

    def log_odds(member: Member) -> float:
        more = gain(member.found, base, power_known=True) - gain(member.found, base)
        return member.log_odds + more

    best = max(effect.members, key=log_odds)
    return best if log_odds(best) > 0.0 else None


def _evident(
    pool: CandidatePool,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    tentative: Sequence[SingleEffect],
) -> tuple[Hypothesis, list[SingleEffect]]:
    """
    Return a hypothesis without those tentative effects that are not evident beside all others.

    The one that the linear problem finds least evident goes first, and each is refitted without it.
    """
    problem, left, sure = pool.problem, list(tentative), list[SingleEffect]()
    while left:
        by_linear = [_linear_odds(pool, found, effect.best.cause.name) for effect in left]
        least = left.pop(int(np.argmin(by_linear)))
        name = least.best.cause.name
        base, _ = _without(problem, found, (), name)
        more = _with_last(problem, found, name)
        evidence = log_evidence(problem, more, base, pool.settings.prior_scales)
        odds = evidence + least.best.log_prior
        if odds > _log_odds(pool.settings.included_from):
            sure.append(_with_odds(least, odds))
        else:
            found = base
    return found, [*effects, *sure]


def _linear_odds(pool: CandidatePool, found: Hypothesis, name: str) -> float:
    """Return ln of the odds of one cause by Wald's statistic: by its value and the covariance alone."""
    place = next(place for place, cause in enumerate(found.causes) if cause.name == name)
    cause, own = found.causes[place], spread_of(pool.problem, found, place)
    parameters = parameters_of(pool.problem, cause)
    away = np.array([cause.values[item.name] - item.neutral for item in parameters])
    gained = 0.5 * float(away @ np.linalg.pinv(own) @ away)
    return (
        gained
        + log_occam(cause, parameters, own, pool.settings.prior_scales)
        + pool.log_prior(cause)
    )


def _with_odds(effect: SingleEffect, log_odds: float) -> SingleEffect:
    """Return an effect with other odds that it is there at all, and its members in proportion."""
    none = float(expit(-log_odds))
    total = sum(member.probability for member in effect.members)
    members = tuple(
        replace(member, probability=(1.0 - none) * (member.probability / total if total else 1.0))
        for member in effect.members
    )
    return SingleEffect(members, none)


def _included(effect: SingleEffect, settings: Settings) -> bool:
    """Return whether an effect is in the model; where no log tells, odds are even but for rounding."""
    return effect.inclusion > settings.included_from + ROUNDING


def _log_odds(probability: float) -> float:
    return float(logit(probability))


def _without(
    problem: Problem, found: Hypothesis, effects: Sequence[SingleEffect], name: str
) -> tuple[Hypothesis, list[SingleEffect]]:
    """Return a hypothesis and its effects without one cause, the others fitted anew."""
    others = tuple(cause for cause in found.causes if cause.name != name)
    rest = [effect for effect in effects if effect.best.cause.name != name]
    return _fitted(problem, others) or evaluate(problem, others), rest


def _instrumented(
    pool: CandidatePool, found: Hypothesis, effects: Sequence[SingleEffect]
) -> tuple[str | None, list[SingleEffect]]:
    """
    Return which cause the closed loop's noise has made most plainly, if any; and effects as judged now.

    Hausman's test presumes that nothing else lacks: what another cause leaves over goes with the
    command, too. So it is asked last, when no further cause is found. Where it speaks against the logs,
    the instrument's odds are those of the effect.
    """
    problem, settings = pool.problem, pool.settings
    judged: list[SingleEffect] = []
    worst, feigned = _log_odds(settings.included_from), None
    for effect in effects:
        cause = effect.best.cause
        base, _ = _without(problem, found, (), cause.name)
        more = _with_last(problem, found, cause.name)
        gained = instrumented_gain(problem, base, more, settings.endogeneity_level)
        if gained is None:
            judged.append(effect)
            continue
        evidence = log_evidence(problem, more, base, settings.prior_scales, gained)
        odds = evidence + pool.log_prior(more.causes[-1])
        judged.append(_with_odds(effect, odds))
        if odds < worst:
            worst, feigned = odds, cause.name
    return feigned, judged


def _with_last(problem: Problem, found: Hypothesis, name: str) -> Hypothesis:
    """Return the same hypothesis with one of its causes behind the others."""
    places = sorted(range(len(found.causes)), key=lambda place: found.causes[place].name == name)
    counts = [len(parameters_of(problem, cause)) for cause in found.causes]
    firsts = np.cumsum([0, *counts])
    order = [n for place in places for n in range(firsts[place], firsts[place + 1])]
    spread = found.covariance
    if len(spread) == len(order):
        spread = spread[np.ix_(order, order)]
    causes = tuple(found.causes[place] for place in places)
    return replace(found, causes=causes, covariance=spread)


def _ask_again(
    pool: CandidatePool, found: Hypothesis, effects: list[SingleEffect], most: int
) -> tuple[Hypothesis, list[SingleEffect], int]:
    """
    Ask for every effect anew beside all others until none changes, so many times at `most`.

    Return how often was asked, too.
    """
    left = most
    for _ in range(PASSES if len(effects) > 1 else 0):
        changed = False
        for effect in list(effects):
            name = effect.best.cause.name
            settled = len(effect.members) > 1 and not _bent(pool, found, name)
            if left <= 0 or settled:
                continue
            left -= 1
            present = _with_last(pool.problem, found, name)
            others = tuple(cause for cause in found.causes if cause.name != name)
            base = _fitted(pool.problem, others)
            again = _ask(pool, base, present) if base is not None else None
            if again is None:
                continue
            place = next(number for number, one in enumerate(effects) if one is effect)
            rest = [*effects[:place], *effects[place + 1 :]]
            if not _included(again, pool.settings):
                assert base is not None
                found, effects, changed = base, rest, True
                continue
            changed |= again.best.cause.name != name
            if again.best.found is not present:
                found = _fitted(pool.problem, again.best.found.causes) or again.best.found
            effects = [*rest[:place], again, *rest[place:]]
        if not changed:
            break
    by_name = {cause.name: place for place, cause in enumerate(found.causes)}
    effects.sort(key=lambda effect: by_name[effect.best.cause.name])
    return found, effects, most - left


def _bent(pool: CandidatePool, found: Hypothesis, name: str) -> bool:
    """Return whether the values of a cause depend on those of the others: so may its name."""
    own = np.array(
        [found.causes[place].name == name for place, _ in names_of(pool.problem, found.causes)]
    )
    if len(own) != len(found.covariance):
        return True
    deviations = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
    correlation = found.covariance / np.outer(deviations, deviations)
    most = float(np.max(np.abs(correlation[np.ix_(own, ~own)]), initial=0.0))
    return most > pool.settings.correlated_from


def _fitted(problem: Problem, causes: tuple[Cause, ...]) -> Hypothesis | None:
    """Return causes fitted; None if the machine does not stand with them alone."""
    try:
        return fit_causes(problem, causes)
    except UserError:
        return None


def _ask(
    pool: CandidatePool, base: Hypothesis, present: Hypothesis | None = None
) -> SingleEffect | None:
    """
    Return the posterior of one more effect beside those of `base`.

    `present` has as its last cause what is there now, fitted with the others: from `base`, whose causes
    have taken what they can of its work, a fit may not find back there. None if nothing could be fitted.
    """
    problem, settings = pool.problem, pool.settings
    screened = _promising(pool, pool.screen(base))
    if present is None and not screened:
        screened = _promising(pool, pool.damped_rings(base))
    if present is not None:
        screened = [item for item in screened if item.cause.name != present.causes[-1].name]
    chosen = within_reach(problem, screened, settings)
    known_causes = base.causes if present is None else present.causes
    there = {cause.name for cause in (*known_causes, *(item.cause for item in chosen))}
    chosen += [untempered(cause, 0.0) for cause in pool.dense if cause.name not in there]
    known = pool.signatures_of(base)
    fitted = refit(problem, base, chosen, known, pool.progress, pool.workers)
    fitted += [free for one in fitted if (free := released(problem, one)) is not None]
    fitted += [present] if present is not None else []
    fitted = [one for one in fitted if not _on_a_bound(problem, one.causes[-1])]
    members = [
        Member(
            one,
            log_evidence(problem, one, base, settings.prior_scales),
            pool.log_prior(one.causes[-1]),
        )
        for one in fitted
    ]
    return _posterior(problem, base, members, settings.prior_scales)


def _promising(pool: CandidatePool, screened: Sequence[Screened]) -> list[Screened]:
    """Return what the linear problem finds more probable than none in noise of known power."""
    return [item for item in screened if item.likelihood + pool.log_prior(item.cause) > 0.0]


def _on_a_bound(problem: Problem, cause: Cause) -> bool:
    """Return whether a size of a cause is as large as it can be: then it stands in for another one."""
    return any(
        cause.values[item.name] in (item.low, item.high)
        and cause.values[item.name] != item.neutral
        for item in parameters_of(problem, cause)
        if not item.shape and item.spread == 0.0
    )


def _posterior(
    problem: Problem,
    base: Hypothesis,
    members: Sequence[Member],
    scales: Sequence[float],
) -> SingleEffect | None:
    """
    Return equation (2) for fitted candidates.

    Which of them it is, is judged by what they do differently. Whether there is any, by that one which
    shows it most plainly: none is no more probable than beside any of them.
    """
    if not members:
        return None
    relative = _relative(problem, base, members, scales)
    fitted = sorted(members, key=lambda item: -relative[id(item)])
    ranked: dict[str, Member] = {}
    for one in fitted:
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


def _relative(
    problem: Problem, base: Hypothesis, members: Sequence[Member], scales: Sequence[float]
) -> dict[int, float]:
    """
    Return ln of the posterior odds of each member against the one that no other beats, by its id.

    Two candidates are compared along what they do differently, not along what both explain. Begun
    with the likeliest, the one that is ahead of it takes its place until none is.
    """
    own = [one.log_prior + _occam(problem, one, base, scales) for one in members]
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


def _occam(problem: Problem, member: Member, base: Hypothesis, scales: Sequence[float]) -> float:
    return log_evidence(problem, member.found, base, scales, 0.0)


def instrumented_gain(
    problem: Problem, base: Hypothesis, more: Hypothesis, level: float
) -> float | None:
    """
    Return what the last cause of `more` gains in ln L over `base` by what the command makes it do.

    With z its change in the noise-free log and d that in the logs, both white, and b what `base` leaves
    over, more than it leaves in a noise-free log of its own (where counts are taken for motion, that is
    not nothing), the instrument's estimate of the cause's size, 1 if the two agree, is z' b / z' d
    with the variance lambda z' z / (z' d)^2, lambda the power of the noise along z
    (`residual_spectrum.power_along`). None if they agree at the `level` of Hausman's test, or if the
    logs do not tell what was commanded; else the likelihood ratio of (z' b)^2 / z' z, nothing if z' b
    is negative, and what exact blocks gain.
    """
    try:
        ideal, own = problem.ideal(more.causes), problem.ideal(base.causes)
        if ideal is None or own is None:
            return None
        with_it, without = (apply_all(problem.nominal, item.causes) for item in (more, base))
        signals = estimated = 0.0
        left: list[Array] = []
        along: list[Array] = []
        colours: list[Colour] = []
        for block, fit in more.fits.items():
            if not any(colour.error.order for colour in fit.colours):
                continue
            pairs = zip(
                ideal.residuals(without, block), ideal.residuals(with_it, block), strict=True
            )
            changes = in_deviations(fit.colours, [one - two for one, two in pairs])
            before = in_deviations(fit.colours, base.residuals[block])
            measured = [one - two for one, two in zip(before, fit.whitened, strict=True)]
            feigned = in_deviations(fit.colours, own.residuals(without, block))
            before = [one - two for one, two in zip(before, feigned, strict=True)]
            signals += sum(float(z @ b) for z, b in zip(changes, before, strict=True))
            estimated += sum(float(z @ d) for z, d in zip(changes, measured, strict=True))
            left += fit.whitened
            along += changes
            colours += fit.colours
    except UserError:
        return None
    square = sum(float(z @ z) for z in along)
    if square == 0.0 or estimated == 0.0:
        return None
    power = power_along(left, along, colours)
    differs = abs(signals - estimated) / math.sqrt(power.value * square)
    if 2.0 * float(student.sf(differs, power.freedom)) >= level:
        return None
    caused = power.log_likelihood_ratio(signals**2 / square) if signals > 0.0 else 0.0
    return _exact_gain(more, base) + caused


def _exact_gain(more: Hypothesis, base: Hypothesis) -> float:
    """Return the gain in blocks that follow to the last bit: no noise goes through them."""
    return sum(
        0.5 * float(one @ one) - 0.5 * float(two @ two)
        for block, fit in more.fits.items()
        if not any(colour.error.order for colour in fit.colours)
        for one, two in zip(
            in_deviations(fit.colours, base.residuals[block]), fit.whitened, strict=True
        )
    )
