# SPDX-License-Identifier: Apache-2.0
"""What readings say themselves of an encoder's resolution."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from waferbot_twin.diagnosis.proposals.coarseness import coarser_steps
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model


def test_steps_of_readings_are_seen_and_small_ranges_are_not():
    nominal = Variant.of(load_model('rigid'))
    random = np.random.default_rng(3)
    reading = random.integers(-500, 500, (2000, 4)).astype(float)
    reading[:, 1] *= 6.0
    reading[:, 2] = 4.0 * (reading[:, 2] > 0.0)  # two values say nothing about what lies between
    records = [SimpleNamespace(reading=reading)]
    assert coarser_steps(nominal, records) == {'x_rotate': 6.0}
    coarse = find('coarse_quantisation').apply(nominal, 'x_rotate', {'step': 6.0})
    assert coarser_steps(coarse, records) == {}
    reading[0, 1] += 1.0
    assert coarser_steps(nominal, records) == {}
