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
left is asked again. By the same inequality for L_0 / L_1, one with a ratio above 1 / level is confirmed.

**All blocks together, in closed loop.** The extended model loses where its RMS errors, over those of the
nominal model, have a mean square over the axes that is larger than one, by more than is tolerated.
Then the cause without which that is smallest is withdrawn, and what is left is asked again. A cause
that is confirmed, or of which the prediction is better than without it, is not to blame: in closed loop
what is still missing may hide behind what is wrong, and one error more undo another. Where that is true
of all the loss is told, and they stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Record
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
    """The mean over the axes of the mean square error after over that before."""

    def loses(self, tolerated: float) -> bool:
        """Return whether the extended model is further off by more than a share of the mean square."""
        return self.mean_square > 1.0 + tolerated


def fitted_to(estimation: Problem, causes: tuple[Cause, ...], workers: int = 1) -> Hypothesis:
    """Return causes fitted to these logs, as they are where they do not stand there."""
    try:
        return fit_causes(estimation, causes, workers=workers)
    except UserError:
        return evaluate(estimation, causes)


@dataclass(frozen=True)
class Judged:
    """Causes that the validation data do not refute, those that they do, names that they confirm."""

    kept: tuple[Cause, ...]
    refuted: tuple[Cause, ...]
    confirmed: frozenset[str]


def without_refuted(
    validation: Problem, causes: tuple[Cause, ...], level: float, predicted: Predicted
) -> Judged:
    """
    Return what the validation data say of some causes, each block alone.

    Equation (1) at a `level`. Values are those of the estimation data (`fitted_to`).
    """
    kept, refuted = causes, []
    gains_of_each: list[float] = []
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
        kept = (*kept[:worst], *kept[worst + 1 :])
    confirmed = {
        cause.name
        for cause, gained in zip(kept, gains_of_each if kept else [], strict=True)
        if gained > -math.log(level)
    }
    return Judged(kept, tuple(refuted), frozenset(confirmed))


def _gain_of(problem: Problem, causes: tuple[Cause, ...], place: int) -> float:
    """Return ln of the likelihood ratio of causes with one and without; infinite if it is needed."""
    try:
        fewer = evaluate(problem, (*causes[:place], *causes[place + 1 :]))
    except UserError:
        return math.inf
    try:
        return gain(evaluate(problem, causes), fewer)
    except UserError:
        return -math.inf


def extension_that_wins(
    nominal: Variant,
    causes: tuple[Cause, ...],
    validation: Sequence[Record],
    tolerated_loss: float,
    predicted: Predicted,
    confirmed: Collection[str] = (),
) -> Extension:
    """
    Return those of some causes, fitted to the estimation data, that win in the validation data.

    `tolerated_loss` is the rise of the mean square up to which nothing is lost (`inference.settings`).
    Those `confirmed` there (`without_refuted`), by name, stay, and those by which what is `predicted`
    is nearer.
    Raises `UserError` if the nominal model does not run there.
    """
    kept = causes
    withdrawn: list[Cause] = []
    while kept:
        ratio, found = _ratio(nominal, kept, validation)
        if ratio <= 1.0 + tolerated_loss:
            return Extension(kept, tuple(withdrawn), found, ratio)
        asked = [
            place
            for place, cause in enumerate(kept)
            if cause.name not in confirmed and predicted(cause.name) <= 0.0
        ]
        if not asked and found:
            return Extension(kept, tuple(withdrawn), found, ratio)
        fewer = [(*kept[:place], *kept[place + 1 :]) for place in asked or range(len(kept))]
        ratios = [_ratio(nominal, one, validation)[0] for one in fewer]
        best = int(np.argmin(ratios))
        withdrawn += [cause for cause in kept if cause not in fewer[best]]
        kept = fewer[best]
    return Extension((), tuple(withdrawn), gains(nominal, nominal, validation))


def _ratio(
    nominal: Variant, causes: Sequence[Cause], validation: Sequence[Record]
) -> tuple[float, list[AxisGain]]:
    """
    Return the mean over the axes of the mean square error after over that before; infinite where it
    is unstable.

    What is evident from the readings is in both models: on the steps of a coarse encoder the
    machine hunts and the true model does, but not in step, and an RMS error does not show it.
    """
    evident = [cause for cause in causes if cause.effect.evident]
    try:
        found = gains(apply_all(nominal, evident), apply_all(nominal, causes), validation)
    except UserError:
        return math.inf, []
    shares = [item.mean_square_ratio for item in found]
    if evident:
        found = gains(nominal, apply_all(nominal, causes), validation)
    return (float(np.mean(shares)) if shares else 1.0), found
