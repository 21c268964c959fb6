# SPDX-License-Identifier: Apache-2.0
"""
Message definitions: full text, type hash (RIHS01) and fields of what the nodes exchange and record.

They come with this package, so that a recording is written and read without ROS, and is the same with
it. `definitions_file` makes them from what rosidl installs; a test compares the two.
"""

from __future__ import annotations

import functools
import json
import re

from waferbot_lockstep.package_data import package_data

_FIELD = re.compile(r'^\s*([A-Za-z]\w*(?:/\w+)*(?:\[[^\]]*\])?)\s+(\w+)\s*$')


def full_text(type_name: str) -> str:
    """Return the definition with those of all types in it, in the `ros2msg` form of MCAP."""
    return '\n'.join(_definitions()[type_name]['text'])


def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of the type."""
    return str(_definitions()[type_name]['hash'])


def type_names() -> list[str]:
    """Return the names of the types that are known, `waferbot_msgs/msg/Encoders` and so on."""
    return list(_definitions())


def field_types(type_name: str) -> dict[str, str]:
    """Return the fields of a type in their order, with types as in the definition, `float64[3]`."""
    fields = {}
    for line in _definitions()[type_name]['text']:
        if line.startswith('==='):
            break  # here begin the definitions of the types in it
        match = _FIELD.match(line.split('#')[0])
        if match:
            fields[match.group(2)] = match.group(1)
    return fields


@functools.cache
def _definitions() -> dict[str, dict[str, list[str] | str]]:
    found: dict[str, dict[str, list[str] | str]] = json.loads(
        package_data('waferbot_lockstep', 'definitions.json').read_text('utf-8')
    )
    return found
