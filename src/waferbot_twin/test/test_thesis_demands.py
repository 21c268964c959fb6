# SPDX-License-Identifier: Apache-2.0
"""What the rows of the thesis' tables demand, held to the words that the demands come from."""

from __future__ import annotations

import pytest

from waferbot_twin.thesis import (
    RMS_TOLERANCE,
    improvement_admits,
    run_time_admits,
    thesis,
)


@pytest.mark.parametrize(
    ('printed', 'ours', 'met'),
    [
        (69.6, 0.1, True),
        (69.6, -0.1, False),
        (-78.02, -0.1, True),
        (-78.02, 42.7, False),
        (0.0, 9.9, True),
        (0.0, -9.9, True),
        (0.0, -10.1, False),
        (1.04, float('nan'), False),
        (0.0, float('nan'), False),
    ],
)
def test_an_improvement_has_the_sign_of_the_thesis(printed: float, ours: float, met: bool) -> None:
    assert improvement_admits(printed, ours) is met


def test_the_thesis_meets_its_own_demands() -> None:
    for steps in thesis()['steps'].values():
        for figure, percent in steps['improvement'].items():
            assert improvement_admits(percent, percent), figure
        times = steps['run_time']
        for model, ratio in times.items():
            assert run_time_admits(model, ratio, times['flexible'])
        for model in ('rigid', 'flexible'):
            printed = steps[model]['rms_error']['printed']
            assert RMS_TOLERANCE.admits(printed, printed)


@pytest.mark.parametrize(
    ('model', 'ratio', 'flexible', 'met'),
    [
        ('flexible', 1.21, 1.21, True),
        ('flexible', 1.19, 1.19, False),
        ('simplified', 1.5, 2.0, True),
        ('simplified', 2.1, 2.0, False),
        ('simplified', 0.9, 2.0, False),
    ],
)
def test_run_times_are_in_the_order_of_the_text(
    model: str, ratio: float, flexible: float, met: bool
) -> None:
    assert run_time_admits(model, ratio, flexible) is met


def test_an_rms_error_may_be_off_by_fifteen_percent() -> None:
    assert RMS_TOLERANCE.admits(2.0e-5, 2.29e-5)
    assert not RMS_TOLERANCE.admits(2.0e-5, 2.31e-5)
