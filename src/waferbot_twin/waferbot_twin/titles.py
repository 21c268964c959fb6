# SPDX-License-Identifier: Apache-2.0
"""Axes as they are said."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping


@functools.cache
def _pattern(axes: tuple[str, ...], titles: tuple[str, ...]) -> re.Pattern[str]:
    """Return what finds one of these axes, or a title that stands there already."""
    said = '|'.join(re.escape(title) for title in sorted(titles, key=len, reverse=True))
    already = rf'(?<!\w)(?:{said})(?!\w)|' if said else ''
    return re.compile(rf'{already}\b({"|".join(axes)})\b(\.(?=[a-z]))?')


def with_titles(text: str, titles: Mapping[str, str]) -> str:
    """
    Return a text with axes as they are said: "Y-Linear" for `y_linear`, "Y-Linear force" for
    `y_linear.force`.

    Names that only contain one (`step_y_linear`) stay as they are, and so do titles that contain one.
    """
    others = tuple(title for title in titles.values() if title not in titles)

    def said(found: re.Match[str]) -> str:
        axis, dot = found.groups()
        return titles[axis] + (' ' if dot else '') if axis else found[0]

    return _pattern(tuple(titles), others).sub(said, text)
