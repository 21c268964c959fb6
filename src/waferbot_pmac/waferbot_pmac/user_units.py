# SPDX-License-Identifier: Apache-2.0
"""
What `counts_per_unit` is per: metres of an axis that slides, radians of one that turns.

A controller has no use for it: its axis definition statement is a number. It is known so that an
experiment, or a compensation table, that is in the wrong one is refused. Who knows the machine tells it
(`Description.axis_units`); where nobody does, it is as on the shipped machine, `USUAL_UNITS`. The node
takes it as text, in the order of the machine's axes: `m rad rad`. Units name all axes that there are.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_lockstep.contract import USUAL_UNITS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout

Units = Mapping[str, str]
"""`m` or `rad` by axis, in the order of the axes."""


def units_text(units: Units = USUAL_UNITS) -> str:
    """Return units as the parameter `units` of the node takes them."""
    return ' '.join(units.values())


def usual_units(layout: Layout = SHIPPED) -> Units:
    """Return the units of a machine of which nobody tells: those of the shipped one, else rad."""
    return {axis: USUAL_UNITS.get(axis, 'rad') for axis in layout.axes}


def parse_units(text: str, layout: Layout = SHIPPED) -> Units:
    """Return units from the text of the node's parameter; raises `UserError`."""
    given, axes = text.split(), layout.axes
    if len(given) != len(axes) or not set(given) <= {'m', 'rad'}:
        raise UserError(
            f'parameter units is {text!r}; it must say m or rad of {", ".join(axes)}, in this order: '
            f'{units_text(usual_units(layout))!r}'
        )
    return dict(zip(axes, given, strict=True))
