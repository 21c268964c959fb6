# SPDX-License-Identifier: Apache-2.0
"""
Which parameters of a cause are a finding, and how far their intervals reach.

A cosine and a sine are one amplitude, A = sqrt(c^2 + s^2). Its error follows by propagation,
dA = sqrt((c dc)^2 + (s ds)^2) / A, the correlation of both left out.

A value is no finding in two cases:

- it lies on a bound of what is physically possible: the fit would have gone on;
- its 95 % interval is as long, to one side, as the value itself (a size counts from where there is
  nothing of the effect, a shape from zero): the logs do not tell it.

Intervals end where what is possible ends.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from waferbot_twin.effects.effect import Parameter

if TYPE_CHECKING:
    from waferbot_twin.diagnosis.diagnose import FoundCause

ON_BOUND = 1e-6
"""Distance from a bound, over all that is possible, within which a value lies on it."""

NOT_TOLD = 'the logs do not tell it'
AT_BOUND = 'on its bound: no finding'


def within_bounds(found: FoundCause, item: Parameter) -> tuple[float, float] | None:
    """Return the 95 % interval of a parameter as far as it is possible; None where it has none."""
    if item.name not in found.intervals_95:
        return None
    low, high = sorted(found.intervals_95[item.name])
    value = found.cause.values[item.name]
    return min(max(low, item.low), value), max(min(high, item.high), value)


def on_bound(found: FoundCause, item: Parameter) -> bool:
    """Return whether a fitted parameter lies on a bound of what is physically possible."""
    name = item.name
    return name not in found.cause.held and lies_on_bound(item, found.cause.values[name])


def lies_on_bound(item: Parameter, value: float) -> bool:
    """Return whether a value is as small or as large as a parameter can be."""
    near = ON_BOUND * (item.high - item.low)
    return min(abs(value - item.low), abs(value - item.high)) <= near


def is_told(found: FoundCause, item: Parameter) -> bool:
    """Return whether the logs tell a parameter: its interval is shorter than itself."""
    interval = within_bounds(found, item)
    if interval is None:
        return True
    value = found.cause.values[item.name]
    reach = max(value - interval[0], interval[1] - value)
    return reach < abs(value - (0.0 if item.shape else item.neutral))


def no_findings(found: FoundCause) -> frozenset[str]:
    """Return the names of the parameters of a cause that are no finding."""
    return frozenset(item.name for item in found.parameters if remark_of(found, item))


def remark_of(found: FoundCause, item: Parameter) -> str:
    """Return why a parameter is no finding, or nothing; of a cosine or a sine that of the amplitude."""
    cosine = cosine_of(found, item) or item
    sine = sine_of(found, cosine)
    if sine is None:
        return AT_BOUND if on_bound(found, item) else '' if is_told(found, item) else NOT_TOLD
    if on_bound(found, cosine) or on_bound(found, sine):
        return AT_BOUND
    size, reach = amplitude(found, cosine, sine)
    return '' if reach is None or reach < size else NOT_TOLD


def value_of(found: FoundCause, item: Parameter) -> float:
    """Return the value of a parameter."""
    return float(found.cause.values[item.name])


def cosine_of(found: FoundCause, item: Parameter) -> Parameter | None:
    """Return the cosine that belongs to a sine, if there is one."""
    return next((one for one in found.parameters if sine_of(found, one) == item), None)


def sine_of(found: FoundCause, item: Parameter) -> Parameter | None:
    """Return the sine that belongs to a cosine, if there is one."""
    if not item.name.startswith('cosine'):
        return None
    name = item.name.replace('cosine', 'sine')
    return next((one for one in found.parameters if one.name == name), None)


def amplitude(found: FoundCause, cosine: Parameter, sine: Parameter) -> tuple[float, float | None]:
    """Return the amplitude of a cosine and a sine, and how far its interval reaches to either side."""
    c, s = value_of(found, cosine), value_of(found, sine)
    size = math.hypot(c, s)
    ends = [found.intervals_95.get(item.name) for item in (cosine, sine)]
    if ends[0] is None or ends[1] is None:
        return size, None
    reaches = [0.5 * abs(high - low) for low, high in (ends[0], ends[1])]
    if size == 0.0:
        return size, max(reaches)
    return size, math.hypot(c * reaches[0], s * reaches[1]) / size
