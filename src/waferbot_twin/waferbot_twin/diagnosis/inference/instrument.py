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

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.proposals.screening import signatures_beside
from waferbot_twin.estimation.conditional import conditional_errors
from waferbot_twin.estimation.gauss_newton import all_signatures
from waferbot_twin.estimation.hypothesis import Hypothesis, in_quick_steps
from waferbot_twin.estimation.stacked_least_squares import Signature, by_channel
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


def signatures_in(noise_free: Problem, found: Hypothesis, workers: int = 1) -> Sequence[Signature]:
    """
    Return what the causes of a hypothesis change in noise-free logs, in their order.

    Over the same ways as in the logs. Raises `UserError` if the model does not stand in these motions.
    """
    variant = apply_all(noise_free.nominal, found.causes)
    left = {block: noise_free.residuals(variant, block) for block in noise_free.blocks}
    quick, begun = in_quick_steps(noise_free, replace(found, residuals=left))
    return all_signatures(quick, begun, workers, errors=conditional_errors(found))


def instrumented_gain(
    problem: Problem,
    more: Hypothesis,
    signatures: Sequence[Signature],
    noise_free: Problem,
    in_noise_free: Sequence[Signature],
) -> float | None:
    """
    Return what the last cause of `more` gains in ln L by what the command makes it do.

    What it changes is found by simulation; what the others can do of that is taken out, by least squares
    in the linear problem (`signatures` of theirs in the logs, and in the noise-free ones). With d what
    is left of the change in the logs, z as much of it in the noise-free ones, both white, and b what is
    left over without the cause, more than that is in a noise-free log of its own loop (where counts are
    taken for motion, that is not nothing), the instrument's estimate of the cause's size, 1 if the logs
    are right, is z' b / z' d with the variance lambda z' z / (z' d)^2, lambda the power along z of what
    `more` leaves over less what was subtracted (`residual_spectrum.power_along`): rounding is in both.
    That is the likelihood ratio of (z' b)^2 / z' z, nothing if z' b is negative, and what exact blocks
    gain. None if the model does not stand in these motions.
    """
    others = more.causes[:-1]
    with_it, without = (apply_all(problem.nominal, item) for item in (more.causes, others))
    try:
        own = problem.ideal(others)
        fewer = {block: problem.residuals(without, block) for block in more.fits}
        free = {
            block: _change(
                noise_free.residuals(without, block), noise_free.residuals(with_it, block)
            )
            for block in noise_free.blocks
            if block in more.fits
        }
        feigned = {block: own.residuals(without, block) for block in free} if own else {}
    except UserError:
        return None
    change = {block: _change(fewer[block], more.residuals[block]) for block in more.fits}
    beside, beside_free = (
        signatures_beside(problem, replace(more, causes=others), some)
        for some in (signatures, in_noise_free)
    )
    amount = _least_squares(more, beside, change)
    change, free = (
        {
            block: rows - side[block] @ amount if block in side else rows
            for block, rows in of.items()
        }
        for of, side in ((change, beside), (free, beside_free))
    )
    signals, exact = 0.0, 0.0
    left: list[Array] = []
    along: list[Array] = []
    colours: list[Colour] = []
    for block, fit in more.fits.items():
        channels = more.residuals[block]
        done = in_deviations(fit.colours, by_channel(change[block], channels))
        before = [one + two for one, two in zip(fit.whitened, done, strict=True)]
        after = list(fit.whitened)
        if block not in free or not any(colour.error.order for colour in fit.colours):
            exact += sum(0.5 * float(one @ one) for one in before)
            exact -= sum(0.5 * float(one @ one) for one in after)
            continue
        if block in feigned:
            rounding = in_deviations(fit.colours, feigned[block])
            before, after = (
                [one - two for one, two in zip(some, rounding, strict=True)]
                for some in (before, after)
            )
        caused = in_deviations(fit.colours, by_channel(free[block], channels))
        signals += sum(float(z @ b) for z, b in zip(caused, before, strict=True))
        left += after
        along += caused
        colours += fit.colours
    square = sum(float(z @ z) for z in along)
    if square == 0.0 or signals <= 0.0:
        return exact
    return exact + power_along(left, along, colours).log_likelihood_ratio(signals**2 / square)


def _change(before: Sequence[Array], after: Sequence[Array]) -> Array:
    """Return by how much more is left over in the channels of a block, one behind the other."""
    return np.concatenate(before) - np.concatenate(after)


def _least_squares(found: Hypothesis, beside: Signature, change: Mapping[str, Array]) -> Array:
    """Return how much of each parameter (k,) takes most of a change away, white in `found`'s noise."""
    rows, right = [], []
    for block, matrix in beside.items():
        fit, channels = found.fits[block], found.residuals[block]
        rows += in_deviations(fit.colours, by_channel(matrix, channels))
        right += in_deviations(fit.colours, by_channel(change[block], channels))
    if not rows:
        return np.zeros(0)
    stacked = np.concatenate(rows)
    norms = np.linalg.norm(stacked, axis=0)
    norms[norms == 0.0] = 1.0
    amount = np.linalg.lstsq(stacked / norms, np.concatenate(right), rcond=None)[0] / norms
    return np.asarray(amount)
