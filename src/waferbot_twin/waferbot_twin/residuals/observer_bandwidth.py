# SPDX-License-Identifier: Apache-2.0
"""
How fast the observer of a log is: as fast as predicts its readings best.

The Kalman filter of a mass that white forces accelerate with an intensity q, and of which readings have
noise of an intensity r, has

    w = (q / r)^(1/4),    damping 1 / sqrt(2).                                                     (1)

Neither is known, and what a model lacks counts as q: a nominal model has to be held by a faster one than
the true one. So the frequency is that of some octaves with which a model's innovations have the least
mean square, as maximum likelihood has it.

For a linear machine it does not matter: whitening takes out what the observer was. A machine with dry
friction is none. What noise of readings turns an observer by, friction stops at rest and does not in
motion, so innovations have two colours; a model with a soft friction, or another one near rest, has
less of the one, and leaves less over by the observer alone. Cogging of (-251, 215) mNm in a log of
another simulator, with noise of a third of a count (seed 235, number 11): held with 80 Hz it is found as
(-231, 233) mNm with harmonics that are not there, and a presliding friction beside it gains 28 in ln L;
with 20 Hz as (-248, 215) mNm, and presliding gains nothing.

Source: B. Anderson, J. Moore, Optimal Filtering, 1979. Limit: one frequency for a whole log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.residuals.plant_block import OBSERVER_HZ, PlantBlock
from waferbot_twin.residuals.record import Record

LEAST_CYCLES = 16.0
"""Cycles of an observer in a log at least: it settles in a tenth of that (`plant_block`)."""


def with_observers(records: Sequence[Record], nominal: Variant, variant: Variant) -> list[Record]:
    """
    Return logs with the frequency of the observer of each encoder with which a variant predicts best.

    No more than before, by default that of the plant's residual. `nominal` is the model that the logs
    are compared with. A log in which the variant does not run stays as it is.
    """
    return [_with_observer(record, nominal, variant) for record in records]


def _with_observer(record: Record, nominal: Variant, variant: Variant) -> Record:
    least_hz = LEAST_CYCLES / (record.duration_s - record.judged_from_s)
    octaves_hz = [OBSERVER_HZ]
    while 0.5 * octaves_hz[-1] >= least_hz:
        octaves_hz.append(0.5 * octaves_hz[-1])
    blocks = [PlantBlock(record, nominal, frequency_hz) for frequency_hz in octaves_hz]
    try:
        errors = [block.innovations(variant) for block in blocks]
    except UserError:
        return record
    found = list(record.observer_hz or (OBSERVER_HZ,) * len(record.layout.encoders))
    for place, channel in enumerate(blocks[0].channels):
        if blocks[0].on_held[place]:  # no observer moves it
            continue
        # The slowest settles last: all are judged where it is.
        times = [block.times_s(channel) for block in blocks]
        if not len(times[-1]):  # gaps follow one another too quickly
            continue
        squares = [
            float(np.mean(error[place][np.isin(own, times[-1])] ** 2))
            for error, own in zip(errors, times, strict=True)
        ]
        best_hz = octaves_hz[int(np.argmin(squares))]
        encoder = record.layout.encoder_place(channel)
        found[encoder] = min(found[encoder], best_hz)
    return replace(record, observer_hz=tuple(found))
