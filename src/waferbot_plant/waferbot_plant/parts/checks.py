# SPDX-License-Identifier: Apache-2.0
"""Checks of part data at the door; each raises `UserError` with the name and the value."""

from __future__ import annotations

import math

from waferbot_lockstep.errors import UserError

STANDARD_GRAVITY_M_PER_S2 = 9.80665
"""Standard acceleration of gravity (ISO 80000-3), in m/s2."""


def require_finite(value: float, name: str) -> None:
    """Raise `UserError` unless `value` is a finite number."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value):
        raise UserError(f'{name} is {value!r}; give a finite number.')


def require_positive(value: float, name: str) -> None:
    """Raise `UserError` unless `value` is a finite number above zero."""
    require_finite(value, name)
    if value <= 0.0:
        raise UserError(f'{name} is {value!r}; it must be greater than zero.')


def require_not_negative(value: float, name: str) -> None:
    """Raise `UserError` unless `value` is a finite number, zero or above."""
    require_finite(value, name)
    if value < 0.0:
        raise UserError(f'{name} is {value!r}; it must not be negative.')


def require_fraction(value: float, name: str) -> None:
    """Raise `UserError` unless `value` lies strictly between 0 and 1."""
    require_finite(value, name)
    if not 0.0 < value < 1.0:
        raise UserError(f'{name} is {value!r}; it must lie between 0 and 1, both excluded.')
