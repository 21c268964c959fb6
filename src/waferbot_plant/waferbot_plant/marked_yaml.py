# SPDX-License-Identifier: Apache-2.0
"""
YAML that remembers its lines, so that an error can name file, line and key.

`read` returns plain dictionaries, lists and numbers, and beside them the line of every key. Unlike
plain YAML 1.1 it takes `1e-3` as a number and refuses a key given twice.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from waferbot_lockstep.errors import UserError

Key = tuple[Any, ...]
"""Path of a value in the document: keys and list places from the root."""


@dataclass
class Document:
    """What was read: `data`, and for every key path the file and line where it stands."""

    data: dict[str, Any]
    places: dict[Key, str] = field(default_factory=dict)

    def where(self, key: Key) -> str:
        """Return `file:line: a.b.c` for a key path, or for its nearest parent that has a line."""
        for length in range(len(key), -1, -1):
            if key[:length] in self.places:
                name = '.'.join(str(part) for part in key)
                return f'{self.places[key[:length]]}: {name}' if name else self.places[()]
        return '.'.join(str(part) for part in key)

    def error(self, key: Key, message: str) -> UserError:
        """Return the error for the user: where it is, then what is wrong."""
        return UserError(f'{self.where(key)}: {message}')


class _Loader(yaml.SafeLoader):
    """YAML's safe loader, with every spelling of a number that people use."""


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'^[-+]?(\d[\d_]*\.?\d*|\.\d+)[eE][-+]?\d+$'),
    list('-+0123456789.'),
)


def read(path: Path) -> Document:
    """Read one YAML file whose root is a mapping; raises `UserError` with file and line."""
    try:
        text = path.read_text(encoding='utf-8')
    except OSError as error:
        raise UserError(f'{path}: cannot be read ({error.strerror})') from None
    except UnicodeDecodeError as error:
        raise UserError(f'{path}: is not UTF-8 text ({error.reason})') from None
    return parse(text, str(path))


def parse(text: str, name: str) -> Document:
    """Read YAML from `text`; `name` stands for the file in messages."""
    loader = _Loader(text)
    try:
        root = loader.get_single_node()
        places: dict[Key, str] = {(): f'{name}:1'}
        data = _plain(loader, root, (), name, places) if root is not None else {}
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise UserError(f'{name}:{line}: not valid YAML: {error.problem or error}') from None
    except yaml.YAMLError as error:
        raise UserError(f'{name}: not valid YAML: {error}') from None
    finally:
        loader.dispose()
    if not isinstance(data, dict):
        raise UserError(f'{name}:1: must be a mapping of keys to values')
    return Document(data, places)


def _plain(
    loader: yaml.SafeLoader, node: yaml.Node, key: Key, name: str, places: dict[Key, str]
) -> Any:
    """Turn a node into plain Python and note the line of every key on the way."""
    places.setdefault(key, f'{name}:{node.start_mark.line + 1}')
    if isinstance(node, yaml.MappingNode):
        loader.flatten_mapping(node)
        mapping: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            part = loader.construct_object(key_node, deep=True)
            inner = (*key, part)
            line = f'{name}:{key_node.start_mark.line + 1}'
            if part in mapping:
                raise UserError(f'{line}: {".".join(map(str, inner))}: this key is given twice')
            places[inner] = line
            mapping[part] = _plain(loader, value_node, inner, name, places)
        return mapping
    if isinstance(node, yaml.SequenceNode):
        return [
            _plain(loader, item, (*key, place), name, places)
            for place, item in enumerate(node.value)
        ]
    return loader.construct_object(node, deep=True)


def merge(base: Document, overlay: Document) -> None:
    """
    Lay `overlay` over `base`: mappings are merged key by key, anything else is replaced.

    A value of `null` in the overlay removes the key. Lines of replaced values are the overlay's.
    """
    _merge(base.data, overlay.data, (), base, overlay)


def _merge(
    into: dict[str, Any], source: dict[str, Any], key: Key, base: Document, overlay: Document
) -> None:
    for part, value in source.items():
        inner = (*key, part)
        if isinstance(value, dict) and isinstance(into.get(part), dict):
            _merge(into[part], value, inner, base, overlay)
            continue
        if value is None:
            into.pop(part, None)
        else:
            into[part] = value
        for place, line in overlay.places.items():
            if place[: len(inner)] == inner:
                base.places[place] = line
