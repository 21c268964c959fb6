# SPDX-License-Identifier: Apache-2.0
"""
Entries of the library, one line each in a YAML file that a team keeps in git.

    schema: 1
    entries:
      - {part: belt, parameter: loss_factor, value: 0.01, low: 0.001, high: 0.05, machine: ours, ...}

`low` and `high` are the ends of the 95 % interval; `conditions` has what was the case: `speed`, `load`,
`temperature_degc`, numbers or words. New entries are written at the end, so that a change is one line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from waferbot_lockstep.atomic_files import write_text
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import Document, read
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.parameters import did_you_mean

SCHEMA = 1

PARTS = (
    'gearbox', 'ferrofluid_seal', 'lip_seal', 'linear_guide', 'cross_roller_bearing', 'belt', 'cable',
    'shaft', 'motor', 'encoder', 'body', 'controller', 'other',
)  # fmt: skip
"""Types of part."""

CONDITIONS = ('speed', 'load', 'temperature_degc')


@dataclass(frozen=True)
class Entry:
    """
    What was found of a parameter of a part, on a machine.

    `value`, `low` and `high` in `unit`; NaN where there is no interval. `path` is where it stands in
    the model it was found with, '' if nowhere.
    """

    part: str
    parameter: str
    value: float
    unit: str = ''
    low: float = math.nan
    high: float = math.nan
    machine: str = ''
    path: str = ''
    origin: str = ''
    date: str = ''
    conditions: dict[str, Any] = field(default_factory=dict)

    def as_data(self) -> dict[str, Any]:
        """Return the entry without what is empty."""
        return {
            name: value
            for name, value in vars(self).items()
            if value not in ('', {}) and not (isinstance(value, float) and math.isnan(value))
        }


def shipped() -> Path:
    """Return the library that comes with waferbot: the damping of the thesis."""
    return package_data('waferbot_twin', 'config', 'library.yaml')


def load(path: Path) -> tuple[Entry, ...]:
    """Return the entries of a library; raises `UserError` with file, line and key."""
    document = read(path)
    data = document.data
    if not isinstance(data, dict) or data.get('schema') != SCHEMA:
        raise UserError(f'{path}: a library begins with schema: {SCHEMA}')
    entries = data.get('entries') or []
    if not isinstance(entries, list):
        raise document.error(('entries',), 'must be a list')
    return tuple(_entry(document, place, one) for place, one in enumerate(entries))


def _entry(document: Document, place: int, data: Any) -> Entry:
    key = ('entries', place)
    if not isinstance(data, dict):
        raise document.error(key, 'must be a mapping of names to values')
    known = tuple(Entry.__dataclass_fields__)
    for name in data:
        if name not in known:
            raise document.error(
                (*key, name), f'is not known here{did_you_mean(str(name), known)}'
            )
    for name in ('part', 'parameter', 'value'):
        if name not in data:
            raise document.error(key, f'{name} is missing')
    if data['part'] not in PARTS:
        raise document.error(
            (*key, 'part'), f'is no type of part{did_you_mean(str(data["part"]), PARTS)}'
        )
    values = dict(data)
    for name in ('value', 'low', 'high'):
        if name in values:
            if isinstance(values[name], bool) or not isinstance(values[name], int | float):
                raise document.error((*key, name), 'must be a number')
            values[name] = float(values[name])
            if not math.isfinite(values[name]):
                raise document.error((*key, name), 'must be a finite number')
    conditions = values.get('conditions', {})
    if not isinstance(conditions, dict) or not set(conditions) <= set(CONDITIONS):
        raise document.error((*key, 'conditions'), f'has {", ".join(CONDITIONS)} and nothing else')
    for name in ('unit', 'machine', 'path', 'origin', 'date', 'parameter'):
        if name in values:
            values[name] = str(values[name])
    return Entry(**values)


def add(path: Path, fresh: tuple[Entry, ...]) -> None:
    """
    Write entries at the end of a library, which is made if it is not there.

    What stands in the file, comments as well, stays as it is. Raises `UserError`.
    """
    if path.exists():
        load(path)
        text = path.read_text('utf-8')
        if not text.endswith('\n'):
            text += '\n'
        if 'entries:' not in text:
            text += 'entries:\n'
    else:
        text = f'schema: {SCHEMA}\nentries:\n'
    lines = [
        '  - '
        + yaml.safe_dump(
            one.as_data(),
            default_flow_style=True,
            sort_keys=False,
            width=10000,
            allow_unicode=True,
        ).strip()
        for one in fresh
    ]
    try:
        write_text(path, text + '\n'.join(lines) + '\n')
    except OSError as error:
        raise UserError(f'{path} cannot be written: {error.strerror}') from error
    load(path)
