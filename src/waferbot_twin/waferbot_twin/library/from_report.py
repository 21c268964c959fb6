# SPDX-License-Identifier: Apache-2.0
"""Entries out of the report of `waferbot identify --parameter ...` or of `waferbot diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_plant.motors import back_emf_of
from waferbot_twin.checked_json import NUMBER, TEXT, checked_json
from waferbot_twin.library.entries import Entry

WORDS = {
    'gearbox': 'gearbox', 'ferrofluid': 'ferrofluid_seal', 'lip_seal': 'lip_seal',
    'guide': 'linear_guide', 'payload_bearing': 'linear_guide',
    'counterweight_bearing': 'linear_guide', 'x_rotate_bearing': 'cross_roller_bearing',
    'belt': 'belt', 'cable': 'cable', 'shaft': 'shaft',
}  # fmt: skip
"""Words in the name of a part, and its type; looked for in this order."""

SECTIONS = {
    'motors': 'motor', 'rotors': 'motor', 'encoders': 'encoder', 'bodies': 'body',
    'pmac': 'controller', 'copley': 'controller',
}  # fmt: skip
"""Sections of a model all of whose entries are of one type."""


_FOUND = {'on_bound': {'type': 'boolean'}, 'told': {'type': 'boolean'}}
_VALUE = {
    'type': 'object',
    'required': ['value', 'unit'],
    'properties': {
        **_FOUND,
        'value': NUMBER,
        'unit': TEXT,
        'low95': {'anyOf': [NUMBER, {'type': 'null'}]},
        'high95': {'anyOf': [NUMBER, {'type': 'null'}]},
        'identified': {'type': 'boolean'},
    },
}
_VALUES = {'type': 'object', 'additionalProperties': _VALUE}
_SCHEMA = {
    'type': 'object',
    'anyOf': [{'required': ['parameters']}, {'required': ['causes']}],
    'properties': {
        'parameters': _VALUES,
        'causes': {
            'type': 'array',
            'items': {
                'type': 'object',
                'required': ['effect', 'axis', 'parameters'],
                'properties': {'effect': TEXT, 'axis': TEXT, 'parameters': _VALUES},
            },
        },
        'corrections': {
            'type': 'array',
            'items': {
                'type': 'object',
                'required': ['path', 'unit', 'found', 'low', 'high'],
                'properties': {
                    **_FOUND,
                    'path': TEXT,
                    'unit': TEXT,
                    'found': NUMBER,
                    'low': NUMBER,
                    'high': NUMBER,
                },
            },
        },
    },
}


def part_of(path: str) -> str:
    """Return the type of part that a path leads to, 'other' if its name does not say."""
    section, *rest = path.split('.')
    if section in SECTIONS:
        return SECTIONS[section]
    name = rest[0] if rest else ''
    return next((part for word, part in WORDS.items() if word in name), 'other')


def parameter_of(path: str) -> str:
    """Return the name of the parameter: the last word of its path."""
    return path.rsplit('.', 1)[-1]


def read_entries(
    report: Path, machine: str, date: str, conditions: dict[str, Any]
) -> tuple[Entry, ...]:
    """
    Return what an identification or a diagnosis found, without what it left open.

    `report` is its folder or its `report.json`. Raises `UserError` for anything else.
    """
    file = report / 'report.json' if report.is_dir() else report
    try:
        text = file.read_text('utf-8')
    except (OSError, ValueError) as error:
        raise UserError(f'{file} cannot be read: {error}') from error
    data = checked_json(text, _SCHEMA, str(file))
    common: dict[str, Any] = {'machine': machine, 'date': date, 'conditions': dict(conditions)}
    found = [
        Entry(
            part_of(path), parameter_of(path), float(one['value']), one['unit'],
            path=path, origin=f'identify: {report}', **_interval(one), **common,
        )
        for path, one in data.get('parameters', {}).items()
        if one.get('identified', True)
    ]  # fmt: skip
    for cause in data.get('causes', []):
        name = f'{cause["effect"]}.{cause["axis"]}'
        found += [
            Entry(
                part_of(f'effects.{cause["effect"]}'), f'{cause["effect"]}.{parameter}',
                float(one['value']), one['unit'], path=f'{name}.{parameter}',
                origin=f'diagnose: {report}', **_interval(one), **common,
            )
            for parameter, one in cause['parameters'].items()
            if _is_finding(one)
        ]  # fmt: skip
    found += [
        Entry(
            part_of(one['path']), parameter_of(one['path']), **_at_path(one),
            path=one['path'], origin=f'diagnose: {report}', **common,
        )
        for one in data.get('corrections', [])
        # The time of a drive is that of a log.
        if _is_finding(one) and not one['path'].startswith('logs.')
    ]  # fmt: skip
    if not found:
        raise UserError(f'{file}: nothing was identified in it')
    return tuple(found)


def _is_finding(one: dict[str, Any]) -> bool:
    """Return whether a diagnosis found a value: the logs tell it, and it is not on a bound."""
    return one.get('told', True) and not one.get('on_bound', False)


def _interval(one: dict[str, Any]) -> dict[str, Any]:
    """Return the interval of a parameter; nothing if it has none."""
    low, high = one.get('low95'), one.get('high95')
    if low is None or high is None:
        return {}
    return {'low': float(low), 'high': float(high)}


def _at_path(correction: dict[str, Any]) -> dict[str, Any]:
    """
    Return value, unit and interval of a correction as the description has it where its path leads.

    A report tells the force or torque per ampere of a motor that is described by its back-EMF.
    """
    numbers = {
        'value': float(correction['found']),
        'low': float(correction['low']),
        'high': float(correction['high']),
    }
    unit = correction['unit']
    key = parameter_of(correction['path'])
    if not key.startswith('back_emf'):
        return {**numbers, 'unit': unit}
    numbers = {name: back_emf_of(number) for name, number in numbers.items()}
    return {**numbers, 'unit': 'V s/rad' if key.endswith('rad') else 'V s/m'}
