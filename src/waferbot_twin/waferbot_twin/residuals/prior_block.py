# SPDX-License-Identifier: Apache-2.0
"""
What is known of parameters before any log, as if it had been measured.

A parameter p that usually lies within a standard deviation s of the model's value p_0 adds one
sample to the residuals of the logs,

    r = (p - p_0) / s,        white noise,                                                         (1)

so that its prior takes part in every fit, likelihood, gain and covariance as any reading does
(mixed estimation: H. Theil, A. Goldberger, International Economic Review 2, 1961).

How much is usual is not known exactly either. It counts as known from nu other parameters, each off by
its s: nu samples more, of r = 1, and the variance of all n + nu is estimated. Then the prior of n
parameters is Student's t with nu degrees of freedom in n dimensions (A. Gelman et al., Bayesian Data
Analysis, 3rd ed., section 3.2),

    ln p = c - sum of ln s - n/2 ln(2 pi) - (nu + n)/2 ln(1 + |r|^2 / nu),                         (2)
    c = ln G((nu + n) / 2) - ln G(nu / 2) - n/2 ln(nu / 2),

G the gamma function. Its tails are heavy: a machine on which most things are far off is one that differs
a lot, and not an impossible one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import gammaln

from waferbot_twin.effects.variant import Variant
from waferbot_twin.noise_model.prediction_error import Noise
from waferbot_twin.residuals.record import Array, Record

KNOWN_FROM = 8
"""The nu of equation (2)."""


def log_normaliser(count: int) -> float:
    """Return the c of equation (2) for n = `count`."""
    half = 0.5 * KNOWN_FROM
    return float(gammaln(half + 0.5 * count) - gammaln(half) - 0.5 * count * math.log(half))


class PriorBlock:
    """Equation (1) for the parameters that a model may have changed (`Variant.deviations`)."""

    def __init__(self, record: Record, names: Sequence[str]) -> None:
        """Take the names of parameters; `record` is any of the logs, of which there is no need."""
        self.record = record
        self.channels = ['usual deviations']
        self.noises = [Noise(0.0, 0)]
        self._names = tuple(names)

    def times_s(self, channel: str) -> Array:
        """Return zeros: it is known before the log begins."""
        return np.zeros(len(self._names) + KNOWN_FROM)

    def residuals(self, variant: Variant) -> list[Array]:
        """Return r of every parameter, and of those that the spreads are known from, one channel."""
        own = [variant.deviations.get(name, 0.0) for name in self._names]
        return [np.array(own + KNOWN_FROM * [1.0])]
