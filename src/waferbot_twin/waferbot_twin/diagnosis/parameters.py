# SPDX-License-Identifier: Apache-2.0
"""
The parameters of a cause as an engineer reads them, in the units of the user's machine.

A cosine and a sine are one amplitude; what repeats along the way says after how much of it, in mm or
turns. What is no finding says why (`findings`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from waferbot_twin.diagnosis.findings import (
    amplitude,
    cosine_of,
    remark_of,
    sine_of,
    value_of,
    within_bounds,
)
from waferbot_twin.diagnosis.wording import (
    UserUnit,
    interval_text,
    user_unit,
    way_text,
)
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant

if TYPE_CHECKING:
    from waferbot_twin.diagnosis.diagnose import FoundCause


@dataclass(frozen=True)
class ParameterText:
    """A parameter in words: what it is, its value and interval with units; `remark` if no finding."""

    label: str
    meaning: str
    value: str
    interval: str
    remark: str = ''


def parameter_texts(nominal: Variant, found: FoundCause) -> list[ParameterText]:
    """Return every parameter of a cause in the user's units, and after what way the cause repeats."""
    return [*_rows(nominal, found), *_repeats(nominal, found)]


def _rows(nominal: Variant, found: FoundCause) -> Iterator[ParameterText]:
    repeats = bool(_way(nominal, found))
    for item in found.parameters:
        if cosine_of(found, item) is not None or (repeats and item.name in ('order', 'period')):
            continue
        sine = sine_of(found, item)
        if sine is not None:
            yield _amplitude_row(nominal, found, item, sine)
            continue
        value, ends = value_of(found, item), within_bounds(found, item)
        shown = user_unit(nominal, found.cause.axis, item, value)
        yield ParameterText(
            _label(item), _meaning(item), shown.text(value, 4),
            interval_text(found, item, shown, ends), remark_of(found, item),
        )  # fmt: skip


def _label(item: Parameter) -> str:
    if item.name == 'ratio':
        return 'difference from the model'
    if item.name == 'difference':  # of an I-variable
        return f'{item.meaning.split()[0]}, more than in the model'
    return item.name.replace('_', ' ')


def _meaning(item: Parameter) -> str:
    """Return what a parameter is, where its label does not say it."""
    return '' if item.name in ('ratio', 'difference') else item.meaning.replace('_', ' ')


def _amplitude_row(
    nominal: Variant, found: FoundCause, cosine: Parameter, sine: Parameter
) -> ParameterText:
    size, reach = amplitude(found, cosine, sine)
    shown = user_unit(nominal, found.cause.axis, cosine, size)
    ends = None if reach is None else (max(size - reach, 0.0), size + reach)
    which = cosine.meaning.split('cosine', 1)[1].strip(' ,')
    label = f'amplitude {which}' if which.startswith('of ') else 'amplitude'
    return ParameterText(
        label, '' if which.startswith('of ') else which, shown.text(size, 4),
        interval_text(found, cosine, shown, ends), remark_of(found, cosine),
    )  # fmt: skip


def _way(nominal: Variant, found: FoundCause) -> float:
    """Return after what way (m, rad of the axis) a cause repeats, 0 if it does not."""
    cause = found.cause
    return float(cause.effect.repeats_after(nominal, cause.axis, cause.values))


def _repeats(nominal: Variant, found: FoundCause) -> Iterator[ParameterText]:
    """Return after what way of its axis a cause repeats, with the interval of its order or period."""
    way, unit = _way(nominal, found), places.length_unit(nominal, found.cause.axis)
    if not way:
        return
    item = next((one for one in found.parameters if one.name in ('order', 'period')), None)
    interval = ''
    if item is not None:
        ends, value = within_bounds(found, item), value_of(found, item)
        interval = interval_text(found, item, UserUnit(1.0, ''), None)
        if ends is not None and min(ends) > 0.0:
            shares = (value / end if item.name == 'order' else end / value for end in ends)
            interval = ' to '.join(way_text(way * share, unit) for share in sorted(shares))
    yield ParameterText('repeats after', '', way_text(way, unit), interval)
