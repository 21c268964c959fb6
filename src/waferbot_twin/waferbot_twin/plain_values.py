# SPDX-License-Identifier: Apache-2.0
"""Numbers as reports, tables and JSON have them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any


def finite(value: Any) -> Any:
    """Return plain values as JSON has them: numbers that are not finite become None."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float) and not abs(value) < float('inf'):
        return None
    return value


PLAIN_BELOW = 1e7
"""Numbers below this are written without an exponent: 710, not 7.1e+02."""


def significant(value: float | None, digits: int = 4) -> str:
    """Return a number with so many significant digits; a dash where there is none."""
    if value is None or not abs(value) < float('inf'):
        return '-'
    text = f'{value:.{digits}g}'
    rounded = float(text)
    return f'{rounded:.0f}' if 'e+' in text and abs(rounded) < PLAIN_BELOW else text


def listed(names: Sequence[str]) -> str:
    """Return names in a sentence: "a", "a and b", "a, b and c"."""
    return ' and '.join([*filter(None, [', '.join(names[:-1])]), *names[-1:]])


PREFIXES = ((1.0, ''), (1e3, 'm'), (1e6, 'µ'), (1e9, 'n'), (1e12, 'p'))

PREFIXED = ('m', 'rad', 's', 'N', 'Nm', 'A', 'V')
"""Units that take a prefix, also where others follow them: rad in rad/Nm."""


def with_prefix(largest: float, unit: str) -> tuple[float, str]:
    """
    Return factor and unit with an SI prefix that bring the largest value above 1, as far as it goes.

    Mass goes in g below 0.1 kg; a unit that takes no prefix stays as it is.
    """
    if unit == 'kg':
        return (1e3, 'g') if 0.0 < abs(largest) < 0.1 else (1.0, 'kg')
    if unit.replace('/', ' ').split(' ')[0] not in PREFIXED:
        return 1.0, unit
    if not 0.0 < abs(largest) < math.inf:
        return 1.0, unit
    fitting = [(f, prefix) for f, prefix in PREFIXES if abs(largest) * f >= 1.0]
    factor, prefix = fitting[0] if fitting else PREFIXES[-1]
    return factor, prefix + unit
