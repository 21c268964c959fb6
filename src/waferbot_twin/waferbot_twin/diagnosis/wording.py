# SPDX-License-Identifier: Apache-2.0
"""
A diagnosis in words: causes as an engineer says them, in units of the user's machine.

A cause is its title, its size on the axis and the axis: "Coulomb friction, 1.5 Nm, 8 % of rated torque
on X-Rotate". Counts become positions, cycles of the controller times, bits of its output currents; a
cosine and a sine become one amplitude. The probability is said as it is; what it reads as is

    beyond doubt    0.95 and above
    likely          0.8 and above
    perhaps         below
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from waferbot_lockstep.timing import Timing
from waferbot_twin.diagnosis.findings import no_findings
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.plain_values import significant, with_prefix
from waferbot_twin.residuals.problem import Cause
from waferbot_twin.validation.gain import AxisGain, gain_of_axes

if TYPE_CHECKING:
    from waferbot_twin.diagnosis.diagnose import Diagnosis, FoundCause

READINGS = ((0.95, 'beyond doubt'), (0.8, 'likely'), (0.0, 'perhaps'))
"""How a probability reads, from which one on."""

LONGEST_SENTENCE = 40
"""Words of the first sentence of a report, at most."""

NO_KNOWN_CAUSE = 'something without a known cause'
"""What a cause may be instead: a force, or small corrections, that nothing in the library stands for."""

BLOCKS = {
    'plant': 'motion of the axis (mechanics)',
    'controller': 'current command of the controller',
    'amplifier': 'voltage of the amplifier',
    'windings': 'current of the motor windings',
    'current loop': 'current of the drive',
}
"""The blocks by what is compared in each."""


@dataclass(frozen=True)
class UserUnit:
    """How values of a parameter are shown: `factor` times the value, `offset` added, in `unit`."""

    factor: float
    unit: str
    offset: float = 0.0

    def of(self, value: float) -> float:
        """Return a value as it is shown."""
        return self.factor * (value + self.offset)

    def text(self, value: float, digits: int = 3) -> str:
        """Return a value with its unit."""
        return f'{significant(self.of(value), digits)} {self.unit}'.rstrip()


def reading(probability: float) -> str:
    """Return what a probability reads as."""
    return next(words for least, words in READINGS if probability >= least)


def probability_text(probability: float) -> str:
    """Return a probability with two decimals; the ends, which rounding would make certain, as bounds."""
    if probability >= 0.995:
        return 'above 0.99'
    if 0.0 < probability < 0.005:
        return 'below 0.01'
    return f'{probability:.2f}'


def percent_text(share: float) -> str:
    """Return a share of 0 to 1 in percent, whole where it is above 1 %."""
    if 0.0 < share < 0.01:
        return 'less than 1 %'
    return f'{100.0 * share:.0f} %'


def user_unit(variant: Variant, axis: str, item: Parameter, value: float) -> UserUnit:
    """
    Return how a parameter is shown on an axis.

    Ratios to the model become a difference from it in percent, other shares percent; what the library
    has in counts, servo interrupts or bits of the controller's output is in m or rad, s or A.
    """
    factor, unit = 1.0, item.unit
    if not unit and item.name == 'ratio':
        return UserUnit(100.0, '%', -1.0)
    if not unit and _is_share(item):
        return UserUnit(100.0, '%')
    if unit == 'counts':
        factor, unit = metres_per_count(variant, axis)
    elif unit == 'servo interrupts':
        factor, unit = 1.0 / Timing().servo_hz, 's'
    elif unit == 'DAC bits':
        factor, unit = places.current_per_bit(variant, axis), 'A'
    elif unit == 'ms':
        factor, unit = 1e-3, 's'
    elif unit == '1/cycle':
        return UserUnit(1.0, 'per electrical cycle')
    prefix, unit = with_prefix(factor * value, unit)
    return UserUnit(factor * prefix, unit)


def _is_share(item: Parameter) -> bool:
    """Return whether a number without a unit is a share; the others are I-variables and orders."""
    return item.name not in ('difference', 'order')


def metres_per_count(variant: Variant, axis: str) -> tuple[float, str]:
    """Return how far an axis goes in a count of its encoder, and the unit of that: m or rad."""
    if places.position_encoder(variant, axis) not in variant.base.description.encoders:
        return 1.0, 'counts'
    return 1.0 / places.axis_counts(variant, axis), places.length_unit(variant, axis)


def title(variant: Variant, cause: Cause) -> str:
    """Return a cause without its size: "backlash on Y-Rotate"."""
    return f'{cause.effect.title} on {variant.titles[cause.axis]}'


def size(variant: Variant, cause: Cause, without: Collection[str] = ()) -> str:
    """
    Return how large a cause is, with units; empty where a number would say nothing.

    Parameters `without` which it is said are those that are no finding (`parameters.no_findings`).
    """
    sizes = [item for item in cause.effect.parameters(variant, cause.axis) if not item.shape]
    items = [item for item in sizes if item.name not in without]
    if not items:
        return ''
    amplitudes = _amplitudes(cause, items)
    if amplitudes:
        largest = max(amplitudes)
        return f'amplitude {user_unit(variant, cause.axis, items[0], largest).text(largest)}'
    if len(sizes) == 1:
        return _single(variant, cause, items[0])
    return ', '.join(
        f'{user_unit(variant, cause.axis, item, cause.values[item.name]).text(cause.values[item.name])} '
        f'{_part(item)}'
        for item in items
    )


def _part(item: Parameter) -> str:
    """Return which part of a cause a parameter is the size of: "forward", "line 1", "along y"."""
    return item.name.replace('offset_', 'along ').replace('_', ' ')


def _amplitudes(cause: Cause, items: Sequence[Parameter]) -> list[float]:
    """Return the amplitude of every harmonic of a cause that has cosines and sines."""
    return [
        math.hypot(cause.values[item.name], cause.values[other])
        for item in items
        if item.name.startswith('cosine')
        and (other := item.name.replace('cosine', 'sine')) in cause.values
    ]


def _single(variant: Variant, cause: Cause, item: Parameter) -> str:
    value = cause.values[item.name]
    shown = user_unit(variant, cause.axis, item, value)
    if item.name == 'ratio':
        side = 'above' if shown.of(value) > 0.0 else 'below'
        return f'{significant(abs(shown.of(value)), 3)} % {side} the model'
    if item.name == 'difference':
        return f'{item.meaning.split()[0]} {value:+.4g}'
    text = shown.text(value)
    percent = _of_rated(variant, cause, item)
    return f'{text}, {percent}' if percent else text


def _of_rated(variant: Variant, cause: Cause, item: Parameter) -> str:
    """Return a force on the axis, or of its motor, in percent of the rated one; else nothing."""
    value, axis = abs(cause.values[item.name]), cause.axis
    at_motor = 'at the motor' in item.meaning
    unit = (places.motor_force_unit if at_motor else places.force_unit)(variant, axis)
    # What holds at most (a belt) is no load of the motor.
    if item.unit != unit or value == 0.0 or item.neutral != 0.0:
        return ''
    rated = (places.rated_motor_force if at_motor else places.rated_force)(variant, axis)
    return f'{significant(100.0 * value / rated, 2)} % of rated {rated_word(item.unit)}'


def rated_word(unit: str) -> str:
    """Return what is rated: force in N, torque in Nm."""
    return 'torque' if unit == 'Nm' else 'force'


def in_words(variant: Variant, cause: Cause, without: Collection[str] = ()) -> str:
    """Return a cause with its size on the axis; what it is said `without` is no finding."""
    told = size(variant, cause, without)
    if not told:
        return title(variant, cause)
    return f'{cause.effect.title}, {told} on {variant.titles[cause.axis]}'


def instead(
    variant: Variant, found: FoundCause, say: Callable[[Variant, Cause], str] = in_words
) -> list[tuple[str, float]]:
    """Return what else a cause may be, in words, and how probable; what is most probable first."""
    others = [(say(variant, item.cause), item.probability) for item in found.alternatives]
    if found.unnamed:
        others.append((NO_KNOWN_CAUSE, found.unnamed))
    return sorted(others, key=lambda item: -item[1])


def capital(text: str) -> str:
    """Return a text with a capital letter first."""
    return text[:1].upper() + text[1:]


def sentence(diagnosis: Diagnosis) -> str:
    """
    Return in at most `LONGEST_SENTENCE` words what explains most of the error and how sure that is.

    The share of the error explained, the probability and what stays unexplained are always said. What
    does not fit of the rest (the size, what else it may be, how many other causes, how much of the error
    is left in validation data) is left to the tables.
    """
    left = _left_over(diagnosis)
    if not diagnosis.causes:
        may_be = _possible(diagnosis)
        if not diagnosis.unexplained:
            several = (*diagnosis.corrections, *diagnosis.accelerations)
            corrected = any(not item.low <= item.nominal <= item.high for item in several)
            model = 'With small corrections the model' if corrected else 'The model'
            none = 'explains these logs: no cause and nothing unexplained was found'
            return f'{model} {none}{may_be}.'
        return f'No known cause explains these logs: {left}{may_be}.'
    first = diagnosis.causes[0]
    left_there = _left_in_validation(diagnosis.gains)
    rest = _more(diagnosis, and_possible=False) + left_there
    all_others = _more(diagnosis) + left_there
    wordings: list[Callable[[], str]] = [
        lambda: _first(diagnosis, first, True) + _other(diagnosis, first) + all_others,
        lambda: _first(diagnosis, first, True) + _other(diagnosis, first) + rest,
        lambda: _first(diagnosis, first, True) + rest,
        lambda: _first(diagnosis, first, False) + rest,
        lambda: _first(diagnosis, first, False) + left_there,
        lambda: _first(diagnosis, first, False),
    ]
    for wording in wordings:
        text = wording() + (f'; {left}.' if left else '.')
        if len(text.split()) <= LONGEST_SENTENCE:
            break
    return text


def _possible(diagnosis: Diagnosis) -> str:
    """Return what is possible, but not so sure that it is named."""
    if not diagnosis.possible:
        return ''
    first = diagnosis.possible[0]
    may_be = title(diagnosis.nominal, first.cause)
    return f'; {may_be} is possible (probability {probability_text(first.probability)})'


def _first(diagnosis: Diagnosis, first: FoundCause, with_size: bool) -> str:
    cause = first.cause
    told = size(diagnosis.nominal, cause, no_findings(first)) or _why_none(first)
    told = told if with_size else ''
    what = capital(title(diagnosis.nominal, cause)) + (f' ({told})' if told else '')
    return (
        f'{what} explains {percent_text(first.share)} of the error there, '
        f'{reading(first.probability)} (probability {probability_text(first.probability)})'
    )


def _why_none(first: FoundCause) -> str:
    """Return why a cause has no size to tell, nothing where it needs none."""
    return 'its size is not told by these logs' if no_findings(first) else ''


def _other(diagnosis: Diagnosis, first: FoundCause) -> str:
    if first.probability >= READINGS[0][0]:
        return ''
    others = instead(diagnosis.nominal, first, title)
    return f'; else {others[0][0]}' if others else ''


def _more(diagnosis: Diagnosis, and_possible: bool = True) -> str:
    """Return how many causes have a name beside the first one, and how many are only possible."""
    more = len(diagnosis.causes) - 1
    possible = len(diagnosis.possible) if and_possible else 0
    if not more:
        return f'; {possible} more possible' if possible else ''
    return f'; {more} more named' + (f', {possible} possible' if possible else '')


def _left_in_validation(gains: Sequence[AxisGain]) -> str:
    """Return how much of the RMS error is left in validation data, on the best and the worst axis."""
    shares = sorted(100.0 - axis['improvement_percent'] for axis in gain_of_axes(gains).values())
    if not shares:
        return ''
    low, high = (percent_text(0.01 * share) for share in (shares[0], shares[-1]))
    how_much = high if low == high else f'{low.removesuffix(" %")} to {high}'
    return f'; in validation data {how_much} of the RMS error is left'


def _left_over(diagnosis: Diagnosis) -> str:
    if not diagnosis.unexplained:
        return ''
    axes = dict.fromkeys(diagnosis.nominal.titles[item.axis] for item in diagnosis.unexplained)
    return f'something on {" and ".join(axes)} stays unexplained'


def interval_text(
    found: FoundCause, item: Parameter, shown: UserUnit, ends: tuple[float, float] | None
) -> str:
    """Return an interval of a parameter as it is shown; how the value came about where it has none."""
    if ends is None:
        return 'chosen from a few' if item.name in found.cause.held else 'interval not known'
    low, high = sorted(shown.of(end) for end in ends)
    return f'{significant(low)} to {significant(high)} {shown.unit}'.rstrip()


def way_text(way: float, unit: str) -> str:
    """Return a way along an axis: in mm (µm below 0.1 mm), or in turns with how often that is a turn."""
    if unit == 'm':
        return f'{significant(1e6 * way)} µm' if way < 1e-4 else f'{significant(1e3 * way)} mm'
    turns = way / (2.0 * math.pi)
    text = f'{significant(turns)} turn{"" if math.isclose(turns, 1.0) else "s"}'
    return text if turns >= 0.999 else f'{text} ({significant(1.0 / turns)} a turn)'
