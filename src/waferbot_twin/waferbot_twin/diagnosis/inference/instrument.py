# SPDX-License-Identifier: Apache-2.0
"""
An instrument against what the closed loop makes of noise.

In a closed loop noise moves the axis, the controller answers, and what noise made of the current
looks like a wrong amplifier; rounding of a position that a controller holds, like play. What the
*command* makes of a cause in a noise-free log knows nothing of the noise: an instrument z of its
change d (L. Ljung, System Identification, 2nd ed., section 13.4). Noise-free logs are those of the
model in its closed loop, or where nobody knows the controller what the commands explain of the measured
ones (`commanded_record`).

Whether noise feigns a cause is an open question like the cause itself, with the same prior probability
pi: as many are feigned as are there. A feigned one explains the logs as well as a true one, but for what
the command makes of it. With B the odds of a cause by the logs as they are, B_z those by the instrument
alone, summed over all four cases,

    1 / odds = (1 - pi) / B + pi / B_z.                                                             (1)

Where the command shows a cause plainly, that is B; where noise alone does, what the instrument leaves.
"""

from __future__ import annotations

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.noise_model.prediction_error import Colour, in_deviations
from waferbot_twin.noise_model.residual_spectrum import power_along
from waferbot_twin.residuals.commanded_record import as_commanded, tells_command
from waferbot_twin.residuals.problem import Problem, apply_all
from waferbot_twin.residuals.record import Array


def noise_free_logs(problem: Problem, found: Hypothesis) -> Problem | None:
    """
    Return the logs that the command would have given without noise, None where none is known.

    Raises `UserError` if the loop is unstable.
    """
    ideal = problem.ideal(found.causes)
    if ideal is not None or not all(tells_command(record) for record in problem.records):
        return ideal
    return Problem(problem.nominal, [as_commanded(record) for record in problem.records])


def log_odds_beside_noise(by_logs: float, by_command: float, log_prior: float) -> float:
    """Return ln of the odds of equation (1) for ln B, ln B_z and ln pi / (1 - pi)."""
    feigned = -float(np.logaddexp(0.0, -log_prior))
    true = -float(np.logaddexp(0.0, log_prior))
    return -float(np.logaddexp(true - by_logs, feigned - by_command))


def instrumented_gain(
    problem: Problem, base: Hypothesis, more: Hypothesis, noise_free: Problem
) -> float | None:
    """
    Return what the last cause of `more` gains in ln L over `base` by what the command makes it do.

    With z its change in the noise-free logs and d that in the logs, both white, and b what `base` leaves
    over, more than it leaves in a noise-free log of its own loop (where counts are taken for motion,
    that is not nothing), the instrument's estimate of the cause's size, 1 if the logs are right, is
    z' b / z' d with the variance lambda z' z / (z' d)^2, lambda the power along z of what `more` leaves
    over less what was subtracted (`residual_spectrum.power_along`): rounding is in both. That is the
    likelihood ratio of (z' b)^2 / z' z, nothing if z' b is negative, and what exact blocks gain. None if
    the model does not stand in these motions.
    """
    try:
        own = problem.ideal(base.causes)
        with_it, without = (apply_all(problem.nominal, item.causes) for item in (more, base))
        signals = 0.0
        left: list[Array] = []
        along: list[Array] = []
        colours: list[Colour] = []
        for block, fit in more.fits.items():
            if not any(colour.error.order for colour in fit.colours):
                continue
            pairs = zip(
                noise_free.residuals(without, block),
                noise_free.residuals(with_it, block),
                strict=True,
            )
            changes = in_deviations(fit.colours, [one - two for one, two in pairs])
            before = in_deviations(fit.colours, base.residuals[block])
            after = fit.whitened
            if own is not None:
                feigned = in_deviations(fit.colours, own.residuals(without, block))
                before = [one - two for one, two in zip(before, feigned, strict=True)]
                after = tuple(one - two for one, two in zip(after, feigned, strict=True))
            signals += sum(float(z @ b) for z, b in zip(changes, before, strict=True))
            left += after
            along += changes
            colours += fit.colours
    except UserError:
        return None
    square = sum(float(z @ z) for z in along)
    if square == 0.0 or signals <= 0.0:
        return _exact_gain(more, base)
    caused = power_along(left, along, colours).log_likelihood_ratio(signals**2 / square)
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
