# SPDX-License-Identifier: Apache-2.0
"""Calibration begun at values of one's own: what a file says counts, the rest is as shipped."""

from __future__ import annotations

from pathlib import Path

import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.calibration.values import CALIBRATED, calibrated, started_from


def file(folder: Path, text: str) -> Path:
    path = folder / 'start.yaml'
    path.write_text(text, 'utf-8')
    return path


def test_shipped_values_start_from_the_shipped_file() -> None:
    start = started_from(CALIBRATED)
    assert start['payload'] | start['y_rotate'] == calibrated()
    assert start['as_built_payload'] == calibrated('as_built_payload')


def test_a_file_may_say_a_part(tmp_path: Path) -> None:
    start = started_from(
        file(tmp_path, 'as_built_payload: {ring_mass_kg: 4, cable_loss_factor: 0.1}')
    )
    shipped = calibrated('as_built_payload')
    assert start['as_built_payload'] == {
        **shipped, 'ring_mass_kg': 4.0, 'cable_loss_factor': 0.1,
    }  # fmt: skip
    assert start['as_built_y_rotate'] == calibrated('as_built_y_rotate')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('paylod: {}', "line 1.*did you mean 'payload'"),
        ('payload:\n  carriage_mas_kg: 3', "line 2.*did you mean 'carriage_mass_kg'"),
        ('payload:\n  carriage_mass_kg: heavy', "line 2.*'heavy'; it must be a number"),
        ('payload: 3', 'must be a mapping of values'),
    ],
)
def test_what_is_wrong_in_a_file_is_said_with_its_line(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(UserError, match=message):
        started_from(file(tmp_path, text))
