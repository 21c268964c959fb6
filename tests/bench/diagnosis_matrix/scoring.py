# SPDX-License-Identifier: Apache-2.0
"""
What a diagnosis got right: its report against the truth.

A report is `report.json` as a reader of the file has it. `inseparable` tells whether the logs cannot
tell the reported causes from the true ones, as found by simulating both; only then does a cause
that is in a reported credible set, of at most three, count as named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from waferbot_lockstep.timing import Timing
from waferbot_twin.effects.effect import Parameter

LARGEST_GROUP = 3
TWIN = 'twin'
"""Outcome of an unknown effect that another one explains, which the logs cannot tell from it."""

SURE = 0.9
"""Probability above which a report calls a cause very likely."""

Report = Mapping[str, Any]


def name_of(cause: Mapping[str, Any]) -> str:
    """Return `effect:axis` of a reported cause."""
    return f'{cause["effect"]}:{cause["axis"]}'


def others_of(cause: Mapping[str, Any]) -> list[str]:
    """Return the other members of a reported cause's credible set, the most probable first."""
    return [one for one in map(name_of, cause['credible_set']) if one != name_of(cause)]


def names(cause: Mapping[str, Any], truth: str, inseparable: bool) -> bool:
    """Return whether a reported cause names the truth, itself or in a group that is allowed."""
    if name_of(cause) == truth:
        return True
    group = [name_of(cause), *others_of(cause)]
    return inseparable and truth in group and len(group) <= LARGEST_GROUP


def outcome_of_nothing(report: Report) -> str:
    """Return `right`, `false alarm` (a cause is named) or `unexplained` for a log without an effect."""
    if report['causes']:
        return 'false alarm'
    return 'right' if report['verdict'] == 'consistent' else 'unexplained'


def outcome_of_single(report: Report, truth: str, inseparable: bool) -> str:
    """
    Return what became of one hidden effect.

    `right`, `group` (in an allowed group of the first cause), `later` (named, but not first), `axis`
    (right effect, wrong axis), `wrong`, `unexplained`, `withdrawn`, `missed`. The first two count as
    named.
    """
    if not report['causes']:
        if report['withdrawn']:
            return 'withdrawn'
        return 'unexplained' if report['unexplained'] else 'missed'
    first, *others = report['causes']
    if name_of(first) == truth:
        return 'right'
    if names(first, truth, inseparable):
        return 'group'
    if any(names(cause, truth, inseparable) for cause in others):
        return 'later'
    return 'axis' if first['effect'] == truth.split(':')[0] else 'wrong'


def outcome_of_two(report: Report, truths: Sequence[str], inseparable: bool) -> str:
    """
    Return what became of two hidden effects.

    `both`, `one`, `none`, with ` and a false one` if other causes are named too; `false in place` if one
    false cause stands for both; `withdrawn` if nothing is left of what was found.
    """
    hits = [
        any(names(cause, truth, inseparable) for cause in report['causes']) for truth in truths
    ]
    false = [
        cause
        for cause in report['causes']
        if not any(names(cause, truth, inseparable) for truth in truths)
    ]
    if not any(hits):
        return 'false in place' if false else 'withdrawn' if report['withdrawn'] else 'none'
    return ('both' if all(hits) else 'one') + (' and a false one' if false else '')


def outcome_of_unknown(report: Report, truth: str, inseparable: bool) -> str:
    """
    Return what became of an effect that is not in the library.

    `right` (something is left unexplained on its axis), `other axis`, `twin` (explained by another
    effect that the logs cannot tell from it), `wrong`, `missed`.
    """
    axis = truth.split(':')[1]
    unexplained = [item['axis'] for item in report['unexplained']]
    if axis in unexplained:
        return 'right'
    if report['causes']:
        return TWIN if inseparable else 'wrong'
    return 'other axis' if unexplained else 'missed'


def wrong_and_sure(report: Report, outcome: str) -> bool:
    """Return whether a wrong name comes first, with high probability."""
    wrong = outcome in ('wrong', 'axis', 'later', 'false alarm')
    return wrong and report['causes'][0]['probability'] > SURE


@dataclass(frozen=True)
class ParameterError:
    """
    How well a parameter was found.

    `error` is relative; of a delay it is in its own samples. `covered` tells whether the 95 % interval
    holds the truth, None if the report gives no interval.
    """

    name: str
    kind: str
    truth: float
    found: float
    error: float
    covered: bool | None


def parameter_errors(
    cause: Mapping[str, Any],
    truth: Mapping[str, float],
    parameters: Sequence[Parameter],
    inertia: float,
) -> list[ParameterError]:
    """
    Return the errors of the parameters of a cause that was named right.

    Relative to what is meant: of a ratio (a gain) to the ratio, of a mass or inertia that is added to
    the whole `inertia` that moves, of a delay in its samples, of anything else to its distance from
    neutral. A parameter that is neutral in truth has no relative error and is left out.
    """
    found = []
    for item in parameters:
        value = cause['parameters'][item.name]
        low, high = value['low95'], value['high95']
        real = truth[item.name]
        covered = None
        if low is not None and high is not None and low == low and high == high:
            covered = bool(low <= real <= high)
        kind, scale = _scale(cause['effect'], item, real, inertia)
        if scale == 0.0:
            continue
        error = abs(value['value'] - real) / abs(scale)
        found.append(ParameterError(item.name, kind, real, value['value'], error, covered))
    return found


def _scale(effect: str, item: Parameter, real: float, inertia: float) -> tuple[str, float]:
    if item.name == 'delay':
        return 'delay', item.resolution or 1e3 / Timing().encoder_hz  # ms of a cycle
    if item.name == 'ratio':
        return 'gain', real
    if effect == 'wrong_inertia':
        return 'inertia', inertia + real
    if item.shape:
        return 'shape', real
    return 'other', real - item.neutral
