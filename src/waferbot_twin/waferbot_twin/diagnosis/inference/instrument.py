# SPDX-License-Identifier: Apache-2.0
"""
An instrument against what the closed loop makes of noise.

In a closed loop noise moves the axis, the controller answers, and what noise made of the current
looks like a wrong amplifier. What the *command* makes of a cause in the noise-free log of the
model knows nothing of the noise: an instrument z of its change d (L. Ljung, System Identification,
2nd ed., section 13.4). If the two agree on the size, Hausman's test of endogeneity (Econometrica
46, 1978), the logs count as they are, else the instrument alone.
"""

from __future__ import annotations

import math

from scipy.stats import t as student

from waferbot_lockstep.errors import UserError
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.noise_model.prediction_error import Colour, in_deviations
from waferbot_twin.noise_model.residual_spectrum import power_along
from waferbot_twin.residuals.problem import Problem, apply_all
from waferbot_twin.residuals.record import Array


def instrumented_gain(
    problem: Problem,
    base: Hypothesis,
    more: Hypothesis,
    level: float,
    noise_free: Problem | None = None,
) -> float | None:
    """
    Return what the last cause of `more` gains in ln L over `base` by what the command makes it do.

    With z its change in the noise-free log and d that in the logs, both white, and b what `base` leaves
    over, more than it leaves in a noise-free log of its own (where counts are taken for motion, that is
    not nothing), the instrument's estimate of the cause's size, 1 if the two agree, is z' b / z' d
    with the variance lambda z' z / (z' d)^2, lambda the power along z of what `more` leaves over less
    what was subtracted (`residual_spectrum.power_along`): rounding is in both. None if they agree at
    the `level` of Hausman's test, or if the logs do not tell what was commanded; else the likelihood
    ratio of (z' b)^2 / z' z, nothing if z' b is negative, and what exact blocks gain. `noise_free` are
    the noise-free logs of `more` if somebody has them.
    """
    try:
        ideal = noise_free or problem.ideal(more.causes)
        own = problem.ideal(base.causes) if ideal is not None else None
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
            left += [one - two for one, two in zip(fit.whitened, feigned, strict=True)]
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
