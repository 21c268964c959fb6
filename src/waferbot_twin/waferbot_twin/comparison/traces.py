# SPDX-License-Identifier: Apache-2.0
"""One signal as it was measured and as a model has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.metrics import rms

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """
    A signal of an axis, in SI units, at the same times measured and simulated.

    `time_s`, `measured` and `simulated` (n,), finite, n at least 1; `block` is what was simulated alone,
    '' for the closed loop. The residual is measured less simulated.
    """

    axis: str
    kind: str
    unit: str
    block: str
    time_s: Array
    measured: Array
    simulated: Array

    @property
    def name(self) -> str:
        """Axis and kind, as `x_rotate/current`."""
        return f'{self.axis}/{self.kind}'

    @property
    def residual(self) -> Array:
        """Measured less simulated."""
        return self.measured - self.simulated

    def as_dict(self) -> dict[str, Any]:
        """Return what can be said in numbers; the residual's RMS is not taken about its mean."""
        return {
            'axis': self.axis,
            'signal': self.kind,
            'unit': self.unit,
            'block': self.block,
            'samples': len(self.time_s),
            'rms_measured': rms(self.measured),
            'rms_simulated': rms(self.simulated),
            'rms_residual': rms(self.residual),
            'largest_residual': float(np.max(np.abs(self.residual))),
        }


def trace(
    axis: str, kind: str, unit: str, block: str, time_s: Array, measured: Array, simulated: Array
) -> list[Trace]:
    """Return a trace of the samples of which both values are known; none if there are none."""
    known = np.isfinite(measured) & np.isfinite(simulated)
    if not known.any():
        return []
    return [Trace(axis, kind, unit, block, time_s[known], measured[known], simulated[known])]
