# SPDX-License-Identifier: Apache-2.0
"""
How well the estimation data predict the validation data, with a cause and without it.

With E the estimation data, V the validation data and M a set of causes, values unknown,

    P(V | E, M) = P(E, V | M) / P(E | M),                                                          (1)

so that the ratio of two predictions is that of two Bayes factors, of all logs and of the estimation
data alone (`estimation.evidence`). What the estimation data do not tell of a value, and what the others
are without the cause, counts in both: a true cause whose value they tell badly is not to blame for it.
"""

from __future__ import annotations

from waferbot_twin.diagnosis.inference.refit import with_last, without
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.estimation.evidence import log_evidence
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.problem import Problem


class Prediction:
    """Causes fitted to all logs, and to the estimation data alone."""

    def __init__(
        self,
        of_all: tuple[Problem, Hypothesis],
        of_estimation: tuple[Problem, Hypothesis],
        settings: Settings,
        workers: int = 1,
    ) -> None:
        """Take logs with the same causes fitted to them."""
        self._fits = of_all, of_estimation
        self._settings, self._workers = settings, workers
        self._known: dict[str, float] = {}

    def log_ratio(self, name: str) -> float:
        """Return ln of the ratio of equation (1) with the cause of that name to that without."""
        if name not in self._known:
            of_all, of_estimation = (self._log_evidence(*one, name) for one in self._fits)
            self._known[name] = of_all - of_estimation
        return self._known[name]

    def _log_evidence(self, problem: Problem, found: Hypothesis, name: str) -> float:
        base = without(problem, found, [name], self._workers)
        more = with_last(problem, found, name)
        return log_evidence(problem, more, base, self._settings.prior_scales)
