# SPDX-License-Identifier: Apache-2.0
"""
Makes `definitions.json` anew, with ROS and waferbot_msgs installed, after a message was changed.

    python -m waferbot_lockstep.definitions_file

Text and hash are those that rosidl installs beside each message (`share/<package>/msg/*.msg` and
`*.json`), so they are those of the very messages that the nodes exchange.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from waferbot_lockstep import atomic_files
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.standard_messages import (
    CLOCK,
    FLOAT64,
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    TRANSFORMS,
)

TF_MESSAGE = (
    'geometry_msgs/TransformStamped[] transforms\n',
    'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
)
"""Text and hash of the type of transforms, which is not among PyPI's wheels."""

_SEPARATOR = '=' * 80
_FIELD = re.compile(r'^\s*([A-Za-z]\w*(?:/\w+)*)(?:\[[^\]]*\])?\s+\w+')


def definitions_text() -> str:
    """Return what the file must hold: all of waferbot_msgs, and the standard ones of recordings."""
    own = Path(get_package_share_directory('waferbot_msgs')) / 'msg'
    names = [f'waferbot_msgs/msg/{path.stem}' for path in sorted(own.glob('*.msg'))]
    standard = (CLOCK, JOINT_STATES, ROBOT_DESCRIPTION, TRANSFORMS)
    names += [*(type_name for _, type_name in standard), FLOAT64]
    found = {
        name: {'hash': _type_hash(name), 'text': _full_text(name).split('\n')} for name in names
    }
    return json.dumps(found, indent=1, ensure_ascii=False) + '\n'


def _installed(type_name: str, suffix: str) -> str:
    package, kind, name = type_name.split('/')
    folder = Path(get_package_share_directory(package))
    return (folder / kind / f'{name}{suffix}').read_text('utf-8')


def _full_text(type_name: str) -> str:
    is_tf = type_name == TRANSFORMS[1]
    definitions = {type_name: TF_MESSAGE[0] if is_tf else _installed(type_name, '.msg')}
    pending = [type_name]
    while pending:
        current = pending.pop(0)
        for inner in _nested_types(definitions[current], current.split('/')[0]):
            if inner not in definitions:
                definitions[inner] = _installed(inner, '.msg')
                pending.append(inner)
    main, *others = definitions
    parts = [definitions[main]]
    for other in others:
        package, _, name = other.split('/')
        parts.append(f'{_SEPARATOR}\nMSG: {package}/{name}\n{definitions[other]}')
    return '\n'.join(parts)


def _type_hash(type_name: str) -> str:
    if type_name == TRANSFORMS[1]:
        return TF_MESSAGE[1]
    (found,) = [
        entry['hash_string']
        for entry in json.loads(_installed(type_name, '.json'))['type_hashes']
        if entry['type_name'] == type_name
    ]
    return str(found)


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


if __name__ == '__main__':
    atomic_files.write_text(
        package_data('waferbot_lockstep', 'definitions.json'), definitions_text()
    )
