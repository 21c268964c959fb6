# SPDX-License-Identifier: Apache-2.0
"""
What is known of parameters before any log, as if it had been measured.

A parameter p that usually lies within a standard deviation s of the model's value p_0 adds one
sample to the residuals of the logs,

    r = (p - p_0) / s,        white noise of unit variance,                                       (1)

so that its prior takes part in every fit, likelihood, gain and covariance as any reading does
(mixed estimation: H. Theil, A. Goldberger, International Economic Review 2, 1961). The variance is
not estimated from them: of the three numbers of a slide two that are 8 % off would then be usual.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from waferbot_twin.effects.variant import Variant
from waferbot_twin.noise_model.prediction_error import Noise
from waferbot_twin.residuals.record import Array, Record


class PriorBlock:
    """Equation (1) for the parameters that a model may have changed (`Variant.deviations`)."""

    def __init__(self, record: Record, names: Sequence[str]) -> None:
        """Take the names of parameters; `record` is any of the logs, of which there is no need."""
        self.record = record
        self.channels = ['usual deviations']
        self.noises = [Noise(1.0, 0, known=True)]
        self._names = tuple(names)

    def times_s(self, channel: str) -> Array:
        """Return zeros: it is known before the log begins."""
        return np.zeros(len(self._names))

    def residuals(self, variant: Variant) -> list[Array]:
        """Return r of every parameter, one channel."""
        return [np.array([variant.deviations.get(name, 0.0) for name in self._names])]
