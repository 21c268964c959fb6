# SPDX-License-Identifier: Apache-2.0
"""What the command shows of a cause decides whether noise may have feigned it."""

from __future__ import annotations

import pytest

from waferbot_twin.diagnosis.confirmation import ByCommand, _too_little


@pytest.mark.parametrize(
    ('gains', 'too_little'),
    [
        (((34.0, 560.0), (14.0, 433.0)), True),  # a sensor's gain of -50 % that noise feigned
        (((6.0, 19.0), (87.0, 214.0)), True),
        (((699.0, 700.0), (591.0, 618.0)), False),
        (((105.0, 158.0), (30.0, 69.0)), False),
        (((2.0, 16.0), (0.0, 0.0)), False),  # by four standard deviations at most
        (((-1.0, 0.0), (0.0, 0.0)), False),
    ],
)
def test_currents_must_show_what_they_should(gains, too_little):
    logs = [ByCommand(0.0, 0.0, gain, expected) for gain, expected in gains]
    assert _too_little(*logs) is too_little


def test_what_the_plant_shows_does_not_count_as_currents():
    assert not _too_little(ByCommand(100.0, 320.0))
