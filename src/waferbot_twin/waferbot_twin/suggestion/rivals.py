# SPDX-License-Identifier: Apache-2.0
"""Causes that are to be told apart: named by the user, or read from the report of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.checked_json import NUMBER, TEXT, checked_json
from waferbot_twin.diagnosis.report_schema import SCHEMA
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.residuals.problem import Cause
from waferbot_twin.synthesis import parse_effect

_NAMED = {'effect': TEXT, 'axis': TEXT}
_CAUSES = {
    'type': 'array',
    'items': {
        'type': 'object',
        'required': ['effect', 'axis', 'parameters', 'credible_set'],
        'properties': {
            **_NAMED,
            'parameters': {
                'type': 'object',
                'additionalProperties': {
                    'type': 'object',
                    'required': ['value'],
                    'properties': {'value': NUMBER},
                },
            },
            'credible_set': {
                'type': 'array',
                'items': {
                    'type': 'object',
                    'required': ['effect', 'axis', 'values'],
                    'properties': {
                        **_NAMED,
                        'values': {'type': 'object', 'additionalProperties': NUMBER},
                    },
                },
            },
        },
    },
}
_REPORT = {
    'type': 'object',
    'required': ['schema', 'causes'],
    'properties': {
        'schema': {'const': SCHEMA},
        'model': TEXT,
        'causes': _CAUSES,
        'possible': _CAUSES,
    },
}
"""What is read of the report of a diagnosis, as a JSON schema."""


@dataclass(frozen=True)
class Group:
    """Causes that cannot be told apart, and the model's name and other causes that a report has."""

    rivals: tuple[Cause, ...]
    others: tuple[Cause, ...] = ()


def named(texts: Sequence[str], variant: Variant) -> Group:
    """Return causes given as `EFFECT:AXIS[,KEY=VALUE...]`; raises `UserError`."""
    found = []
    for text in texts:
        if ':' not in text.split(',')[0]:
            raise UserError(f'--rivals {text}: give the axis, {text.split(",")[0]}:AXIS')
        one = parse_effect(text, variant, np.random.default_rng(0))
        found.append(Cause(find(one.effect), one.axis, one.values))
    return Group(tuple(found))


def read_report(path: Path) -> Mapping[str, Any]:
    """Return the report of a diagnosis: the file, or the folder it is in; raises `UserError`."""
    file = path / 'report.json' if path.is_dir() else path
    try:
        text = file.read_text('utf-8')
    except OSError as error:
        raise UserError(
            f'{file} cannot be read ({error.strerror}); give the folder of a diagnosis'
        ) from None
    except UnicodeDecodeError as error:
        raise UserError(f'{file} is no report of a diagnosis ({error})') from None
    report: dict[str, Any] = checked_json(text, _REPORT, f'{file}, report of a diagnosis,')
    return report


def of_report(report: Mapping[str, Any], variant: Variant, wanted: str | None) -> Group:
    """
    Return the first cause of a report that could not be told from others, with these.

    One that is only possible comes after those that are named. `wanted` names another one, EFFECT:AXIS.
    Raises `UserError` if there is none.
    """
    causes = _by_name(report['causes'])
    unsure = {
        name: item
        for name, item in {**causes, **_by_name(report.get('possible', []))}.items()
        if len(item['credible_set']) > 1
    }
    if not unsure:
        raise UserError(
            'the report has no cause that could not be told from another; name two with --rivals'
        )
    name = wanted or next(iter(unsure))
    if name not in unsure:
        raise UserError(
            f'the report has no group of {name!r}{did_you_mean(name, unsure)} '
            f'(there: {", ".join(unsure)})'
        )
    others = tuple(
        _cause(item, _values(item), variant) for other, item in causes.items() if other != name
    )
    own = unsure[name]
    rivals = [
        _cause(item, item['values'], variant)
        for other, item in _by_name(own['credible_set']).items()
        if other != name
    ]
    return Group((_cause(own, _values(own), variant), *rivals), others)


def _by_name(items: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    return {f'{item["effect"]}:{item["axis"]}': item for item in items}


def _values(item: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(one['value']) for name, one in item['parameters'].items()}


def _cause(item: Mapping[str, Any], values: Mapping[str, float], variant: Variant) -> Cause:
    effect = find(str(item['effect']))
    return Cause(effect, str(item['axis']), effect.complete(variant, str(item['axis']), values))
