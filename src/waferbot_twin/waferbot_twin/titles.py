# SPDX-License-Identifier: Apache-2.0
"""Axes as they are said."""

from __future__ import annotations

import re

from waferbot_twin.plot import TITLES


def with_titles(text: str) -> str:
    """
    Return a text with axes as they are said: "Y-Linear" for `y_linear`, "Y-Linear force" for
    `y_linear.force`.

    Names that only contain one (`step_y_linear`) stay as they are.
    """
    for axis, said in TITLES.items():
        text = re.sub(rf'\b{axis}\.(?=[a-z])', f'{said} ', text)
        text = re.sub(rf'\b{axis}\b', said, text)
    return text
