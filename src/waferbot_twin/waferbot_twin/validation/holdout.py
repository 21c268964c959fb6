# SPDX-License-Identifier: Apache-2.0
"""
Does an extension win in logs that were not used for its fit? What loses there is withdrawn.

Causes are fitted to the estimation data alone. The extended model loses where its RMS errors in the
validation data, over those of the nominal model, have a mean square over the axes that is larger
than one, by more than is tolerated. Then the cause without which that is smallest is withdrawn, and
what is left is asked again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Record
from waferbot_twin.validation.gain import AxisGain, gains


@dataclass(frozen=True)
class Extension:
    """Causes that win, fitted to the estimation data alone, and those that were withdrawn."""

    causes: tuple[Cause, ...]
    withdrawn: tuple[Cause, ...]
    gains: list[AxisGain]


def extension_that_wins(
    nominal: Variant,
    causes: tuple[Cause, ...],
    estimation: Sequence[Record],
    validation: Sequence[Record],
    tolerated_loss: float,
) -> Extension:
    """
    Return those of some causes that win in the validation data.

    `tolerated_loss` is the rise of the mean square up to which nothing is lost (`inference.settings`).
    Raises `UserError` if the nominal model does not run there.
    """
    kept = _fitted(Problem(nominal, estimation), causes)
    withdrawn: list[Cause] = []
    while kept:
        ratio, found = _ratio(nominal, kept, validation)
        if ratio <= 1.0 + tolerated_loss:
            return Extension(kept, tuple(withdrawn), found)
        fewer = [(*kept[:place], *kept[place + 1 :]) for place in range(len(kept))]
        ratios = [_ratio(nominal, one, validation)[0] for one in fewer]
        worst = int(np.argmin(ratios))
        withdrawn.append(kept[worst])
        kept = fewer[worst]
    return Extension((), tuple(withdrawn), gains(nominal, nominal, validation))


def _fitted(problem: Problem, causes: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """Return causes with the values of these logs, as they are where they do not stand there."""
    try:
        return fit_causes(problem, causes).causes
    except UserError:
        return causes


def _ratio(
    nominal: Variant, causes: Sequence[Cause], validation: Sequence[Record]
) -> tuple[float, list[AxisGain]]:
    """
    Return the mean square over the axes of RMS after over RMS before; infinite where it is
    unstable.

    What is evident from the readings is in both models: on the steps of a coarse encoder the
    machine hunts and the true model does, but not in step, and an RMS error does not show it.
    """
    evident = [cause for cause in causes if cause.effect.evident]
    try:
        found = gains(apply_all(nominal, evident), apply_all(nominal, causes), validation)
    except UserError:
        return math.inf, []
    shares = [(item.rms_after / item.rms_before) ** 2 for item in found if item.rms_before > 0.0]
    if evident:
        found = gains(nominal, apply_all(nominal, causes), validation)
    return (float(np.mean(shares)) if shares else 1.0), found
