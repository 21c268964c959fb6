# SPDX-License-Identifier: Apache-2.0
"""Odds of a probability, and of one set of causes against another."""

from __future__ import annotations

from scipy.special import logit

from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool, Judged
from waferbot_twin.estimation.evidence import gain, information_of, log_occam
from waferbot_twin.estimation.hypothesis import Hypothesis, parameters_of
from waferbot_twin.estimation.size_prior import log_prior, scales_of
from waferbot_twin.residuals.problem import Cause


def log_odds_at(probability: float) -> float:
    """Return ln of the odds of a probability."""
    return float(logit(probability))


def log_odds_between(
    pool: CandidatePool | Judged,
    one: Hypothesis,
    other: Hypothesis,
    power_known: bool = False,
    parts: bool = False,
) -> float:
    """
    Return ln of the posterior odds of one hypothesis against another, whatever causes each has.

    A cause with other parameters is another one. With `power_known` as if the power of the noise along
    what the two do differently were known, with `parts` by what parts of the logs agree on
    (`estimation.evidence.gain`).
    """
    problem, scales = pool.problem, pool.settings.prior_scales

    def what(cause: Cause) -> tuple[str, frozenset[str]]:
        return cause.name, frozenset(cause.values)

    both = {what(cause) for cause in one.causes} & {what(cause) for cause in other.causes}

    def own(hypothesis: Hypothesis) -> float:
        total = log_prior(problem, [item for item in hypothesis.causes if what(item) in both])
        for place, cause in enumerate(hypothesis.causes):
            if what(cause) not in both:
                known = information_of(problem, hypothesis, place)
                own_scales = scales_of(problem, cause, scales)
                total += log_occam(cause, parameters_of(problem, cause), known, own_scales)
                total += pool.log_prior(cause)
        return total

    return gain(one, other, power_known=power_known, parts=parts) + own(one) - own(other)
