# SPDX-License-Identifier: Apache-2.0
"""
What a diagnosis got right: its report against the truth.

A report is `report.json` as a reader of the file has it. `inseparable` tells whether the logs cannot
tell the reported causes from the true ones, as found by simulating both; only then does a single
effect that is in a reported credible set, of at most three, count as named. Of several effects at once
each counts as named in such a set (`effects_and_names`).
"""

from __future__ import annotations

import math
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

NAMED, IN_SET, MISSED = 'named', 'in the set', 'missed'
"""What becomes of a hidden effect."""

SHOWN = 3.0
"""Size from which on one of several effects at once is to be named."""

Report = Mapping[str, Any]
Score = dict[str, Any]


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


def outcome_of_unknown(
    report: Report, truth: str, inseparable: bool, known: Sequence[str] = ()
) -> str:
    """
    Return what became of an effect that is not in the library, alone or among known ones.

    `right` (something is left unexplained on its axis), `other axis`, `twin` (explained by another
    effect that the logs cannot tell from it), `wrong`, `missed`.
    """
    axis = truth.split(':')[1]
    unexplained = [item['axis'] for item in report['unexplained']]
    if axis in unexplained:
        return 'right'
    if any(name_of(cause) not in known for cause in report['causes']):
        return TWIN if inseparable else 'wrong'
    return 'other axis' if unexplained else 'missed'


def outcome_of_several(effects: Sequence[Score], names: Sequence[Score]) -> str:
    """Return `all`, `some` or `none`, of effects that the logs show, with ` and a false one`."""
    hits = [item['became'] != MISSED for item in effects if item['size'] >= SHOWN]
    outcome = 'none' if hits and not any(hits) else 'all' if all(hits) else 'some'
    return outcome + (' and a false one' if any(is_false(item) for item in names) else '')


def effects_and_names(
    causes: Sequence[Mapping[str, Any]],
    hidden: Mapping[str, float],
    same: Mapping[str, str],
    related: bool = False,
) -> dict[str, list[Score]]:
    """
    Return what became of each hidden effect, and whether each name that was reported is true.

    `hidden` has the size of each effect in the logs, by `effect:axis`. An effect is `named` if a cause
    has its name, `in the set` if the credible set of one, of at most three, holds it, else `missed`. A
    name is `true` if it is that of a hidden effect, `in_set` if it or one of its set is. `same` has the
    names that stand for others which do exactly the same in the model. With `related` the logs do not
    tell what was reported from what was hidden: such names are neither true nor false.
    """

    def own(name: str) -> str:
        return same.get(name, name)

    wanted = {own(name) for name in hidden}
    reported = []
    for cause in causes:
        members = {own(name) for name in (name_of(cause), *others_of(cause))}
        reported.append((cause, own(name_of(cause)), members))
    firsts = {name for _, name, _ in reported}
    in_sets = {
        one for _, _, members in reported if len(members) <= LARGEST_GROUP for one in members
    }
    effects, names = [], []
    for name, size in hidden.items():
        became = NAMED if own(name) in firsts else IN_SET if own(name) in in_sets else MISSED
        effects.append({'name': name, 'size': size, 'became': became})
    for cause, name, members in reported:
        in_set = name in wanted or (len(members) <= LARGEST_GROUP and bool(members & wanted))
        names.append(
            {
                'name': name_of(cause),
                'probability': cause['probability'],
                'true': name in wanted,
                'in_set': in_set,
                'related': related and not in_set,
            }
        )
    return {'effects': effects, 'names': names}


def is_false(name: Score) -> bool:
    """Return whether a reported name is wrong, and its credible set too."""
    return not name['in_set'] and not name['related']


def corrections(report: Report, truth: Mapping[str, float]) -> list[Score]:
    """
    Return the corrections of a report against the factors of the true machine, by `section.name`.

    `covered` tells whether the 95 % interval holds the true value; None where nothing is known of
    that number, or the report has no interval.
    """
    found = []
    for item in report.get('corrections', ()):
        place = '.'.join(item['path'].split('.')[:2])
        real, covered = None, None
        if place in truth:
            real = item['nominal'] * truth[place]
            covered = is_within(real, item['low'], item['high'])
        found.append({**item, 'truth': real, 'covered': covered})
    return found


def is_within(value: float, low: float | None, high: float | None) -> bool | None:
    """Return whether an interval holds a value; None if it has no ends."""
    if low is None or high is None or math.isnan(low) or math.isnan(high):
        return None
    return bool(low <= value <= high)


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
        real = truth[item.name]
        covered = is_within(real, value['low95'], value['high95'])
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
