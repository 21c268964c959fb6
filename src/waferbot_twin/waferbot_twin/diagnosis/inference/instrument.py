# SPDX-License-Identifier: Apache-2.0
"""
An instrument against what the closed loop makes of noise.

In a closed loop noise moves the axis, the controller answers, and what noise made of the current
looks like a wrong amplifier; rounding of a position that a controller holds, like play. What the
*command* makes of a cause in a noise-free log knows nothing of the noise: an instrument of its change d
(L. Ljung, System Identification, 2nd ed., section 13.4). Noise-free logs are those of the model in its
closed loop, or where nobody knows the controller what the commands explain of the measured ones
(`commanded_record`).

Whatever knows nothing of the noise is an instrument, and says the more the more it is like d. With
many causes the loop of a model may ring, or be unstable, where the machine's is not; then it says
nothing, of any cause. The loop of the nominal model does less of what the machine does, but does not
depend on what was found. So both are asked, and with Z what a cause changes in each of them, z is what
they explain of d (two-stage least squares, T. Söderström, P. Stoica, System Identification, 1989; here
with c >= 0, as what goes against d says nothing of it),

    z = Z c,        c >= 0 with |d - Z c|^2 the least.                                              (1)

Whether noise feigns a cause is an open question like the cause itself, with the same prior probability
pi: as many are feigned as are there. A feigned one explains the logs as well as a true one, but for what
the command makes of it. With B the odds of a cause by the logs as they are, B_z those by the instrument
alone, summed over all four cases,

    1 / odds = (1 - pi) / B + pi / B_z.                                                             (2)

Where the command shows a cause plainly, that is B; where noise alone does, what the instrument leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from waferbot_lockstep.errors import UserError
from waferbot_twin.estimation.conditional import conditional_errors
from waferbot_twin.estimation.gauss_newton import (
    all_signatures,
    least_squares_within,
    names_of,
    room,
)
from waferbot_twin.estimation.hypothesis import Hypothesis, in_quick_steps, parameters_of
from waferbot_twin.estimation.size_prior import away_from_neutral, precision
from waferbot_twin.estimation.stacked_least_squares import Signature, by_channel, side_by_side
from waferbot_twin.noise_model.leverage import Leverage
from waferbot_twin.noise_model.prediction_error import Colour, in_deviations
from waferbot_twin.noise_model.residual_spectrum import power_along
from waferbot_twin.residuals.commanded_record import as_commanded, tells_command
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array


def noise_free_logs(problem: Problem, found: Hypothesis) -> list[Problem]:
    """
    Return the logs that the command would have given without noise, none where none are known.

    Of the loop of a hypothesis and of that of the nominal model, as far as these are stable.
    """
    loops: list[Problem] = []
    for causes in (found.causes, ()):
        try:
            ideal = problem.ideal(causes)
        except UserError:
            continue
        loops += [ideal] if ideal is not None else []
    if loops or not all(tells_command(record) for record in problem.records):
        return loops
    return [Problem(problem.nominal, [as_commanded(record) for record in problem.records])]


def log_odds_beside_noise(by_logs: float, by_command: float, log_prior: float) -> float:
    """Return ln of the odds of equation (2) for ln B, ln B_z and ln pi / (1 - pi)."""
    feigned = -float(np.logaddexp(0.0, -log_prior))
    true = -float(np.logaddexp(0.0, log_prior))
    return -float(np.logaddexp(true - by_logs, feigned - by_command))


@dataclass(frozen=True)
class NoiseFree:
    """Logs without noise, and what the causes of a hypothesis change in them, by their names."""

    problem: Problem
    signatures: Mapping[str, Signature]

    @classmethod
    def of(cls, problem: Problem, found: Hypothesis, workers: int = 1) -> NoiseFree:
        """
        Take noise-free logs and the causes of a hypothesis, over the same ways as in the logs.

        Raises `UserError` if the model does not stand in these motions.
        """
        variant = apply_all(problem.nominal, found.causes)
        left = {block: problem.residuals(variant, block) for block in problem.blocks}
        quick, begun = in_quick_steps(problem, replace(found, residuals=left))
        each = all_signatures(quick, begun, workers, errors=conditional_errors(found))
        names = [cause.name for cause in found.causes]
        return cls(problem, dict(zip(names, each, strict=True)))


def instrumented_gain(
    problem: Problem,
    more: Hypothesis,
    others: tuple[Cause, ...],
    noise_free: Sequence[Problem],
    giving_way: GivingWay | None = None,
) -> float | None:
    """
    Return what the last cause of `more` gains in ln L by what the command makes it do.

    The model without it has `others`, and what these do besides to make up for it in the linear problem
    (`giving_way`). With z what the noise-free logs explain of the change d, equation (1), all white, and
    b what is left over without the cause, more than that is in a noise-free log of its own loop (where
    counts are taken for motion, that is not nothing), the instrument's estimate of the cause's size, 1
    if the logs are right, is z' b / z' d with the variance lambda z' z / (z' d)^2, lambda the power
    along z of what `more` leaves over less what was subtracted (`residual_spectrum.power_along`):
    rounding is in both. That is the likelihood ratio of (z' b)^2 / z' z, nothing if z' b is negative,
    and what exact blocks gain. None if the model does not stand in these motions.
    """
    blocks = [block for block in noise_free[0].blocks if block in more.fits]
    try:
        with_it, without = (apply_all(problem.nominal, item) for item in (more.causes, others))
        own = problem.ideal(others)
        fewer = {block: problem.residuals(without, block) for block in more.fits}
        free = [
            {
                block: _change(logs.residuals(without, block), logs.residuals(with_it, block))
                for block in blocks
            }
            for logs in noise_free
        ]
        feigned = {block: own.residuals(without, block) for block in blocks} if own else {}
    except UserError:
        return None
    change = {block: _change(fewer[block], more.residuals[block]) for block in more.fits}
    if giving_way is not None:
        amount = giving_way.amount(problem, more, change)
        change = _moved(change, giving_way.in_logs, amount)
        free = [
            _moved(one, signature, amount)
            for one, signature in zip(free, giving_way.in_noise_free, strict=True)
        ]
    return _gain_along(more, change, free, feigned)


def _gain_along(
    more: Hypothesis,
    change: Mapping[str, Array],
    free: Sequence[Mapping[str, Array]],
    feigned: Mapping[str, Sequence[Array]],
) -> float:
    """
    Return the gain of a change of what `more` leaves over, along what instruments explain of it.

    `change`, `free` (in each of the noise-free logs) and what is `feigned` there are by block; a block
    that is not `free`, or is exact, gains what it does. `instrumented_gain` has the formula.
    """
    exact = 0.0
    changed: list[Array] = []
    present: list[Array] = []
    left: list[Array] = []
    caused: list[list[Array]] = [[] for _ in free]
    colours: list[Colour] = []
    leverages: list[Leverage | None] = []
    for block, fit in more.fits.items():
        channels = more.residuals[block]
        done = in_deviations(fit.colours, by_channel(change[block], channels))
        before = [one + two for one, two in zip(fit.whitened, done, strict=True)]
        after = list(fit.whitened)
        if block not in free[0] or not any(colour.error.order for colour in fit.colours):
            exact += sum(0.5 * float(one @ one) for one in before)
            exact -= sum(0.5 * float(one @ one) for one in after)
            continue
        if block in feigned:
            rounding = in_deviations(fit.colours, feigned[block])
            before, after = (
                [one - two for one, two in zip(some, rounding, strict=True)]
                for some in (before, after)
            )
        for own, one in zip(caused, free, strict=True):
            own += in_deviations(fit.colours, by_channel(one[block], channels))
        changed += done
        present += before
        left += after
        colours += fit.colours
        leverages += fit.leverages
    along = explained(changed, caused)
    square = sum(float(z @ z) for z in along)
    signals = sum(float(z @ b) for z, b in zip(along, present, strict=True))
    if square == 0.0 or signals <= 0.0:
        return exact
    return exact + power_along(left, along, colours, leverages).log_likelihood_ratio(
        signals**2 / square
    )


def explained(change: Sequence[Array], caused: Sequence[Sequence[Array]]) -> list[Array]:
    """Return z of equation (1) channel by channel: what instruments explain of a change d."""
    if not change:
        return []
    instruments = np.column_stack([np.concatenate(one) for one in caused])
    sizes = np.linalg.norm(instruments, axis=0)
    sizes[sizes == 0.0] = 1.0
    shares, _ = nnls(instruments / sizes, np.concatenate(change))
    ends = np.cumsum([len(channel) for channel in change])[:-1]
    return np.split(instruments / sizes @ shares, ends)


@dataclass(frozen=True)
class GivingWay:
    """
    How causes make up for one that is taken away, in the linear problem.

    `in_logs` are their signatures side by side, `in_noise_free` those in each of the noise-free logs.
    """

    causes: tuple[Cause, ...]
    in_logs: Signature
    in_noise_free: Sequence[Signature]

    @classmethod
    def of(
        cls,
        problem: Problem,
        causes: tuple[Cause, ...],
        in_logs: Sequence[Signature],
        in_noise_free: Sequence[Sequence[Signature]],
    ) -> GivingWay:
        """Take some causes with their signatures in their order."""
        counts = [len(parameters_of(problem, cause)) for cause in causes]
        there = [side_by_side(one, counts) for one in in_noise_free]
        return cls(causes, side_by_side(in_logs, counts), there)

    def amount(self, problem: Problem, more: Hypothesis, change: Mapping[str, Array]) -> Array:
        """
        Return how far each parameter (k,) goes, within its bounds and with the prior of its size.

        `change` is what is left over without the cause more than `more` leaves.
        """
        names = names_of(problem, self.causes)
        if not names:
            return np.zeros(0)
        rows, right = [], []
        for block, matrix in self.in_logs.items():
            fit, channels = more.fits[block], more.residuals[block]
            rows += in_deviations(fit.colours, by_channel(matrix, channels))
            done = in_deviations(fit.colours, by_channel(change[block], channels))
            right += [-one - two for one, two in zip(fit.whitened, done, strict=True)]
        matrix, target = np.concatenate(rows), np.concatenate(right)
        basis, matrix = np.linalg.qr(matrix)
        root = np.sqrt(np.concatenate([precision(problem, cause) for cause in self.causes]))
        away = np.concatenate(
            [away_from_neutral(cause, parameters_of(problem, cause)) for cause in self.causes]
        )
        matrix = np.vstack([matrix, np.diag(root)])
        target = np.concatenate([basis.T @ target, -root * away])
        return least_squares_within(matrix, target, *room(self.causes, names))


def _moved(change: Mapping[str, Array], signature: Signature, amount: Array) -> dict[str, Array]:
    """Return a change with what parameters that go so far do besides."""
    return {
        block: rows + signature[block] @ amount if block in signature else rows
        for block, rows in change.items()
    }


def _change(before: Sequence[Array], after: Sequence[Array]) -> Array:
    """Return by how much more is left over in the channels of a block, one behind the other."""
    return np.concatenate(before) - np.concatenate(after)
