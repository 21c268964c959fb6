# SPDX-License-Identifier: Apache-2.0
"""
What `counts_per_unit` is per: metres of an axis that slides, radians of one that turns.

A controller has no use for it: its axis definition statement is a number. It is known so that an
experiment, or a compensation table, that is in the wrong one is refused. Who knows the machine tells it
(`Description.axis_units`); where nobody does, it is as on the shipped machine, `USUAL_UNITS`. The node
takes it as text, in the order of the axes: `m rad rad`.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_lockstep.contract import AXES, USUAL_UNITS
from waferbot_lockstep.errors import UserError

Units = Mapping[str, str]
"""`m` or `rad` by axis."""


def units_text(units: Units = USUAL_UNITS) -> str:
    """Return units as the parameter `units` of the node takes them."""
    return ' '.join(units[axis] for axis in AXES)


def parse_units(text: str) -> Units:
    """Return units from the text of the node's parameter; raises `UserError`."""
    given = text.split()
    if len(given) != len(AXES) or not set(given) <= {'m', 'rad'}:
        raise UserError(
            f'parameter units is {text!r}; it must say m or rad of {", ".join(AXES)}, in this order: '
            f'{units_text()!r}'
        )
    return dict(zip(AXES, given, strict=True))
