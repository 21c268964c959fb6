# SPDX-License-Identifier: Apache-2.0
"""Reading and checking experiments."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import Document, Key, first_complaint, parse
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.parameters import did_you_mean

COUNTS = 'counts'
LENGTH_UNITS = ('m', 'rad', COUNTS)

_QUANTITY_OF_KIND = {
    'step': 'amplitude',
    'bidirectional_step': 'amplitude',
    'random': 'amplitude',
    'swept_sine': 'amplitude',
    'multisine': 'amplitude',
    'constant_velocity': 'distance',
    'jog': 'distance',
    'linear': 'distance',
    'rapid': 'distance',
}


@dataclass(frozen=True)
class Motion:
    """A motion of an axis, as in the schema, and where it stands in the document."""

    path: Key
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Experiment:
    """
    One checked experiment.

    Exactly one of `motion` (axis -> motions that are added) and `program` (statements) is not empty;
    their keys are those of the schema. Whether the machine has such axes is for `check_units`. `text` is
    the YAML it was read from, to be recorded with a run.
    """

    name: str
    description: str
    duration_s: float
    motion: Mapping[str, tuple[Motion, ...]]
    program: tuple[Mapping[str, Any], ...]
    text: str
    document: Document


def shipped_experiments() -> list[str]:
    """Return the names of the experiments that come with this package, sorted."""
    return sorted(
        entry.name.removesuffix('.yaml')
        for entry in package_data(__package__).iterdir()
        if entry.name.endswith('.yaml')
    )


def load_experiment(name_or_path_or_text: str | Path) -> Experiment:
    """
    Return the experiment of that name, in that file, or with that YAML text.

    Text is what has a line break or begins with `{`; a name is one of `shipped_experiments`;
    anything else is a path. Raises `UserError` with file, line and key for what is wrong in it; whether
    its units are those of the machine's axes is for `check_units`.
    """
    given = str(name_or_path_or_text)
    if '\n' in given or given.lstrip().startswith('{'):
        return _checked(given, 'experiment text')
    if given in shipped_experiments():
        text = package_data(__package__, f'{given}.yaml').read_text('utf-8')
        return _checked(text, f'{given}.yaml')
    try:
        return _checked(Path(given).read_text('utf-8'), given)
    except (OSError, ValueError) as error:
        known = shipped_experiments()
        raise UserError(
            f'experiment {given!r} is neither shipped nor a readable file ({error})'
            f'{did_you_mean(given, known)}; shipped are: {", ".join(known)}'
        ) from error


@functools.lru_cache(maxsize=1)
def _validator() -> jsonschema.protocols.Validator:
    text = package_data(__package__, 'experiment.schema.json').read_text('utf-8')
    return jsonschema.Draft202012Validator(json.loads(text))


def _checked(text: str, source: str) -> Experiment:
    document = parse(text, source)
    error = first_complaint(_validator().iter_errors(document.data))
    if error is not None:
        raise UserError(_explained(error, document))
    data = document.data
    for path in _not_finite(data, ()):
        raise UserError(f'{document.where(path)} must be a finite number')
    if ('motion' in data) == ('program' in data):
        raise UserError(f'{document.where(())}: give either motion or program')
    motions = {axis: _motions(axis, given) for axis, given in data.get('motion', {}).items()}
    for added in motions.values():
        for motion in added:
            _check_motion(document, motion)
    for place, statement in enumerate(data.get('program', [])):
        _check_statement(document, place, statement)
    return Experiment(
        name=data['name'],
        description=data.get('description', '').strip(),
        duration_s=float(data['duration_s']),
        motion=motions,
        program=tuple(data.get('program', ())),
        text=text,
        document=document,
    )


def _explained(error: jsonschema.ValidationError, document: Document) -> str:
    """Return one line for the user from an error of the schema."""
    path = tuple(error.absolute_path)
    value: Any = error.validator_value
    instance: Any = error.instance
    schema: Any = error.schema
    if error.validator == 'additionalProperties' and 'patternProperties' in schema:
        pattern = next(iter(schema['patternProperties']))
        key = next(key for key in instance if not re.search(pattern, str(key)))
        return f'{document.where((*path, key))} is no name of an axis' + (
            ' with _m, _rad or _counts behind it' if 'counts' in pattern else ''
        )
    if error.validator == 'additionalProperties':
        known = schema['properties']
        key = next(key for key in instance if key not in known)
        return f'{document.where((*path, key))} is not known here{did_you_mean(str(key), known)}'
    if error.validator == 'required':
        missing = next(key for key in value if key not in instance)
        return f'{document.where(path)}: {missing} is missing'
    if error.validator == 'enum':
        wanted = ', '.join(map(str, value))
        return f'{document.where(path)} is {error.instance!r}; it must be one of {wanted}'
    if not path and error.validator == 'type':
        return f'{document.where(())}: an experiment is a mapping with name, duration_s and motion'
    return f'{document.where(path)}: {error.message}'


def _not_finite(data: Any, path: Key) -> Iterator[Key]:
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _not_finite(value, (*path, key))
    elif isinstance(data, list):
        for place, value in enumerate(data):
            yield from _not_finite(value, (*path, place))
    elif isinstance(data, float) and not math.isfinite(data):
        yield path


def _motions(axis: str, given: Any) -> tuple[Motion, ...]:
    """Return the motions of an axis: one, or a list of them."""
    if isinstance(given, list):
        return tuple(Motion(('motion', axis, row), values) for row, values in enumerate(given))
    return (Motion(('motion', axis), given),)


def _check_motion(document: Document, checked: Motion) -> None:
    """Check what the schema cannot say: one of several keys, order of times."""
    path, motion = checked.path, checked.values
    kind = motion['kind']
    if kind in _QUANTITY_OF_KIND:
        _only_one(document, path, motion, _length_keys(_QUANTITY_OF_KIND[kind]))
    elif any(key in motion for key in _length_keys('position')):
        _only_one(document, path, motion, _length_keys('position'))
    speeds = [f'speed_{unit}_per_s' for unit in LENGTH_UNITS]
    if kind == 'linear':
        _only_one(document, path, motion, [*speeds, 'move_time_s'])
    elif kind == 'constant_velocity' or any(key in motion for key in speeds):
        _only_one(document, path, motion, speeds)
    start_s = motion.get('start_s', 0.0)
    for key in ('return_s', 'end_s'):
        if key in motion and motion[key] <= start_s:
            raise UserError(
                f'{document.where((*path, key))} must be later than start_s ({start_s:g})'
            )
    if 'first_frequency_hz' in motion:
        first, last = motion['first_frequency_hz'], motion['last_frequency_hz']
        if kind == 'swept_sine' and first == last:
            raise UserError(
                f'{document.where((*path, "last_frequency_hz"))} must differ from the first'
            )
        if kind == 'multisine' and first > last:
            raise UserError(
                f'{document.where((*path, "last_frequency_hz"))} must not be below the first'
            )


def _length_keys(quantity: str) -> list[str]:
    return [f'{quantity}_{unit}' for unit in LENGTH_UNITS]


def _only_one(
    document: Document,
    path: Key,
    mapping: Mapping[str, Any],
    keys: list[str],
) -> None:
    given = [key for key in keys if key in mapping]
    if len(given) > 1:
        raise UserError(
            f'{document.where((*path, given[1]))}: {given[0]} is given as well; keep one of them'
        )
    if not given:
        raise UserError(f'{document.where(path)}: one of {", ".join(keys)} is missing')


def _check_statement(document: Document, place: int, statement: Mapping[str, Any]) -> None:
    path = ('program', place)
    _only_one(document, path, statement, ['dwell_s', 'linear', 'rapid'])
    if 'linear' not in statement:
        for key in statement:
            if key not in ('dwell_s', 'rapid'):
                raise UserError(f'{document.where((*path, key))} belongs to a linear move')
    for mode in ('linear', 'rapid'):
        targets = statement.get(mode, {})
        given: dict[str, str] = {}
        for key in targets:
            axis = key.rpartition('_')[0]
            if axis in given:
                raise UserError(
                    f'{document.where((*path, mode, key))}: {given[axis]} is given as well'
                )
            given[axis] = key
