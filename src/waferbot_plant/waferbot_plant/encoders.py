# SPDX-License-Identifier: Apache-2.0
"""
Encoders: position to whole counts, rounded down, some phase cycles late.

The thesis (chapter 4) multiplies the position by the counts per unit, rounds down, and passes the
count through a unit delay at the phase rate, because feedback over the MACRO ring is always that
of the previous cycle. So at an encoder tick (every `encoder_divider` ticks) the published counts
are those read `encoder_delay` encoder ticks before. No noise, no index error, no interpolation
error.
"""

from __future__ import annotations

import numpy as np

from waferbot_lockstep.compiled import compiled

ENCODERS = 4
"""Places for encoders in the contract."""

LONGEST_DELAY = 15
"""Longest delay that the history of readings can hold, in phase cycles."""

PARAMETER_FIELDS: list[tuple] = [
    ('encoder_coordinate', 'i8', (ENCODERS,)),
    ('counts_per_unit', 'f8', (ENCODERS,)),
    ('encoder_divider', 'i8'),
    ('encoder_delay', 'i8'),
]
"""`counts_per_unit` is counts per m or rad of the minimal coordinate; zero where there is none."""

STATE_FIELDS: list[tuple] = [('readings', 'i8', (LONGEST_DELAY + 1, ENCODERS))]
"""The last readings, in counts, the newest at place (tick / divider) mod 16."""


@compiled
def read_encoder(p, position, encoder):
    """Return the whole counts of one encoder at `position` (n,) of the minimal coordinates."""
    coordinate = p['encoder_coordinate'][encoder]
    return np.int64(np.floor(p['counts_per_unit'][encoder] * position[coordinate]))


@compiled
def measure_counts(s, p, tick, counts):
    """
    Read the encoders if `tick` is an encoder tick, and publish the delayed counts into `counts`
    (4,).

    Between encoder ticks `counts` is left as it is.
    """
    if tick % p['encoder_divider'] != 0:
        return
    reading = tick // p['encoder_divider']
    newest = reading % (LONGEST_DELAY + 1)
    published = (reading - p['encoder_delay']) % (LONGEST_DELAY + 1)
    for encoder in range(ENCODERS):
        s['readings'][newest, encoder] = read_encoder(p, s['position'], encoder)
        counts[encoder] = s['readings'][published, encoder]
