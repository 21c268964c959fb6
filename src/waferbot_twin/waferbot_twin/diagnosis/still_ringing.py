# SPDX-License-Identifier: Apache-2.0
"""
Compliances beside which the machine rings on.

What gives a little makes the machine ring at one frequency. A wrong one may come near the true one's, at
which it explains some of the ring, in whatever phase suits; the rest of the ring is still there, with
its tone or its line in all logs. So a cause that rings is in doubt while what is left over sounds on its
axis, or on that by whose encoder the cause shows most, in standard deviations of the noise there.

Limits: two parts that ring on one axis, of which one is found, leave that one in doubt, too. A cause
that another one outdoes a little on a second axis is not asked there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from waferbot_twin.estimation.hypothesis import Hypothesis, signature
from waferbot_twin.estimation.stacked_least_squares import by_channel
from waferbot_twin.noise_model.prediction_error import prediction_errors
from waferbot_twin.residuals.problem import PLANT, Cause, Problem


@dataclass(frozen=True)
class StillRinging:
    """A cause that makes the machine ring, which at `frequency_hz` it still does on an axis."""

    cause: Cause
    axis: str
    frequency_hz: float

    def __str__(self) -> str:
        """Say so."""
        return (
            f'{self.cause.name} makes the machine ring, but {self.axis} still rings at '
            f'{self.frequency_hz:.1f} Hz: it may stand in for another part that gives'
        )


def still_ringing(
    problem: Problem, found: Hypothesis, sounding: Mapping[str, float]
) -> list[StillRinging]:
    """Return the causes that ring on an axis that still does; `sounding` has its frequency, Hz."""
    result = []
    for place, cause in enumerate(found.causes):
        if not (sounding and cause.effect.rings):
            continue
        for axis in dict.fromkeys((cause.axis, _shown_on(problem, found, place))):
            if axis in sounding:
                result.append(StillRinging(cause, axis, sounding[axis]))
                break
    return result


def _shown_on(problem: Problem, found: Hypothesis, place: int) -> str:
    """Return the axis by whose encoder a cause shows most."""
    change = signature(problem, found, found.causes, place)[PLANT]
    white = prediction_errors(found.fits[PLANT], by_channel(change, found.residuals[PLANT]))
    shown = [float(np.sum(channel**2)) for channel in white]
    return problem.channels(PLANT)[int(np.argmax(shown))].axis
