# SPDX-License-Identifier: Apache-2.0
"""A record of a recording with our topics."""

from __future__ import annotations

import numpy as np

from waferbot_twin.diagnosis.record import Record
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.response import simulated_responses


def record_of_signals(name: str, twin: Twin, signals: Signals) -> Record:
    """Return what an in-process run would have logged."""
    current = np.column_stack([item.current for item in simulated_responses(twin, signals)])
    mean = 0.5 * (current + np.vstack([current[1:], current[-1:]]))
    return Record(
        name,
        signals.timing,
        mean,
        signals.counts.astype(float),
        np.ascontiguousarray(signals.servo_state[:, :3]),
        signals.current_command.copy(),
    )
