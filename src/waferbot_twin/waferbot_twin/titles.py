# SPDX-License-Identifier: Apache-2.0
"""Axes as they are said."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping


@functools.cache
def _pattern(axes: tuple[str, ...]) -> re.Pattern[str]:
    """Return what finds one of these axes."""
    return re.compile(rf'\b({"|".join(axes)})\b(\.(?=[a-z]))?')


def with_titles(text: str, titles: Mapping[str, str]) -> str:
    """
    Return a text with axes as they are said: "Y-Linear" for `y_linear`, "Y-Linear force" for
    `y_linear.force`.

    Names that only contain one (`step_y_linear`) stay as they are.
    """
    pattern = _pattern(tuple(titles))
    return pattern.sub(lambda found: titles[found[1]] + (' ' if found[2] else ''), text)
