# SPDX-License-Identifier: Apache-2.0
"""Axes as they are said."""

from __future__ import annotations

import re
from collections.abc import Mapping

from waferbot_lockstep.contract import AXES

_AXIS = re.compile(rf'\b({"|".join(AXES)})\b(\.(?=[a-z]))?')


def with_titles(text: str, titles: Mapping[str, str]) -> str:
    """
    Return a text with axes as they are said: "Y-Linear" for `y_linear`, "Y-Linear force" for
    `y_linear.force`.

    Names that only contain one (`step_y_linear`) stay as they are.
    """
    return _AXIS.sub(lambda found: titles[found[1]] + (' ' if found[2] else ''), text)
