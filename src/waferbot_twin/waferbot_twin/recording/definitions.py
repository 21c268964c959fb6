# SPDX-License-Identifier: Apache-2.0
"""
Message definitions as a recording carries them: full text and type hash.

Both come from the files that rosidl installs beside each message (`share/<package>/msg/*.msg` and
`*.json`), so they are those of the very messages that the nodes exchange.
"""

from __future__ import annotations

import functools
import json
import re
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from waferbot_lockstep.errors import UserError

_SEPARATOR = '=' * 80
_FIELD = re.compile(r'^\s*([A-Za-z]\w*(?:/\w+)*)(?:\[[^\]]*\])?\s+\w+')


def _path(type_name: str, suffix: str) -> Path:
    package, kind, name = type_name.split('/')
    try:
        return Path(get_package_share_directory(package)) / kind / f'{name}{suffix}'
    except PackageNotFoundError as error:
        raise UserError(
            f'package {package} is not on AMENT_PREFIX_PATH; source the workspace, or use ./waferbot'
        ) from error


@functools.cache
def full_text(type_name: str) -> str:
    """Return the definition with those of all types in it, in the `ros2msg` form of MCAP."""
    definitions = {type_name: _path(type_name, '.msg').read_text('utf-8')}
    pending = [type_name]
    while pending:
        current = pending.pop(0)
        for inner in _nested_types(definitions[current], current.split('/')[0]):
            if inner not in definitions:
                definitions[inner] = _path(inner, '.msg').read_text('utf-8')
                pending.append(inner)
    main, *others = definitions
    parts = [definitions[main]]
    for other in others:
        package, _, name = other.split('/')
        parts.append(f'{_SEPARATOR}\nMSG: {package}/{name}\n{definitions[other]}')
    return '\n'.join(parts)


@functools.cache
def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of the type."""
    description = json.loads(_path(type_name, '.json').read_text('utf-8'))
    for entry in description['type_hashes']:
        if entry['type_name'] == type_name:
            return str(entry['hash_string'])
    raise UserError(f'{type_name} has no type hash in its installed description')


def _nested_types(text: str, package: str) -> list[str]:
    """Return the message types that a definition's fields use, as `package/msg/Name`."""
    nested = []
    for line in text.splitlines():
        match = _FIELD.match(line.split('#')[0])
        name = match.group(1) if match else ''
        if not name or (name[0].islower() and '/' not in name):
            continue  # empty line or built-in type
        parts = name.split('/')
        nested.append(f'{parts[0] if len(parts) > 1 else package}/msg/{parts[-1]}')
    return nested
