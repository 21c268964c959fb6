# SPDX-License-Identifier: Apache-2.0
"""A description's file: read with all that it extends, held against its grammar, and checked."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout, layout_of
from waferbot_lockstep.marked_yaml import (
    SAFE_DUMPER,
    Document,
    Key,
    first_complaint,
    key_text,
    merge,
    parse,
    read,
)
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.parameters import did_you_mean
from waferbot_plant.description import DAMPING, STATES, Description
from waferbot_plant.description_reader import Reader

_SCHEMA = json.loads(package_data('waferbot_plant', 'description.schema.json').read_text('utf-8'))
_SECTION_SCHEMA = {
    name: jsonschema.Draft202012Validator({'$defs': _SCHEMA['$defs'], **schema})
    for name, schema in _SCHEMA['properties'].items()
}
_BY_ENTRY = frozenset(
    name
    for name, schema in _SCHEMA['properties'].items()
    if set(_SCHEMA['$defs'].get(schema.get('$ref', '').rpartition('/')[2], schema))
    <= {'type', 'propertyNames', 'additionalProperties', 'minProperties', 'description'}
)
"""Sections that are valid if there are entries and each of them is."""


def whole_text(source: Path | str) -> str:
    """Return a description, given as for `load_description`, as the text of one YAML file."""
    return _dumped(pickle.dumps(_read_whole(source).data))


def described_layout(source: Path | str) -> Layout:
    """
    Return the axes and encoders of a description, given as for `load_description`.

    Nothing else of it is checked. Raises `UserError`.
    """
    data = _read_whole(source).data
    axes, encoders = data.get('axes'), data.get('encoders')
    return layout_of(
        tuple(axes) if isinstance(axes, dict) else (),
        tuple(encoders) if isinstance(encoders, dict) else (),
    )


@lru_cache(maxsize=8)
def _dumped(data: bytes) -> str:
    """Return pickled data as YAML; every recording holds that of its machine, which seldom changes."""
    return yaml.dump(pickle.loads(data), Dumper=SAFE_DUMPER, sort_keys=False)


def _read_whole(source: Path | str) -> Document:
    """Read a file with all that it extends, or the text of one that extends nothing."""
    if isinstance(source, Path):
        return _read_chain(source, ())
    document = parse(source, 'description')
    if not isinstance(document.data, dict):
        raise UserError('description: must be a mapping')
    if 'extends' in document.data:
        raise document.error(('extends',), 'a description given as text must be whole')
    return document


def load_description(
    source: Path | str,
    switches: Mapping[str, str] | str | None = None,
    damping: str = 'improved',
    overlays: tuple[Document, ...] = (),
) -> Description:
    """
    Read and check a description: a file, or the text of one.

    `switches` sets the state of connections, by name or for all at once; `damping` picks between
    two-valued quantities; `overlays` are laid over the file in turn. Raises `UserError` naming file,
    line and key.
    """
    document = _read_whole(source)
    for overlay in overlays:
        merge(document, overlay)
    _switch(document, switches)
    return check(document, damping)


def _read_chain(path: Path, seen: tuple[Path, ...]) -> Document:
    """Read a file over the one that it extends."""
    document = read(path)
    base_name = document.data.pop('extends', None)
    if base_name is None:
        return document
    if not isinstance(base_name, str):
        raise document.error(('extends',), 'must be the name of a description file')
    base_path = (path.parent / base_name).resolve()
    if base_path in seen or base_path == path.resolve():
        raise document.error(('extends',), f'{base_name} extends this file in turn')
    base = _read_chain(base_path, (*seen, path.resolve()))
    merge(base, document)
    return base


def _switch(document: Document, switches: Mapping[str, str] | str | None) -> None:
    """Set the states of connections."""
    connections = document.data.get('connections', {})
    if isinstance(switches, str):
        switches = dict.fromkeys(connections, switches)
    for name, state in (switches or {}).items():
        if name not in connections:
            raise UserError(f'no connection {name!r} to switch{did_you_mean(name, connections)}')
        if state not in STATES:
            raise UserError(f'connection {name}: state is {state!r}; it is rigid or flexible')
        connections[name]['state'] = state


def check(document: Document, damping: str = 'improved') -> Description:
    """Check a document that was read, and return the description in it."""
    if damping not in DAMPING:
        raise UserError(f'damping is {damping!r}; it is one of {", ".join(DAMPING)}')
    provenance: dict[str, str] = {}
    data = {}
    for name, section in document.data.items():
        try:
            data[name], origins = _unwrapped(name, pickle.dumps(section), damping)
        except UserError:
            # said again, with the place in this document
            _unwrap(document, section, (name,), damping, {})
            raise
        provenance |= origins
    _check_grammar(document, data)
    return Reader(document, data).description(provenance)


@lru_cache(maxsize=1024)
def _unwrapped(name: str, pickled: bytes, damping: str) -> tuple[Any, dict[str, str]]:
    """
    Return a section with plain values, not to be changed, and where they are from.

    A diagnosis checks thousands of descriptions that differ in a single section; what is the same
    is remembered.
    """
    provenance: dict[str, str] = {}
    nowhere = Document({})
    return _unwrap(nowhere, pickle.loads(pickled), (name,), damping, provenance), provenance


def _unwrap(
    document: Document, value: Any, key: Key, damping: str, provenance: dict[str, str]
) -> Any:
    """Replace every {value, from} and {calculated, improved, from} by its value; note `from`."""
    if isinstance(value, list):
        return [
            _unwrap(document, item, (*key, place), damping, provenance)
            for place, item in enumerate(value)
        ]
    if not isinstance(value, dict):
        if isinstance(value, float) and not math.isfinite(value):
            raise document.error(key, f'is {value}; it must be a finite number')
        return value
    keys = set(value)
    if 'value' in keys or keys & set(DAMPING):
        wanted = {'value'} if 'value' in keys else set(DAMPING)
        if keys - {'from'} != wanted:
            raise document.error(
                key, 'takes {value, from} or {calculated, improved, from}, not ' + ', '.join(keys)
            )
        if 'from' in keys:
            provenance[key_text(key)] = str(value['from'])
        part = 'value' if 'value' in keys else damping
        return _unwrap(document, value[part], (*key, part), damping, {})
    return {
        part: _unwrap(document, item, (*key, part), damping, provenance)
        for part, item in value.items()
    }


def _check_grammar(document: Document, data: dict[str, Any]) -> None:
    """Apply the JSON Schema and turn its first complaint into one line for the user."""
    if set(_SCHEMA['required']) <= set(data) <= set(_SECTION_SCHEMA) and all(
        _section_is_valid(name, pickle.dumps(section)) for name, section in data.items()
    ):
        return
    error = first_complaint(jsonschema.Draft202012Validator(_SCHEMA).iter_errors(data))
    if error is None:
        return
    key = tuple(error.absolute_path)
    if error.validator == 'additionalProperties' and error.schema.get('properties'):
        known = error.schema['properties']
        unknown = sorted(set(error.instance) - set(known))[0]
        hint = did_you_mean(unknown, known) or f' (keys here: {", ".join(known)})'
        raise document.error((*key, unknown), f'unknown key{hint}')
    if error.validator == 'required':
        missing = [name for name in error.validator_value if name not in error.instance]
        raise document.error(key, f'{" and ".join(missing)} missing')
    if error.parent is None and 'propertyNames' in error.absolute_schema_path:
        known = error.validator_value if error.validator == 'enum' else ()
        hint = f'; names here are {", ".join(known)}' if known else ''
        raise document.error((*key, error.instance), f'not a valid name{hint}')
    texts = {
        'exclusiveMinimum': 'must be greater than {}',
        'minimum': 'must be at least {}',
        'maximum': 'must be at most {}',
        'type': 'must be of type {}',
        'const': 'must be {}',
        'not': 'must not be zero',
        'minLength': 'must not be empty',
        'enum': 'must be one of {}',
        'minItems': 'must have at least {} entries',
        'maxItems': 'must have at most {} entries',
        'minProperties': 'must have at least {} entry',
    }
    rule = error.validator_value
    rule = ', '.join(map(str, rule)) if isinstance(rule, list) else rule
    text = texts.get(str(error.validator), 'is nothing that may stand there').format(rule)
    raise document.error(key, f'is {error.instance!r}; it {text}')


@lru_cache(maxsize=1024)
def _section_is_valid(name: str, pickled: bytes) -> bool:
    """Apply the part of the schema for one section; answers are remembered as above."""
    section = pickle.loads(pickled)
    if name in _BY_ENTRY and isinstance(section, dict) and section:
        return all(
            _entry_is_valid(name, pickle.dumps({key: entry})) for key, entry in section.items()
        )
    return bool(_SECTION_SCHEMA[name].is_valid(section))


@lru_cache(maxsize=4096)
def _entry_is_valid(name: str, pickled: bytes) -> bool:
    """Apply the part of the schema for one section to one with a single entry."""
    return bool(_SECTION_SCHEMA[name].is_valid(pickle.loads(pickled)))
