# SPDX-License-Identifier: Apache-2.0
"""
How far off the parameters of one machine are, as a multiple of what is usual; what is known of each.

The prior of n parameters, each off by x with the usual spread s, is Student's t with nu degrees of
freedom (`residuals.prior_block`): normal with the spread k s, k not known. A fit has the most probable x
of all of them together; where logs tell nothing of one, that is zero, and counted as such it would say
that this machine is closer to its model than it is. What is expected of its square is not zero, but its
variance V. So k follows from what the logs tell (expectation maximisation: A. Dempster, N. Laird,
D. Rubin, Journal of the Royal Statistical Society B 39, 1977),

    k^2 = (nu + sum of (x^2 + V) / s^2) / (nu + n),                                               (1)
    C = (L + D / k^2)^-1,    V = diag C,    D = diag(1 / s^2),                                    (2)

with L what logs and other priors say of all parameters that were fitted, C their covariance. Of what the
logs do not tell at all V is k^2 s^2, and (1) is the same without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import fixed_point

from waferbot_twin.estimation.gauss_newton import names_of
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.estimation.size_prior import information_of_logs, posterior_covariance
from waferbot_twin.residuals.prior_block import KNOWN_FROM
from waferbot_twin.residuals.problem import Problem
from waferbot_twin.residuals.record import Array


def with_usual_spread(problem: Problem, found: Hypothesis) -> Hypothesis:
    """Return a fitted hypothesis with the covariance C of equation (2)."""
    groups = _groups(problem, found)
    if not groups or len(found.covariance) != len(names_of(problem, found.causes)):
        return found
    inverse = np.zeros((len(groups), len(found.covariance)))
    scales = np.zeros(len(groups))
    for row, group in enumerate(groups):
        inverse[row, group.places] = group.spreads**-2.0
        # As the fit had it: of the most probable values, those that are held among them.
        scales[row] = (KNOWN_FROM + group.squares) / (KNOWN_FROM + group.every)
    logs = _not_negative(information_of_logs(found.covariance, scales**-1.0 @ inverse))

    def next_scales(squares: Array) -> Array:
        covariance = posterior_covariance(logs, squares**-1.0 @ inverse)
        return np.array([group.square_of_scale(covariance) for group in groups])

    scales = fixed_point(next_scales, scales)
    return replace(found, covariance=posterior_covariance(logs, scales**-1.0 @ inverse))


def _not_negative(information: Array) -> Array:
    """
    Return what logs say (k, k) without directions of which they say less than nothing.

    A fit that is not at its end has a little more or less of the prior in its covariance than its
    values say.
    """
    diagonal = np.diag(information)
    unit = np.sqrt(np.where(diagonal > 0.0, diagonal, np.max(diagonal, initial=1e-300)))
    size, directions = np.linalg.eigh(information / np.outer(unit, unit))
    return np.asarray(directions * np.maximum(size, 0.0) @ directions.T * np.outer(unit, unit))


def scales_of_spread(problem: Problem, found: Hypothesis) -> dict[str, float]:
    """Return the k of equation (1) of every fitted parameter with a usual spread, by its name."""
    if len(found.covariance) != len(names_of(problem, found.causes)):
        return {}
    return {
        name: math.sqrt(group.square_of_scale(found.covariance))
        for group in _groups(problem, found)
        for name in group.names
    }


@dataclass(frozen=True)
class _Group:
    """
    The parameters of a dense effect that are free, with their spreads s (n,).

    At their `places` among those that were fitted, |x / s|^2 of all in `squares`; `every` counts those
    that are held, too.
    """

    names: tuple[str, ...]
    places: list[int]
    spreads: Array
    squares: float
    every: int

    def square_of_scale(self, covariance: Array) -> float:
        """Return equation (1)."""
        variances = np.diag(covariance)[self.places] / self.spreads**2
        count = KNOWN_FROM + len(self.places)
        return (KNOWN_FROM + self.squares + float(variances.sum())) / count


def _groups(problem: Problem, found: Hypothesis) -> list[_Group]:
    names = names_of(problem, found.causes)
    groups = []
    for number, cause in enumerate(found.causes):
        own = [
            (place, item)
            for place, (at, item) in enumerate(names)
            if at == number and item.spread > 0.0
        ]
        if not own:
            continue
        spreads = np.array([item.spread for _, item in own])
        away = np.array([cause.values[item.name] for _, item in own]) / spreads
        groups.append(
            _Group(
                tuple(item.name for _, item in own),
                [place for place, _ in own],
                spreads,
                float(away @ away),
                len(cause.values),
            )
        )
    return groups
