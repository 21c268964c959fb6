# SPDX-License-Identifier: Apache-2.0
"""
Does an extension hold in logs that were not used for its fit? What does not is withdrawn.

Causes are fitted to the estimation data alone, and asked twice in the validation data.

**Each block alone.** With and without a cause the validation data have the likelihoods L_1 and L_0
(`estimation.evidence.gain`). If the cause is true, then by Markov's inequality

    P(L_1 / L_0 < level) <= level,                                                                 (1)

whatever the noise. It holds of likelihoods that are predictions: with values as sure as the estimation
data tell them. With these values themselves the ratio is quickly found; where it is below, that of the
predictions is asked (`diagnosis.inference.prediction`): what is below there, too, is refuted. What the
validation data do not show is not. Of several the one that is refuted most is withdrawn, and what is
left is asked again.

**All blocks together, in closed loop.** No block alone tells whether a loop is stable: each is driven by
what was measured. But the machine ran, in the estimation data as well. The extended model loses where
its RMS errors, over those of the nominal model, have a mean square over the axes that is larger than
one by more than is tolerated, in the validation data or in the estimation data. To blame is the cause
without which the closed loop gains most beside what the blocks lose, in ln L,

    D - ln odds,    D = sum over axes and logs of n/2 ln(s^2 / s_0^2),                             (2)

s and s_0 the RMS error with it and without it, of unknown size (a profile likelihood), n the number of
independent samples in them. Estimation data, to which the causes were fitted, may accuse one and not
defend it: less than nothing counts as nothing there. It is withdrawn if that is positive, and what is
left is asked again: a cause may lose a little in closed loop, as one error more undoes another, but not
against all odds. Where none is to blame the loss is told, and they stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array, Record
from waferbot_twin.validation.gain import AxisGain, gains

Predicted = Callable[[str], float]
"""ln of how much likelier the validation data are, predicted with the cause of a name, than without."""


@dataclass(frozen=True)
class Extension:
    """Causes that win, fitted to the estimation data alone, and those that were withdrawn."""

    causes: tuple[Cause, ...]
    withdrawn: tuple[Cause, ...]
    gains: list[AxisGain]
    mean_square: float = 1.0
    """The mean over the axes of the mean square error after over that before, where it is worse."""

    def loses(self, tolerated: float) -> bool:
        """Return whether the extended model is further off by more than a share of the mean square."""
        return self.mean_square > 1.0 + tolerated


def fitted_to(estimation: Problem, causes: tuple[Cause, ...], workers: int = 1) -> Hypothesis:
    """Return causes fitted to these logs, as they are where they do not stand there."""
    try:
        return fit_causes(estimation, causes, workers=workers)
    except UserError:
        return evaluate(estimation, causes)


def without_refuted(
    validation: Problem, causes: tuple[Cause, ...], level: float, predicted: Predicted
) -> tuple[Cause, ...]:
    """
    Return those of some causes that the validation data refute, each block alone.

    Equation (1) at a `level`. Values are those of the estimation data (`fitted_to`).
    """
    kept, refuted = causes, []
    of_predictions: dict[str, float] = {}
    while kept:
        gains_of_each = [
            of_predictions[cause.name]
            if cause.name in of_predictions
            else _gain_of(validation, kept, place)
            for place, cause in enumerate(kept)
        ]
        asked = [place for place, cause in enumerate(kept) if cause.name not in of_predictions]
        worst = min(asked, key=lambda place: gains_of_each[place], default=None)
        if worst is None or gains_of_each[worst] >= math.log(level):
            break
        ratio = predicted(kept[worst].name)
        if ratio >= math.log(level):
            of_predictions[kept[worst].name] = ratio
            continue
        refuted.append(kept[worst])
        # The others keep their values: fitted anew they would stand in for what was in that log alone.
        kept = _others(kept, worst)
    return tuple(refuted)


def _gain_of(problem: Problem, causes: tuple[Cause, ...], place: int) -> float:
    """Return ln of the likelihood ratio of causes with one and without; infinite if it is needed."""
    try:
        fewer = evaluate(problem, _others(causes, place))
    except UserError:
        return math.inf
    try:
        return gain(evaluate(problem, causes), fewer)
    except UserError:
        return -math.inf


def extension_that_wins(
    nominal: Variant,
    causes: tuple[Cause, ...],
    estimation: Sequence[Record],
    validation: Sequence[Record],
    tolerated_loss: float,
    log_odds: Mapping[str, float],
) -> Extension:
    """
    Return those of some causes, fitted to the estimation data, that win in closed loop.

    `tolerated_loss` is the rise of the mean square up to which nothing is lost (`inference.settings`),
    `log_odds` what the blocks say of each cause by name (equation (2)). What is gained is that of the
    validation data; nothing is told of it where a model is unstable there.
    """
    parts = estimation, validation

    def ratio(some: Sequence[Cause]) -> float:
        return max(_ratio(nominal, some, records) for records in parts)

    kept = causes
    withdrawn: list[Cause] = []
    while kept and ratio(kept) > 1.0 + tolerated_loss:
        more = [_errors(nominal, kept, records) for records in parts]
        blame = []
        for place, cause in enumerate(kept):
            without = [_errors(nominal, _others(kept, place), records) for records in parts]
            there, elsewhere = (_gain_without(*one) for one in zip(more, without, strict=True))
            blame.append(max(there, 0.0) + elsewhere - log_odds[cause.name])
        worst = int(np.argmax(blame))
        if not blame[worst] > 0.0:
            break
        withdrawn.append(kept[worst])
        kept = _others(kept, worst)
    gained = _errors(nominal, kept, validation) or []
    return Extension(kept, tuple(withdrawn), gained, ratio(kept))


def _others(causes: tuple[Cause, ...], place: int) -> tuple[Cause, ...]:
    return (*causes[:place], *causes[place + 1 :])


def _errors(
    nominal: Variant, causes: Sequence[Cause], records: Sequence[Record]
) -> list[AxisGain] | None:
    """Return the errors of a model in every log on every axis; None where it is unstable."""
    try:
        return gains(nominal, apply_all(nominal, causes), records)
    except UserError:
        return None


def _gain_without(more: list[AxisGain] | None, fewer: list[AxisGain] | None) -> float:
    """Return D of equation (2) in some logs; infinite where only one of the two models runs."""
    if more is None or fewer is None:
        return 0.0 if more is fewer else math.inf if more is None else -math.inf
    return sum(
        0.5
        * min(independent_samples(one.error_after), independent_samples(other.error_after))
        * math.log(one.mean_square_after / other.mean_square_after)
        for one, other in zip(more, fewer, strict=True)
    )


def independent_samples(error: Array) -> float:
    """
    Return how many independent samples the mean square of a series (n,) is as sure as.

    2 (sum P)^2 / sum P^2 over its periodogram P: n of white noise, 4 of a single line, and its
    variance over its square is 2 by that number.
    """
    powers = np.abs(np.fft.fft(error)) ** 2
    total = float(powers.sum())
    return 2.0 * total**2 / float(powers @ powers) if total > 0.0 else float(len(error))


def _ratio(nominal: Variant, causes: Sequence[Cause], records: Sequence[Record]) -> float:
    """
    Return the mean over axes and logs of the mean square error after over that before.

    Infinite where it is unstable. What is evident from the readings is in both models: on the steps of a
    coarse encoder the machine hunts and the true model does, but not in step, and an RMS error does not
    show it.
    """
    evident = [cause for cause in causes if cause.effect.evident]
    try:
        found = gains(apply_all(nominal, evident), apply_all(nominal, causes), records)
    except UserError:
        return math.inf
    return float(np.mean([item.mean_square_ratio for item in found])) if found else 1.0
